//! The keys of a contact of the emergency stop at a drive.

use serde::{Deserialize, Serialize};

/// A digital input of a drive on CAN that is a normally closed contact of the emergency stop. While the contact is open, or
/// the drive is silent or out of operation, every robot of the cell brakes, and its drives go off and stay off.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmergencyContact {
    /// Bit of object 0x60FD, which is set while the contact is closed, 3 to 31. The drive sends the object at every SYNC by
    /// TPDO 3, and is refused if it cannot.
    pub input: u8,
    /// Times at which the emulated contact opens and closes, s since the emulated devices were switched on, ascending. The
    /// contact is closed before the first time. Real drives ignore this key.
    #[serde(default)]
    pub emulated_edges_s: Vec<f64>,
}
