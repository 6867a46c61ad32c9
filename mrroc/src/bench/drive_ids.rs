//! Places of buses, drives and I/O nodes of a cell in its emulated world.

use std::collections::BTreeMap;

use hil::{BusId, DeviceId, DriveId};

/// The buses of a cell in an emulated world, the drives of its axes, and its I/O nodes.
#[derive(Clone, Debug, Default)]
pub struct DriveIds {
    /// The buses, in the order of the cell.
    pub buses: Vec<BusId>,
    /// The drives by robot and axis number. Absent drives have no entry.
    pub drives: BTreeMap<(usize, usize), DriveId>,
    /// The I/O nodes by their index in the cell.
    pub modules: BTreeMap<usize, DeviceId>,
}
