//! Timing of an effector control process.

use std::time::Duration;

use crate::generator::Pace;

/// Greatest number of macrosteps ahead, if they are shorter than the macrosteps of the cell.
const SHORT_MACROSTEPS: u64 = 1000;

/// Timing of an ECP, and its time limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EcpConfig {
    /// Servo period.
    pub period: Duration,
    /// The macrostep, unless a generator chooses another.
    pub pace: Pace,
    /// Number of macrosteps of `pace`, at least 1, that may be sent ahead of the last reported macrostep, for
    /// generators whose next steps read no images. If such a generator has shorter macrosteps, more of them are sent,
    /// for the same time ahead. All other generators compute each macrostep from the report of the previous macrostep.
    /// The servo's order queue must hold more orders than [`most_orders`](Self::most_orders). Otherwise a stop may have
    /// to wait for room in the queue.
    pub macrosteps_ahead: u16,
    /// Time limit without a report and without an accepted order while macrosteps are in execution. One macrostep is
    /// added to this time.
    pub silence: Duration,
    /// Time limit for switching the drives on or off, for resetting a fault and for braking.
    pub switching: Duration,
    /// Time limit of the wait for a planner's result, and of the wait for readings by a step at rest. With the planner
    /// [`AtOnce`](super::AtOnce) there is no wait.
    pub planning: Duration,
    /// Time limit of homing.
    pub homing: Duration,
    /// Time limit of the wait for the partners of a meeting or a team.
    pub meeting: Duration,
}

impl EcpConfig {
    /// Greatest number of macrosteps that are ahead of the last reported macrostep.
    pub fn most_orders(&self) -> usize {
        self.orders_ahead(self.macrosteps_ahead.max(1), Pace::PERIOD) as usize
    }

    /// Number of macrosteps of this pace that last as long as `macrosteps` macrosteps of the cell, limited to
    /// [`SHORT_MACROSTEPS`]. At least `macrosteps`.
    pub(super) fn orders_ahead(&self, macrosteps: u16, pace: Pace) -> u64 {
        let macrosteps = u64::from(macrosteps);
        let short = macrosteps * u64::from(self.pace.periods / pace.periods);
        short.min(SHORT_MACROSTEPS).max(macrosteps)
    }
}
