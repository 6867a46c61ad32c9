//! The contract of a drive group.

use std::task::Poll;

use can::{Counters, Instant};

use crate::{AxisCommand, AxisState, BringUpError, Warnings};

/// All the drives behind one port, whichever robot their axes belong to, exchanged together.
///
/// # The cycle
/// At the deadline of cycle *k* the servo calls [`read`](Self::read), computes,
/// [`write`](Self::write)s and [`send`](Self::send)s. `send` hands the port one batch whose first
/// frame is SYNC *k*, followed by the set-points: the drives latch at SYNC *k* the set-points of
/// batch *k − 1* and sample; their answers are read at cycle *k + 1*. From sample to effect two
/// periods pass. All groups of a process are sent at one tick, so their drives latch together.
///
/// `read`, `write` and `send` neither wait nor allocate, and each makes at most one system call.
pub trait DriveGroup: Send {
    /// How many axes the group has; slices given to it have this length.
    fn axes(&self) -> usize;

    /// Cycles from the one that writes a set-point to the one that reads a sample of the motor having
    /// got there. 2 for axis controllers, which follow a telegram at once; 3 for CiA 402 drives in every cyclic
    /// mode, which latch at the next SYNC and have got there, or acted for a period, at the one after.
    fn delay(&self) -> usize;

    /// Moves bring-up forward: boot, identity, parameters with read-back, mapping, start.
    ///
    /// Called again and again (every period, say) until it is ready. It sends and receives on
    /// its own and must not be mixed with the cycle. Every wait inside has a deadline, so it ends.
    /// After it is ready no drive is enabled yet.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>>;

    /// Reads what has arrived and refreshes `states`, one per axis.
    fn read(&mut self, now: Instant, states: &mut [AxisState]);

    /// Takes the commands of this cycle, one per axis, and encodes the batch that
    /// [`send`](Self::send) will hand over. A batch that was not sent is replaced, never queued.
    fn write(&mut self, now: Instant, commands: &[AxisCommand]);

    /// Sends SYNC and the batch; whether the port took every set-point. What it refuses is dropped and
    /// counted, and the servo repeats its set-points instead of going on to the next ones. An axis with a latched
    /// fault follows no set-point: a group that knows what was for which axis leaves such axes out of the answer.
    fn send(&mut self, now: Instant) -> bool;

    /// What the group has counted.
    fn counters(&self) -> GroupCounters;

    /// What its drives have reported while they went on, since operation began.
    fn warnings(&self) -> &Warnings {
        static NONE: Warnings = Warnings::NONE;
        &NONE
    }
}

/// What a group counts. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroupCounters {
    /// The port's own counters.
    pub port: Counters,
    /// Set-points dropped because the port did not take them in their cycle.
    pub dropped_setpoints: u64,
    /// Cycles whose SYNC the port did not take; no set-point of them was taken either.
    pub dropped_syncs: u64,
    /// Cycles in which a drive's answer was missing, summed over the axes.
    pub missed_answers: u64,
    /// Frames that were not understood or not expected.
    pub unexpected: u64,
    /// Time from the last SYNC sent to the last answer to it, as received; zero if none came.
    pub last_bus_time: std::time::Duration,
}
