//! The keys of touch probes in the emulated surroundings.

use serde::{Deserialize, Serialize};

/// A touch probe: a switch at the tool of the robot of the scene, at a digital input. The force on the tip of the tool
/// actuates the switch.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedTouchProbe {
    /// Name of the input of an I/O node, an input without `emulated_edges_s`.
    pub input: String,
    /// Contact force that actuates the switch, N.
    #[serde(default = "force")]
    pub force: f64,
    /// Whether the switch opens by a touch: its terminal is high at rest. A broken wire then reads as a touch.
    #[serde(default)]
    pub closed_at_rest: bool,
}

fn force() -> f64 {
    0.5
}
