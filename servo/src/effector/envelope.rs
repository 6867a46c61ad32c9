//! The envelope of a stop: bounds of the position and velocity of each motor. See [`ServoState`].

use std::time::Duration;

use drive::Power;

use super::Effector;
use crate::axis::ServoAxis;
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
    /// Measured position of each motor, rad.
    start: [f64; MAX_AXES],
    /// Speed of each motor, rad/s.
    speed: [f64; MAX_AXES],
    /// Number of samples in a row, up to the last, in which each motor was too fast for its stop.
    too_fast: [u32; MAX_AXES],
}

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

    /// The cause by which the motor of axis `index` leaves the envelope of its stop: it can rest neither within the bound
    /// beyond the end of the stop, nor within one following error behind the beginning.
    pub(super) fn not_braking(&mut self, index: usize) -> Option<StopCause> {
        if !self.is_braking() || self.axes[index].state.age > 0 {
            return None;
        }
        let (end, start) = (self.stop.rest(index), self.envelope.start[index]);
        let axis = &self.axes[index];
        let (acceleration, error) = (axis.config.max_acceleration, axis.config.following_error);
        // The room that is left beyond the end, and behind the beginning, for a motor that rests at a position.
        let room = |rest: f64| {
            let beyond = self.envelope.beyond[index] + error - self.stop.ahead(index, rest - end);
            [beyond, error + self.stop.ahead(index, rest - start)]
        };
        let [beyond, behind] = room(rest_of(axis));
        let too_fast = if beyond >= 0.0 && behind >= 0.0 { 0 } else { self.envelope.too_fast[index] + 1 };
        self.envelope.too_fast[index] = too_fast;
        if too_fast < TOO_FAST {
            return None;
        }
        let left = room(axis.state.position)[usize::from(beyond >= 0.0)];
        let limit = (2.0 * acceleration * left.max(0.0)).sqrt();
        Some(StopCause::NotBraking { velocity: axis.state.velocity.abs(), limit })
    }

    /// Sets the envelope of a stop at the present distances.
    pub(super) fn set_envelope(&mut self) {
        let mut envelope = Envelope::default();
        for (index, axis) in self.axes.iter().enumerate() {
            envelope.ahead[index] = self.stop.ahead(index, -axis.error()).max(0.0);
            envelope.beyond[index] = self.stop.ahead(index, rest_of(axis) - self.stop.rest(index)).max(0.0);
            envelope.start[index] = axis.state.position;
            envelope.speed[index] = axis.state.velocity.abs();
        }
        self.envelope = envelope;
    }

    /// The first axis whose motor does not brake in a stop of homing, `waited` after its beginning. Such a motor still has
    /// more than half of its speed after the longest stop. The ramp of a drive may be longer than this time. A drive with a
    /// fault does not brake its motor.
    pub(super) fn not_halting(&self, waited: Duration) -> Option<(usize, StopCause)> {
        if waited < self.longest_stop() {
            return None;
        }
        let moving = |(index, axis): (usize, &ServoAxis)| {
            let (velocity, limit) =
                (axis.state.velocity.abs(), (0.5 * self.envelope.speed[index]).max(axis.still_below()));
            let braked = axis.state.fault.is_none() && axis.state.power == Power::On && axis.state.age == 0;
            (braked && velocity > limit).then_some((index, StopCause::NotBraking { velocity, limit }))
        };
        self.axes.iter().enumerate().find_map(moving)
    }
}

/// Position, rad, at which a motor rests if it brakes with its greatest acceleration from now on.
fn rest_of(axis: &ServoAxis) -> f64 {
    let velocity = axis.state.velocity;
    axis.state.position + velocity * velocity.abs() / (2.0 * axis.config.max_acceleration)
}
