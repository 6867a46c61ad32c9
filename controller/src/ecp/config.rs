//! Timing of an effector control process.

use std::time::Duration;

use crate::generator::Pace;

/// Bound of the number of macrosteps ahead, if they are shorter than the macrosteps of the cell.
const SHORT_MACROSTEPS: u64 = 1000;

/// Timing of an ECP, and its time limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EcpConfig {
    /// Servo period.
    pub period: Duration,
    /// The macrostep, unless a generator chooses another.
    pub pace: Pace,
    /// Number of macrosteps of `pace`, at least 1, that may be sent ahead of the last reported macrostep if the
    /// generator's next steps read no images. Shorter macrosteps are sent for the same time ahead. Other generators
    /// compute each macrostep from the report of the previous macrostep. The servo's order queue must hold more orders
    /// than [`most_orders`](Self::most_orders). Otherwise a stop may have to wait for room in the queue.
    pub macrosteps_ahead: u16,
    /// Time limit, in addition to one macrostep, without a report and without an accepted order while macrosteps are
    /// under way.
    pub silence: Duration,
    /// Time limit for switching the drives on or off, for resetting a fault and for braking.
    pub switching: Duration,
    /// Time limit of the wait for a planner's result, and of the wait of a step at rest for its readings. The planner
    /// [`AtOnce`](super::AtOnce) has the result within the poll.
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

    /// Number of macrosteps of this pace that last as long as `macrosteps` of the cell, with a bound. At least
    /// `macrosteps`.
    pub(super) fn orders_ahead(&self, macrosteps: u16, pace: Pace) -> u64 {
        let macrosteps = u64::from(macrosteps);
        let short = macrosteps * u64::from(self.pace.periods / pace.periods);
        short.min(SHORT_MACROSTEPS).max(macrosteps)
    }
}
