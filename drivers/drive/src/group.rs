//! The contract of a drive group.

use std::task::Poll;

use can::{ControllerState, Counters, Instant};
use thiserror::Error;

use crate::{AxisCommand, AxisState, BringUpError, Warnings};

/// All drives behind one port. Their axes may belong to several robots.
///
/// # The cycle
/// At the deadline of cycle *k* the servo calls [`read`](Self::read), computes, [`write`](Self::write)s and
/// [`send`](Self::send)s. `send` hands the port one batch: SYNC *k* first, then the set-points. At SYNC *k* the drives
/// sample, and latch the set-points of batch *k − 1*. Their answers are read at cycle *k + 1*. Two periods pass from
/// sample to effect. All groups of a process are sent at one tick, so their drives latch together.
///
/// `read`, `write` and `send` neither wait nor allocate, and each makes at most one system call.
pub trait DriveGroup: Send {
    /// Number of axes of the group, and length of the slices passed to it.
    fn axes(&self) -> usize;

    /// Cycles from writing a set-point to reading the sample that shows its effect. The delay is 2 for axis
    /// controllers, which follow a telegram at once. The delay is 3 for CiA 402 drives in every cyclic mode: they
    /// latch at the next SYNC, and the SYNC after that samples the effect of one period.
    fn delay(&self) -> usize;

    /// Advances bring-up: boot, identity, parameters with read-back, mapping, start.
    ///
    /// The servo calls this function repeatedly, for example every period, until the group is ready. Bring-up sends
    /// and receives by itself and must not be mixed with the cycle. Every wait inside has a deadline, so bring-up
    /// ends. No drive is enabled at its end.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>>;

    /// Continues while other groups of the servo are still in bring-up. The servo calls this function every period
    /// after [`bring_up`](Self::bring_up) was ready. A group whose devices watch the host, or are watched, cycles with
    /// its axes off. A group whose device sends by itself reads and drops the bytes. Other groups do nothing.
    fn wait(&mut self, _now: Instant) {}

    /// Reads the received frames and updates `states`, one per axis.
    fn read(&mut self, now: Instant, states: &mut [AxisState]);

    /// Takes the commands of this cycle, one per axis, and encodes the batch for [`send`](Self::send). A batch that
    /// was not sent is replaced, never queued.
    fn write(&mut self, now: Instant, commands: &[AxisCommand]);

    /// Sends SYNC and the batch. Returns whether the port took every set-point. A refused set-point is dropped and
    /// counted, and the servo then repeats its set-points instead of advancing. An axis with a latched fault follows
    /// no set-point: a group that can attribute set-points to axes ignores such axes in the return value.
    fn send(&mut self, now: Instant) -> bool;

    /// Discards the reference of axis `axis`: its counter may have lost counts. The axis has no reference until the next
    /// homing, even if its drive reports one. A group without references does nothing.
    fn doubt_reference(&mut self, _axis: usize) {}

    /// An input of the emergency stop that is open at the last [`read`](Self::read); otherwise one that is not known.
    fn emergency_stop(&self) -> Option<EmergencyStop> {
        None
    }

    /// The counters of the group.
    fn counters(&self) -> GroupCounters;

    /// Warnings that the drives reported since the start of operation.
    fn warnings(&self) -> &Warnings {
        static NONE: Warnings = Warnings::NONE;
        &NONE
    }
}

/// An input of the emergency stop that demands a stop: its contact is open, or its level is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "emergency stop by input {input} of node {node}: {}",
    if *.known { "the contact is open" } else { "the node has a fault, and the level is not known" }
)]
pub struct EmergencyStop {
    /// Node-ID of the I/O node or drive.
    pub node: u8,
    /// Number of the input; at a drive, the bit of object 0x60FD.
    pub input: u8,
    /// Whether the node works, so that the contact is known to be open.
    pub known: bool,
}

/// Counters of a group. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroupCounters {
    /// The port's own counters.
    pub port: Counters,
    /// State of the port's controller.
    pub state: ControllerState,
    /// Nodes that sent anything during bring-up: bit *n* stands for node-ID *n*.
    pub heard: u128,
    /// Set-points dropped because the port did not take them in their cycle, or because no drive of the bus answered.
    pub dropped_setpoints: u64,
    /// Cycles whose SYNC the port did not take, and therefore no set-point either.
    pub dropped_syncs: u64,
    /// Missing answers of the drives, summed over cycles and axes.
    pub missed_answers: u64,
    /// Undecodable or unexpected frames.
    pub unexpected: u64,
    /// Time from the last SYNC sent to the last answer received for it; zero if there was none.
    pub last_bus_time: std::time::Duration,
}
