//! Motion from rest to rest by a polynomial of time.

use std::time::Duration;

use servo::MAX_AXES;

use super::{
    Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, newsmooth::whole_macrosteps,
};
use crate::robot::Space;

/// A straight motion of all axes from rest to rest, by a cubic or a quintic of time. Class 0, planned from the effector.
///
/// The macrosteps last [one servo period](Pace::PERIOD): each set-point is a sample of the polynomial. Without
/// [`lasting`](Self::lasting), the duration is the shortest within the limits, rounded up to whole periods. For a
/// distance d, velocity v, acceleration a and jerk j, the slowest axis determines it:
///
/// | | velocity | acceleration | jerk |
/// |---|---|---|---|
/// | cubic | 3 d / (2 v) | √(6 d / a) | ∛(12 d / j) |
/// | quintic | 15 d / (8 v) | √(10 d / (√3 a)) | ∛(60 d / j) |
///
/// A quintic has no jump of the acceleration at its ends. The acceleration of a cubic begins and ends with a jump.
#[derive(Clone, Debug)]
pub struct Polynomial {
    space: Space,
    axes: usize,
    limits: MotionLimits,
    target: Axes,
    degree: Degree,
    given: Option<Duration>,
    start: Axes,
    macrosteps: u32,
    /// Duration of the motion, s.
    duration: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Degree {
    Cubic,
    Quintic,
}

impl Degree {
    /// Greatest first to third derivative over the unit interval.
    fn peaks(self) -> [f64; 3] {
        match self {
            Self::Cubic => [1.5, 6.0, 12.0],
            Self::Quintic => [1.875, 10.0 / 3f64.sqrt(), 60.0],
        }
    }

    /// Value and first two derivatives of the step from 0 to 1 at `u`, 0 to 1.
    fn at(self, u: f64) -> [f64; 3] {
        match self {
            Self::Cubic => [u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u), 6.0 - 12.0 * u],
            Self::Quintic => quintic_step(u),
        }
    }
}

/// Value and first two derivatives of the quintic step from 0 to 1 at `u`, 0 to 1.
pub(super) fn quintic_step(u: f64) -> [f64; 3] {
    let rest = 1.0 - u;
    [u * u * u * (10.0 - u * (15.0 - 6.0 * u)), 30.0 * (u * rest) * (u * rest), 60.0 * u * rest * (1.0 - 2.0 * u)]
}

impl Polynomial {
    /// A cubic motion of the first `axes` axes to `target`.
    pub fn cubic(space: Space, axes: usize, limits: MotionLimits, target: Axes) -> Result<Self, GeneratorError> {
        Self::new(space, axes, limits, target, Degree::Cubic)
    }

    /// A quintic motion of the first `axes` axes to `target`.
    pub fn quintic(space: Space, axes: usize, limits: MotionLimits, target: Axes) -> Result<Self, GeneratorError> {
        Self::new(space, axes, limits, target, Degree::Quintic)
    }

    /// The same motion, lasting `duration`, rounded up to whole periods. The first step refuses a time that is too
    /// short.
    #[must_use]
    pub fn lasting(self, duration: Duration) -> Self {
        Self { given: Some(duration), ..self }
    }

    fn new(
        space: Space,
        axes: usize,
        limits: MotionLimits,
        target: Axes,
        degree: Degree,
    ) -> Result<Self, GeneratorError> {
        limits.check(axes)?;
        if let Some(axis) = target[..axes].iter().position(|target| !target.is_finite()) {
            return Err(GeneratorError::NotFinite { pose: 0, axis: axis as u8 });
        }
        let start = [0.0; MAX_AXES];
        Ok(Self { space, axes, limits, target, degree, given: None, start, macrosteps: 0, duration: 0.0 })
    }

    /// The shortest duration within the limits, s.
    fn shortest(&self) -> f64 {
        let [velocity, acceleration, jerk] = self.degree.peaks();
        let needed = |axis: usize| {
            let distance = (self.target[axis] - self.start[axis]).abs();
            let by_velocity = velocity * distance / self.limits.max_velocity[axis];
            let by_acceleration = (acceleration * distance / self.limits.max_acceleration[axis]).sqrt();
            let by_jerk = (jerk * distance / self.limits.max_jerk[axis]).cbrt();
            by_velocity.max(by_acceleration).max(by_jerk)
        };
        (0..self.axes).map(needed).fold(0.0, f64::max)
    }
}

impl Generator for Polynomial {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.start = self.space.commanded(e).position;
        let needed = self.shortest();
        let given = self.given.map_or(needed, |given| given.as_secs_f64());
        if given < needed {
            return Err(GeneratorError::TooShort { needed, given });
        }
        self.macrosteps = whole_macrosteps(given, macrostep.as_secs_f64())?;
        self.duration = f64::from(self.macrosteps) * macrostep.as_secs_f64();
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &()) -> bool {
        *done == self.macrosteps
    }

    fn next_step(&self, done: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let done = done + 1;
        let mut end = self.start;
        end[..self.axes].copy_from_slice(&self.target[..self.axes]);
        if done == self.macrosteps {
            return Ok(Next::command(self.space.setpoint(AxesState::at_rest(end)), done));
        }
        let [way, rate, change] = self.degree.at(f64::from(done) / f64::from(self.macrosteps));
        let along = |factor: f64| -> Axes { std::array::from_fn(|axis| (end[axis] - self.start[axis]) * factor) };
        let by = along(way);
        let position = std::array::from_fn(|axis| self.start[axis] + by[axis]);
        let state = AxesState::new(position, along(rate / self.duration))
            .accelerating(along(change / (self.duration * self.duration)));
        Ok(Next::command(self.space.setpoint(state), done))
    }
}
