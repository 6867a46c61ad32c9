//! The force/torque sensors of a bus: their frames, and the samples that end bring-up.

use can::{Instant, Port, Received};
use canopen::sync::Sync;

use super::CanBus;
use crate::BringUpError;
use crate::wrench::WrenchNode;

impl<P: Port> CanBus<P> {
    /// Takes a frame of a sample. `None` for any other frame; `Some(None)` for an undecodable frame of a sample.
    pub(super) fn take_sample(&mut self, Received { frame, at }: &Received) -> Option<Option<()>> {
        let id = frame.standard_data_id()?;
        let mut sensors = self.sensors.iter_mut();
        let (sensor, index) = sensors.find_map(|sensor| sensor.frame(id).map(|index| (sensor, index)))?;
        Some(sensor.take(index, frame.data(), *at, &self.syncs))
    }

    /// Whether every sensor has sent samples at its declared rate, after all nodes are operational. Sends SYNC until
    /// then, once per period, if a sensor needs SYNC.
    pub(super) fn sensors_are_ready(&mut self, now: Instant) -> Result<bool, BringUpError> {
        let synced = std::mem::take(&mut self.syncs.sent);
        let mut ready = true;
        for sensor in &mut self.sensors {
            ready &= sensor.is_ready(now, synced)?;
        }
        let due = self.syncs.last.is_none_or(|last| now.since(last) >= self.config.period);
        if !ready && due && self.sensors.iter().any(WrenchNode::needs_sync) {
            let taken = self.port.send(now, &[Sync::default().encode()])?;
            self.syncs.send(now, taken > 0);
        }
        Ok(ready)
    }
}
