//! Frames in flight: the bound of one cycle, the stops after a bus that took nothing, and the missing acknowledgement.

use can::{ControllerState, Port, PortError};
use canopen::sync::Sync;

use super::{BESIDE_SETPOINTS, CanBus};
use crate::Fault;

impl<P: Port> CanBus<P> {
    /// Bounds the motion frames in flight to one cycle: the port refuses a batch while SYNC or a set-point of an earlier
    /// cycle waits for the bus. Outputs, the heartbeat and the service frame leave behind the set-points and may wait.
    pub(super) fn bound_frames_in_flight(&mut self) -> Result<(), PortError> {
        self.refused = 0;
        self.port.bound_unsent(self.io.len() + BESIDE_SETPOINTS - 1)
    }

    /// Begins the batch of a cycle: with SYNC, if the nodes need SYNC.
    ///
    /// The first batch after refused ones has no SYNC if every drive is being stopped. Set-points of the last accepted
    /// batch may reach the drives together with this batch, and are too old. The stops replace them before the next
    /// SYNC, so no drive acts on them (CiA 301 §7.2.2.2: a synchronous RPDO takes effect at the next SYNC).
    pub(super) fn begin_batch(&mut self) {
        self.batch.clear();
        let replaces = self.refused > 0 && self.drives.are_stopped();
        self.batch_syncs = usize::from(self.needs_sync && !replaces);
        self.batch.extend((self.batch_syncs > 0).then(|| Sync::default().encode()));
    }

    /// Counts the cycles in a row in which the port took no frame.
    pub(super) fn count_refused(&mut self, taken: usize) {
        let refused = taken == 0 && !self.batch.is_empty();
        self.refused = if refused { self.refused.saturating_add(1) } else { 0 };
    }

    /// Latches that no node acknowledges the host's frames. A full queue alone leaves the controller error active. Checked
    /// before the silence of the drives, which is a consequence.
    pub(super) fn check_acknowledgement(&mut self) {
        let cycles = self.refused;
        if self.port.state() == ControllerState::Passive && cycles >= self.config.tolerated_missing.max(1) {
            self.drives.latch_all(Fault::NotAcknowledged { cycles }, &mut self.members);
        }
    }
}
