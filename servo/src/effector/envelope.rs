//! The envelope of a stop: bounds of the position and velocity of each motor. See [`ServoState`].

use std::time::Duration;

use drive::Power;

use super::Effector;
use crate::{After, MAX_AXES, ServoState, StopCause};

/// Number of samples in a row in which a motor must be too fast for its stop. A single sample that was taken early or late
/// shows a wrong velocity.
const TOO_FAST: u32 = 3;

/// The envelope of a stop, when it was set. Lengths are in the direction of the stop, rad, and not below zero.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Envelope {
    /// Distance of each motor ahead of its set-point.
    ahead: [f64; MAX_AXES],
    /// Distance beyond the end of the stop at which each motor can rest.
    beyond: [f64; MAX_AXES],
    /// Speed of each motor, rad/s, at the beginning of a stop by its drive.
    speed: [f64; MAX_AXES],
}

/// Time in which a drive that stops its own motion must begin to brake.
const BEGUN_WITHIN: Duration = Duration::from_millis(20);

impl Effector {
    /// Whether the motor of axis `index`, beyond its following error, is within the envelope of a stop of category 1. A
    /// stop of category 2 has its envelope in the following error itself.
    pub(super) fn is_within_envelope(&self, index: usize) -> bool {
        let axis = &self.axes[index];
        let ahead = self.stop.ahead(index, -axis.error());
        !self.brakes_to_power_off() || ahead <= self.envelope.ahead[index] + axis.config.following_error
    }

    /// Whether the servo brakes the effector in a stop of category 1.
    pub(super) fn brakes_to_power_off(&self) -> bool {
        matches!(self.state, ServoState::Braking(After::Off | After::Fault))
    }

    /// The cause by which the motor of axis `index` leaves the envelope of its stop, if it is too fast to come to rest
    /// within the envelope.
    pub(super) fn not_braking(&mut self, index: usize) -> Option<StopCause> {
        if !self.is_braking() || self.axes[index].state.age > 0 {
            return None;
        }
        let beyond = self.beyond(index);
        let axis = &mut self.axes[index];
        let permitted = self.envelope.beyond[index] + axis.config.following_error;
        axis.too_fast = if beyond > permitted { axis.too_fast + 1 } else { 0 };
        if axis.too_fast < TOO_FAST {
            return None;
        }
        let (velocity, acceleration) = (axis.state.velocity, axis.config.max_acceleration);
        // The way that is left, and the velocity from which this way suffices.
        let room = (permitted - beyond + velocity * velocity / (2.0 * acceleration)).max(0.0);
        Some(StopCause::NotBraking { velocity: velocity.abs(), limit: (2.0 * acceleration * room).sqrt() })
    }

    /// Way of the motor of axis `index` beyond the end of its stop, rad, in the direction of the stop, if it brakes with its
    /// greatest acceleration from now on.
    fn beyond(&self, index: usize) -> f64 {
        let axis = &self.axes[index];
        let velocity = axis.state.velocity;
        let rest = axis.state.position + velocity * velocity.abs() / (2.0 * axis.config.max_acceleration);
        self.stop.ahead(index, rest - self.stop.rest(index))
    }

    /// Sets the envelope of a stop at the present distances.
    pub(super) fn set_envelope(&mut self) {
        let mut envelope = Envelope::default();
        for (index, axis) in self.axes.iter().enumerate() {
            envelope.ahead[index] = self.stop.ahead(index, -axis.error()).max(0.0);
            envelope.beyond[index] = self.beyond(index).max(0.0);
            envelope.speed[index] = axis.state.velocity.abs();
        }
        self.envelope = envelope;
        self.axes.iter_mut().for_each(|axis| axis.too_fast = 0);
    }

    /// The first axis whose motor does not brake in a stop of homing, `waited` after its beginning: a stop whose set-points
    /// the drive finds. The permitted speed falls from the speed at the beginning to a standstill within the longest stop of
    /// the effector, 20 ms late. An axis with a fault is not braked by its drive.
    pub(super) fn not_halting(&mut self, waited: Duration) -> Option<(usize, StopCause)> {
        let share = 1.0 - waited.saturating_sub(BEGUN_WITHIN).as_secs_f64() / self.longest_stop().as_secs_f64();
        for (index, axis) in self.axes.iter_mut().enumerate().filter(|(_, axis)| axis.state.age == 0) {
            let (speed, limit) =
                (axis.state.velocity.abs(), (self.envelope.speed[index] * share).max(axis.still_below()));
            let fast = axis.state.fault.is_none() && axis.state.power == Power::On && speed > limit;
            axis.too_fast = if fast { axis.too_fast + 1 } else { 0 };
            if axis.too_fast >= TOO_FAST {
                return Some((index, StopCause::NotBraking { velocity: speed, limit }));
            }
        }
        None
    }
}
