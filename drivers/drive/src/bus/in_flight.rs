//! Frames in flight: the bound of one cycle, set-points withheld from a silent bus, the stops after a bus that took or
//! answered nothing, and the missing acknowledgement.

use std::time::Duration;

use can::{ControllerState, Instant, Port, PortError};
use canopen::sync::Sync;

use super::{BESIDE_SETPOINTS, CanBus};
use crate::Fault;
use crate::cia402::Conditions;

/// SYNCs in a row without an answer of any drive, after which set-points are withheld. A buffer that holds the frames of the
/// host, such as an slcan adapter, therefore holds the set-points of at most this number of cycles.
const UNANSWERED: u32 = 2;

/// Longest silence of all drives in which orders to stop are withheld from drives that stand by themselves.
const WAITING: Duration = Duration::from_secs(1);

/// Time in which a drive takes up its last target after a jump to held set-points. A quick stop that began earlier would begin
/// at the velocity of the jump, and end far away.
const SETTLING: Duration = Duration::from_millis(20);

/// The frames that may wait between host and drives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InFlight {
    /// Cycles in a row, up to the last, in which the port took no frame of the batch.
    refused: u32,
    /// SYNCs in a row that the port took and no drive answered.
    unanswered: u32,
    /// Time of the last answer of a drive.
    answered: Option<Instant>,
    /// End of the settling after a silence of all drives.
    settled_at: Option<Instant>,
    /// RPDOs for torque of this cycle that are withheld.
    withheld: usize,
    /// The drives may hold controlwords for torque, which wait for the next SYNC.
    for_torque: bool,
}

impl<P: Port> CanBus<P> {
    /// Bounds the motion frames in flight to one cycle: the port refuses a batch while SYNC or a set-point of an earlier
    /// cycle waits for the bus. Outputs, the heartbeat and the service frame leave behind the set-points and may wait.
    pub(super) fn bound_frames_in_flight(&mut self) -> Result<(), PortError> {
        self.in_flight = InFlight::default();
        self.port.bound_unsent(self.io.len() + BESIDE_SETPOINTS - 1)
    }

    /// Begins the batch of a cycle: with SYNC, if the nodes need SYNC.
    ///
    /// If every drive is being stopped, the first batch after refused ones has no SYNC, and so has the first batch of
    /// stops after an unanswered SYNC. Set-points of earlier batches may reach the drives together with this batch, and
    /// are too old. The stops replace them before the next SYNC, so no drive acts on them (CiA 301 §7.2.2.2: a
    /// synchronous RPDO takes effect at the next SYNC).
    pub(super) fn begin_batch(&mut self) {
        self.batch.clear();
        let InFlight { refused, unanswered, for_torque, .. } = self.in_flight;
        let replaces = (refused > 0 || unanswered > 0 && for_torque) && self.drives.are_stopped();
        self.batch_syncs = usize::from(self.needs_sync && !replaces && !self.leaves_out);
        self.batch.extend((self.batch_syncs > 0).then(|| Sync::default().encode()));
        self.in_flight.withheld = 0;
    }

    /// Conditions of this cycle for the RPDOs of the drives.
    ///
    /// If no drive of the bus answered the last SYNCs, the frames of the host may wait in a buffer. RPDOs for torque are
    /// withheld, and SYNC alone asks for an answer. A drive in a position mode then stands at its last target. Orders to stop
    /// are withheld from this drive too, until it has settled after an answer, or until the drive itself has missed the
    /// host.
    pub(super) fn conditions(&self, now: Instant) -> Conditions {
        let InFlight { unanswered, answered, settled_at, .. } = self.in_flight;
        let withholds = unanswered >= UNANSWERED;
        let longest = self.config.heartbeat_lost_after().min(WAITING);
        let silent = withholds && answered.is_some_and(|answered| now.since(answered) < longest);
        let settles = settled_at.is_some_and(|settled| now < settled);
        let leaves_out = self.leaves_out;
        Conditions { watched: self.heartbeat.watched, withholds, waits: silent || settles, leaves_out }
    }

    /// Notes the set-points of this cycle that were withheld, and whether the batch has controlwords for torque.
    pub(super) fn note_setpoints(&mut self, withheld: usize, for_torque: bool) {
        (self.in_flight.withheld, self.in_flight.for_torque) = (withheld, for_torque);
    }

    /// Whether the port took the last batch, and a drive answered its SYNC.
    pub(super) fn is_answered_and_taken(&self) -> bool {
        self.in_flight.refused == 0 && self.in_flight.unanswered == 0
    }

    /// Set-points of this cycle that were withheld.
    pub(super) fn withheld(&self) -> usize {
        self.in_flight.withheld
    }

    /// Notes how many drives did not answer the last SYNC.
    pub(super) fn note_answers(&mut self, missed: u64, now: Instant) {
        let drives = self.drives.axes() as u64;
        if missed < drives {
            if self.in_flight.unanswered >= UNANSWERED {
                self.in_flight.settled_at = self.drives.are_stopped().then_some(now + SETTLING);
            }
            (self.in_flight.unanswered, self.in_flight.answered) = (0, Some(now));
        } else if self.syncs.sent && drives > 0 {
            self.in_flight.unanswered = self.in_flight.unanswered.saturating_add(1);
        }
    }

    /// Counts the cycles in a row in which the port took no frame.
    pub(super) fn count_refused(&mut self, taken: usize) {
        let refused = taken == 0 && !self.batch.is_empty();
        self.in_flight.refused = if refused { self.in_flight.refused.saturating_add(1) } else { 0 };
    }

    /// Latches that no node acknowledges the host's frames. A full queue alone leaves the controller error active. Checked
    /// before the silence of the drives, which is a consequence.
    pub(super) fn check_acknowledgement(&mut self) {
        let cycles = self.in_flight.refused;
        if self.port.state() == ControllerState::Passive && cycles >= self.config.tolerated_missing.max(1) {
            self.drives.latch_all(Fault::NotAcknowledged { cycles }, &mut self.members);
        }
    }
}
