//! Places of buses and drives of a cell in its emulated world.

use std::collections::BTreeMap;

use hil::{BusId, DriveId};

/// The buses of a cell in an emulated world, and the drives of its axes.
#[derive(Clone, Debug, Default)]
pub struct DriveIds {
    /// The buses, in the order of the cell.
    pub buses: Vec<BusId>,
    /// The drives by robot and axis number. Absent drives have no entry.
    pub drives: BTreeMap<(usize, usize), DriveId>,
}
