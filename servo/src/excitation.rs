//! Excitation of a loop for its measurement.

use std::ops::RangeInclusive;

use thiserror::Error;

use crate::{PositionLoop, ServoAxisConfig};

/// Greatest excitation as a share of the loop's output limit, of the rated torque, or of the following error.
const SHARE: f64 = 0.25;

/// A sequence added at an axis during motion; see [`Servo::excite`](crate::Servo::excite).
///
/// Where the servo closes the position loop, the sequence is added to the output of the law, in the unit of the output
/// (rad/s, N·m or a duty). Where the drive closes the loop, the sequence is a torque, N·m, sent beside the position, if
/// the drive takes one ([`ServoAxisConfig::torque_offset`]). Otherwise the sequence is added to the commanded position,
/// rad.
#[derive(Clone, Debug, PartialEq)]
pub struct Excitation {
    /// One value per cycle; the sequence repeats.
    pub period: Vec<f64>,
    /// Numbers of the macrosteps during which the sequence is added.
    pub macrosteps: RangeInclusive<u64>,
}

/// Why an excitation is refused. Indices count from zero.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum ExcitationError {
    #[error("effector {effector} has no axis {axis}")]
    NoSuchAxis { effector: usize, axis: usize },
    /// The sequence is empty, or has a value that is not finite.
    #[error("an excitation of no value, or of one that is not a number")]
    NotFinite,
    /// The amplitude exceeds a quarter of the loop's output limit, of the rated torque, or of the following error.
    #[error("an amplitude of {amplitude} is beyond the limit of {limit} at this axis; ask for less")]
    Amplitude { amplitude: f64, limit: f64 },
    /// The excitation of the position needs more acceleration than the axis permits.
    #[error(
        "an excitation that needs {acceleration:.0} rad/s² is beyond the limit of {limit:.0} rad/s² at this axis; \
         ask for a lower amplitude or frequency"
    )]
    Acceleration { acceleration: f64, limit: f64 },
}

impl Excitation {
    /// Checks the excitation for `axis` at a period of `dt` seconds.
    pub(crate) fn check(&self, axis: &ServoAxisConfig, dt: f64) -> Result<(), ExcitationError> {
        let values = &self.period;
        if values.is_empty() || !values.iter().all(|value| value.is_finite()) {
            return Err(ExcitationError::NotFinite);
        }
        let amplitude = values.iter().fold(0.0, |most: f64, it| most.max(it.abs()));
        let limit = most(axis);
        if amplitude > limit {
            return Err(ExcitationError::Amplitude { amplitude, limit });
        }
        if axis.position_loop == PositionLoop::Drive && axis.torque_offset.is_none() {
            let at = |index: usize| values[index % values.len()];
            let bend = |index| at(index + 2) - 2.0 * at(index + 1) + at(index);
            let acceleration = (0..values.len()).map(|index| bend(index).abs()).fold(0.0, f64::max) / (dt * dt);
            let limit = axis.max_acceleration;
            if acceleration > limit {
                return Err(ExcitationError::Acceleration { acceleration, limit });
            }
        }
        Ok(())
    }
}

/// The greatest permitted amplitude of an excitation of an axis, in the unit of the excitation.
pub fn most(axis: &ServoAxisConfig) -> f64 {
    SHARE
        * match &axis.position_loop {
            PositionLoop::Drive => axis.torque_offset.unwrap_or(axis.following_error),
            PositionLoop::Host(host) => host.law.limit(),
        }
}

#[derive(Clone, Debug)]
pub(crate) struct Playing {
    excitation: Excitation,
    next: usize,
}

impl Playing {
    pub(crate) fn new(excitation: Excitation) -> Self {
        Self { excitation, next: 0 }
    }

    /// The value for a cycle in macrostep `number`; zero outside the excited macrosteps.
    pub(crate) fn value(&mut self, number: Option<u64>) -> f64 {
        let Excitation { period, macrosteps } = &self.excitation;
        if !number.is_some_and(|number| macrosteps.contains(&number)) {
            return 0.0;
        }
        let value = period[self.next];
        self.next = (self.next + 1) % period.len();
        value
    }
}
