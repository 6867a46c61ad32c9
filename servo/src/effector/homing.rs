//! Homing of an effector: its axes in their order, and the return to set-points afterwards.

use std::time::Duration;

use drive::Homing;

use super::{Effector, Tick};
use crate::{ServoEvent, StopCause};

impl Effector {
    /// Monitors homing by drives and advances homing by the servo, until success, failure or time-out.
    pub(super) fn home(&mut self, tick: &Tick, waited: Duration) {
        let order = self.homing_order();
        let mut failed = None;
        for index in 0..self.axes.len() {
            let axis = &mut self.axes[index];
            match axis.state.homing {
                Homing::InProgress => axis.searched = true,
                // Before a search was seen, this is the result of an earlier search.
                Homing::Failed if axis.searched => {
                    failed = failed.or(Some((index, StopCause::HomingFailed)));
                }
                Homing::Failed | Homing::NotHomed | Homing::Attained => {}
            }
            if axis.is_searching(order)
                && let Err(failure) = axis.advance_search(tick.now, tick.dt)
            {
                failed = failed.or(Some((index, StopCause::NoReference(failure))));
            }
        }
        if let Some((axis, cause)) = failed {
            self.fail(tick, axis, cause);
        } else if self.homing_order().is_none() && self.settle() {
            self.apply(tick, ServoEvent::Done);
        } else if waited > self.homing_timeout {
            let late =
                self.first(|axis| axis.needs_homing() && order.is_none_or(|order| axis.config.homing_order == order));
            self.fail(tick, late, StopCause::HomingFailed);
        }
    }

    /// Sets the target of every axis that does not follow yet to its actual position. True once all axes follow.
    pub(super) fn settle(&mut self) -> bool {
        let mut settled = true;
        for axis in &mut self.axes {
            if !axis.follows() {
                // A loop closed by the servo takes the measured position when it starts, and holds from there.
                if !axis.is_host_closed() {
                    axis.capture();
                }
                settled = false;
            }
        }
        settled
    }

    /// The homing order whose turn it is; `None` once all axes are homed.
    pub(super) fn homing_order(&self) -> Option<u8> {
        self.axes.iter().filter(|axis| axis.needs_homing()).map(|axis| axis.config.homing_order).min()
    }
}
