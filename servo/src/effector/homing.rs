//! Homing of an effector: its axes in their order, and the return to set-points at its end.

use std::time::Duration;

use drive::Homing;

use super::{Effector, Tick};
use crate::axis::Axis;
use crate::{Event, StopCause};

impl Effector {
    /// Watches homing by drives and moves on homing by the servo: a search that failed, the time-out,
    /// the end.
    pub(super) fn home(&mut self, tick: &Tick, waited: Duration) {
        let order = self.homing_order();
        let mut failed = None;
        for index in 0..self.axes.len() {
            let axis = &mut self.axes[index];
            match axis.state.homing {
                Homing::InProgress => axis.searched = true,
                // Before the search was seen, it is the verdict on an earlier one.
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
            self.apply(tick, Event::Done);
        } else if waited > self.homing_timeout {
            let late = self.first(|axis| {
                axis.needs_homing() && order.is_none_or(|order| axis.config.homing_order == order)
            });
            self.fail(tick, late, StopCause::HomingFailed);
        }
    }

    /// Target := actual for every axis that does not follow yet; true once all do.
    pub(super) fn settle(&mut self) -> bool {
        let mut settled = true;
        for axis in &mut self.axes {
            if !axis.follows() {
                // A loop closed here captures as it begins, and holds from there.
                if !axis.is_host_closed() {
                    axis.capture();
                }
                settled = false;
            }
        }
        settled
    }

    /// The order whose turn it is to home; `None` once all are.
    pub(super) fn homing_order(&self) -> Option<u8> {
        let missing = self.axes.iter().filter(|axis| axis.needs_homing());
        missing.map(|axis: &Axis| axis.config.homing_order).min()
    }
}
