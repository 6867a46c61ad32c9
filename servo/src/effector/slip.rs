//! Monitoring of the brakes after an orderly power-off.
//!
//! An effector that an order has switched off rests on its brakes. If a motor then moves by more than its following
//! error within the monitoring time, its brake does not hold. As part of the same stop, the servo restores the power of
//! all motors, and the motors hold the effector at its position. Motion is refused until a stop or disable order
//! acknowledges the fault.
//!
//! After a fault, an emergency stop or a reset, no power returns by itself, even if a brake slips. The check of the axes is
//! the first part of each cycle: a drive fault or an emergency stop makes the effector faulted, which ends the monitoring.

use std::time::Duration;

use can::Instant;
use drive::Power;

use super::{Effector, Tick};
use crate::{After, MAX_AXES, ServoEvent, ServoState, StopCause};

/// Time after the power-off in which a brake shows whether it holds.
const WATCH: Duration = Duration::from_secs(1);

/// Where the motors came to rest, rad, and the time of the power-off.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest {
    since: Instant,
    at: [f64; MAX_AXES],
}

impl Effector {
    /// Begins the watch if the effector was switched off by an order, in the transition from `last` to `next`.
    pub(super) fn begin_brake_watch(&mut self, last: ServoState, next: ServoState, tick: &Tick) {
        use ServoState::{Braking, Enabling, Halting, Standing};
        let orderly = matches!(last, Standing | Enabling | Braking(After::Off) | Halting(After::Off));
        let watched = next == ServoState::Off && orderly;
        self.rest = watched.then(|| Rest { since: tick.now, at: self.each(|axis| axis.state.position) });
    }

    /// Gives an effector its power again whose brake does not hold.
    pub(super) fn watch_brakes(&mut self, tick: &Tick) {
        let Some(mut rest) = self.rest.filter(|rest| tick.now.since(rest.since) <= WATCH) else {
            self.rest = None;
            return;
        };
        let mut slipping = None;
        for (index, axis) in self.axes.iter().enumerate().filter(|(_, axis)| axis.state.age == 0) {
            // A drive that still brakes or holds the motor does not rest on its brake.
            if axis.state.power != Power::Off {
                rest.at[index] = axis.state.position;
            }
            let travel = axis.state.position - rest.at[index];
            if axis.config.brake_watch && travel.abs() > axis.config.following_error {
                slipping = slipping.or(Some((index, travel)));
            }
        }
        self.rest = Some(rest);
        if let Some((index, travel)) = slipping {
            self.rest = None;
            self.latch(Some(index), StopCause::BrakeSlips { travel });
            self.apply(tick, ServoEvent::Slip);
            self.news = true;
        }
    }

    /// Whether the motors hold the effector because a brake does not. A request to stop then leaves the power on.
    pub(crate) fn holds_for_brake(&self) -> bool {
        let slips = self.fault.is_some_and(|fault| matches!(fault.cause, StopCause::BrakeSlips { .. }));
        slips && matches!(self.state, ServoState::Enabling | ServoState::Standing)
    }
}
