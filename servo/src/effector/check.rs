//! Checks of the axes in each cycle.

use super::{Effector, Tick};
use crate::config::FrozenWatch;
use crate::{ServoState, StopCause};

/// Commanded speed, rad/s, below which an axis at a limit switch counts as at rest. The speed covers rounding errors
/// of generators.
const CREEP: f64 = 1e-3;

impl Effector {
    /// Checks drive faults, following errors, limit switches and overruns, and updates the tracking statistics.
    ///
    /// A closed limit switch stops an effector that continues towards the switch, or that the switch holds back from
    /// its commanded position. An axis may rest on the switch or move away from the switch.
    ///
    /// A reset under way decides about drive faults by itself, and about a contact of the emergency stop that is not
    /// known: the level of a contact at a drive that is brought up again is known only at the end.
    pub(super) fn check(&mut self, tick: &Tick) {
        match (tick.emergency, self.state) {
            (None, _) => {}
            (Some(StopCause::EmergencyStop { contact, .. }), ServoState::Resetting) if !contact.known => {}
            (Some(emergency), ServoState::Resetting) => self.fail_reset(tick, None, emergency),
            (Some(emergency), _) => self.fail(tick, None, emergency),
        }
        if let Some(missed) = tick.overrun {
            // In the missed cycles, the drives stood at their last set-points or continued by them.
            let late = tick.periods - 1;
            self.axes.iter_mut().for_each(|axis| axis.rest(late, tick.dt));
            self.fail(tick, None, StopCause::Overrun { missed });
        }
        if let Some(overload) = tick.overload {
            self.fail(tick, None, overload);
        }
        for index in 0..self.axes.len() {
            let axis = &mut self.axes[index];
            if let Some(fault) = axis.state.fault {
                if self.state != ServoState::Resetting {
                    self.fail(tick, index, StopCause::Drive(fault));
                }
                continue;
            }
            let (error, limit) = (axis.error(), axis.config.following_error);
            let commanding = matches!(self.state, ServoState::Standing | ServoState::Moving | ServoState::Braking(_));
            let homing = self.state == ServoState::Homing;
            if self.refused > 0 || self.held {
                axis.was_refused();
            }
            if let Some(travel) = axis.frozen_in_homing().filter(|_| homing) {
                self.freeze(tick, index, travel);
                continue;
            }
            if !axis.is_watched() || !commanding && !axis.is_led() {
                continue;
            }
            if let Some((velocity, limit)) = axis.runaway() {
                self.axes[index].doubted = true;
                self.lose(tick, index, StopCause::Runaway { velocity, limit });
                continue;
            }
            if tick.overrun.is_some() && axis.is_host_closed() {
                // The commands were adapted to the missed deadlines, but the sample is older.
                continue;
            }
            axis.track(error, self.state);
            let elapsed = f64::from(tick.periods) * tick.dt;
            if let Some(found) = axis.watch_oscillation(error, tick.number, elapsed) {
                axis.doubted = true;
                self.lose(tick, index, StopCause::Oscillates(found));
                continue;
            }
            let searching = matches!(self.state, ServoState::Homing | ServoState::Halting(_))
                && axis.config.frozen == FrozenWatch::Always;
            if let Some(travel) = axis.frozen(error).filter(|_| commanding || searching) {
                self.freeze(tick, index, travel);
                continue;
            }
            let beyond = error.abs() > limit;
            // Direction of the last command, or of the position that the motor does not reach.
            let sense = if beyond { error } else { axis.knot.velocity };
            let judged = commanding && (beyond || sense.abs() > CREEP);
            let switch = axis.limit_switch(sense).filter(|_| judged);
            let cause = StopCause::FollowingError { error, limit };
            let beyond = beyond || error.is_nan();
            if let Some(upper) = switch {
                // The drive itself stops this axis at the switch, and the loop of the axis works. The servo brakes the
                // other axes.
                self.fail(tick, index, StopCause::LimitSwitch { upper });
            } else if beyond {
                // The counter of an encoder that fails may be the cause, and a blocked motor cannot be told from it.
                self.axes[index].doubted = true;
                if self.axes[index].is_host_closed() {
                    self.lose(tick, index, cause);
                } else {
                    self.fail(tick, index, cause);
                }
            }
            if beyond && !self.is_within_envelope(index) {
                self.lose(tick, index, cause);
            }
            if let Some(cause) = self.not_braking(index) {
                self.axes[index].doubted = true;
                if self.brakes_to_power_off() || self.axes[index].is_host_closed() {
                    self.lose(tick, index, cause);
                } else {
                    self.fail(tick, index, cause);
                }
            }
        }
    }

    /// Cuts the power of axis `index`, whose measured position stands still although its motor must have moved by
    /// `travel`, rad. No loop can brake such an axis. The other axes brake. The counter may have lost counts.
    fn freeze(&mut self, tick: &Tick, index: usize, travel: f64) {
        (self.axes[index].cut, self.axes[index].doubted) = (true, true);
        self.fail(tick, index, StopCause::Frozen { travel });
    }
}
