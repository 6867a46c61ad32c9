//! Excitation of a loop for its measurement.

use std::ops::RangeInclusive;

use thiserror::Error;

use crate::{PositionLoop, ServoAxisConfig};

/// Greatest excitation as a share of the loop's output limit, of the rated torque, or of the following error.
const SHARE: f64 = 0.25;

/// A sequence added at an axis while it moves; see [`Servo::excite`](crate::Servo::excite).
///
/// Where the servo closes the position loop, the sequence is added to the output of the law, in the unit of the output
/// (rad/s, N·m or a duty). Where the drive closes the loop, the sequence is a torque, N·m, sent beside the position, if the
/// drive takes one ([`ServoAxisConfig::torque_offset`]). Otherwise the sequence is added to the commanded position, rad.
#[derive(Clone, Debug, PartialEq)]
pub struct Excitation {
    /// One value per cycle; it repeats.
    pub period: Vec<f64>,
    /// Numbers of the macrosteps in which it is added.
    pub macrosteps: RangeInclusive<u64>,
}

/// Why an axis is not excited so. Indices count from zero.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ExcitationError {
    /// There is no such axis.
    #[error("effector {effector} has no axis {axis}")]
    NoSuchAxis {
        /// The effector.
        effector: usize,
        /// The axis.
        axis: usize,
    },
    /// It has no value, or one that is not a number.
    #[error("an excitation of no value, or of one that is not a number")]
    NotFinite,
    /// It is greater than a quarter of what the loop may put out, of the rated torque, or of the following error.
    #[error(
        "an amplitude of {amplitude} is beyond the limit of {limit} at this axis; ask for less"
    )]
    Amplitude {
        /// Greatest value.
        amplitude: f64,
        /// The most that is allowed.
        limit: f64,
    },
    /// Added to positions it would need a greater acceleration than the axis may have.
    #[error(
        "an excitation that needs {acceleration:.0} rad/s² is beyond the limit of {limit:.0} rad/s² at this axis; \
         ask for a lower amplitude or frequency"
    )]
    Acceleration {
        /// Greatest acceleration of it, rad/s².
        acceleration: f64,
        /// The most that is allowed, rad/s².
        limit: f64,
    },
}

impl Excitation {
    /// Whether `axis` may be excited so, at a period of `dt` seconds.
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
            let bends = (0..values.len()).map(|index| bend(index).abs());
            let acceleration = bends.fold(0.0, f64::max) / (dt * dt);
            let limit = axis.max_acceleration;
            if acceleration > limit {
                return Err(ExcitationError::Acceleration {
                    acceleration,
                    limit,
                });
            }
        }
        Ok(())
    }
}

/// The greatest amplitude of an excitation of an axis, in its unit.
pub fn most(axis: &ServoAxisConfig) -> f64 {
    SHARE
        * match &axis.position_loop {
            PositionLoop::Drive => axis.torque_offset.unwrap_or(axis.following_error),
            PositionLoop::Host(host) => host.law.limit(),
        }
}

/// An excitation at work.
#[derive(Clone, Debug)]
pub(crate) struct Playing {
    period: Box<[f64]>,
    macrosteps: RangeInclusive<u64>,
    next: usize,
}

impl Playing {
    pub(crate) fn new(excitation: Excitation) -> Self {
        Self {
            period: excitation.period.into(),
            macrosteps: excitation.macrosteps,
            next: 0,
        }
    }

    /// The value of a cycle in macrostep `number`; nothing while the effector does anything else.
    pub(crate) fn value(&mut self, number: Option<u64>) -> f64 {
        if !number.is_some_and(|number| self.macrosteps.contains(&number)) {
            return 0.0;
        }
        let value = self.period[self.next];
        self.next = (self.next + 1) % self.period.len();
        value
    }
}
