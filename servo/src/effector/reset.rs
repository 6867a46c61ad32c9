//! Reset of the faults of an effector.

use std::time::Duration;

use super::{Effector, Tick};
use crate::{ServoEvent, ServoFault, StopCause};

/// Longest reset of the drives' faults. A drive that is brought up again has the deadlines of bring-up instead.
const RESET: Duration = Duration::from_secs(1);

impl Effector {
    /// Waits until no drive has a fault. A reset that fails reports why: the fault that a drive has now, or the contact of
    /// the emergency stop.
    pub(super) fn reset(&mut self, tick: &Tick, waited: Duration) {
        let late = self.axes.iter().position(|axis| axis.state.fault.is_some());
        if late.is_none() && tick.emergency.is_none() {
            self.apply(tick, ServoEvent::Done);
        } else if self.axes.iter().any(|axis| axis.state.recovering) {
            self.since = tick.now;
        } else if waited > self.enabling_timeout.min(RESET) {
            let of_drive = late.and_then(|index| self.axes[index].state.fault).map(StopCause::Drive);
            let cause = of_drive.or(tick.emergency);
            let cause = cause.unwrap_or(StopCause::NotReady { waited });
            self.fail_reset(tick, late, cause);
        }
    }

    /// Ends a reset that failed by `cause`.
    pub(super) fn fail_reset(&mut self, tick: &Tick, axis: Option<usize>, cause: StopCause) {
        // The category is that of the stop, which the reset does not change.
        let category = self.fault.map_or(cause.category(), |fault| fault.category);
        self.fault = Some(ServoFault { category, ..ServoFault::new(axis.map(|axis| axis as u8), cause) });
        self.apply(tick, ServoEvent::Fault);
    }
}
