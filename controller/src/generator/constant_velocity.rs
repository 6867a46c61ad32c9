//! Motion of the joints at a constant velocity.

use std::time::Duration;

use super::newsmooth::{MAX_MACROSTEPS, whole_macrosteps};
use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, Setpoint};
use crate::robot::Arm;

/// Acceleration, rad/s² or m/s², that is taken for zero: images contain rounding errors of this order.
const NO_ACCELERATION: f64 = 1e-6;
/// Change of velocity, rad/s or m/s, that is taken for zero.
const NO_CHANGE: f64 = 1e-9;

/// A motion of the joints at a constant velocity, with jerk-limited acceleration and braking. Class 0, planned
/// from the effector.
///
/// All joints reach their velocities at the same time. The velocities are then held for the time of
/// [`lasting`](Self::lasting) or the distance of [`over`](Self::over), and the joints brake to rest together. From rest
/// to rest, the path is a straight line in joint space. With [`ending_in_motion`](Self::ending_in_motion), the motion
/// ends at the velocities, and the next generator continues from this state.
///
/// The motion [begins in motion](Generator::begins_in_motion) if the previous generator ended in motion, and can replace
/// another motion. An acceleration at the start is first reduced to zero within the jerk limit. Acceleration, constant
/// velocity and braking each last a whole number of servo periods.
///
/// The macrosteps last [one servo period](Pace::PERIOD). The first step refuses a motion that leaves the range of a joint
/// or a motor. Its computing time is proportional to the number of periods. No step allocates.
///
/// ```
/// # use std::{sync::Arc, time::Duration};
/// # use mrroc_controller::generator::{ConstantVelocity, MotionLimits, Pose};
/// # use mrroc_controller::robot::{Arm, Irb6, Irb6Parameters};
/// # let arm = Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()), Pose::identity());
/// let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
/// // The column turns at 0.2 rad/s for one second, plus the time of acceleration and braking.
/// let velocity = [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
/// let motion = ConstantVelocity::new(arm, limits, velocity)?.lasting(Duration::from_secs(1));
/// # Ok::<(), mrroc_controller::generator::GeneratorError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ConstantVelocity {
    arm: Arm,
    limits: MotionLimits,
    velocity: Axes,
    /// Time at the velocity, s.
    held: f64,
    ends_in_motion: bool,
    phases: [Phase; 4],
    /// Duration of a macrostep, s.
    macrostep: f64,
    macrosteps: u32,
}

impl ConstantVelocity {
    /// A motion at `velocity`, rad/s, or m/s for a linear joint, that brakes as soon as this velocity is reached. Refuses
    /// a velocity that is not finite or above the limit of its joint.
    pub fn new(arm: Arm, limits: MotionLimits, velocity: Axes) -> Result<Self, GeneratorError> {
        let axes = arm.axes();
        limits.check(axes)?;
        let mut masked = Axes::default();
        for (axis, (value, limit)) in velocity.into_iter().zip(limits.max_velocity).enumerate().take(axes) {
            if !value.is_finite() {
                return Err(GeneratorError::NotFinite { pose: 0, axis: axis as u8 });
            }
            if value.abs() > limit {
                return Err(GeneratorError::Velocity { axis: axis as u8, value, limit });
            }
            masked[axis] = value;
        }
        let phases = [Phase::default(); 4];
        let velocity = masked;
        Ok(Self { arm, limits, velocity, held: 0.0, ends_in_motion: false, phases, macrostep: 0.0, macrosteps: 0 })
    }

    /// The same motion, which holds the velocity for `duration`, rounded up to whole servo periods.
    #[must_use]
    pub fn lasting(self, duration: Duration) -> Self {
        Self { held: duration.as_secs_f64(), ..self }
    }

    /// The same motion, which holds the velocity until the fastest joint has moved by `distance`, rad or m; the time is
    /// rounded up to whole servo periods. Acceleration and braking need a further distance. Refuses a distance that is
    /// negative or not finite, and any distance if all velocities are zero.
    pub fn over(self, distance: f64) -> Result<Self, GeneratorError> {
        let velocity = self.velocity.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        let held = distance / velocity;
        let sound = held.is_finite() && held >= 0.0;
        sound.then_some(Self { held, ..self }).ok_or(GeneratorError::Distance { distance, velocity })
    }

    /// The same motion without braking: the motion ends at its velocity, with zero acceleration.
    #[must_use]
    pub fn ending_in_motion(self) -> Self {
        Self { ends_in_motion: true, ..self }
    }

    /// State after `done` macrosteps. The end is exact.
    fn state(&self, done: u32) -> AxesState {
        let last = &self.phases[3];
        if done == self.macrosteps {
            return AxesState::new(last.at(last.duration).position, last.to).accelerating(Axes::default());
        }
        let time = f64::from(done) * self.macrostep;
        let phase = self.phases.iter().rfind(|phase| phase.start <= time).unwrap_or(last);
        phase.at(time - phase.start)
    }

    fn plan(&mut self, e: &EffectorImage) -> Result<(), GeneratorError> {
        let start = self.reduction(&e.commanded.joints, &e.commanded_acceleration.joints);
        let mut change = self.change(&start, &self.velocity);
        let reached = whole_macrosteps(start.duration + change.duration, self.macrostep)?;
        change.stretch(f64::from(reached) * self.macrostep - start.duration);
        let held = whole_macrosteps(self.held, self.macrostep)?;
        let mut hold = self.change(&change, &self.velocity);
        hold.stretch(f64::from(held) * self.macrostep);
        let end = if self.ends_in_motion { self.velocity } else { Axes::default() };
        let mut braking = self.change(&hold, &end);
        let braked = whole_macrosteps(braking.duration, self.macrostep)?;
        braking.stretch(f64::from(braked) * self.macrostep);

        // Each number is at most `MAX_MACROSTEPS`.
        self.macrosteps = reached + held + braked;
        if self.macrosteps > MAX_MACROSTEPS {
            return Err(GeneratorError::TooLong { limit: MAX_MACROSTEPS });
        }
        self.phases = [start, change, hold, braking];
        for done in 1..=self.macrosteps {
            let s = f64::from(done) / f64::from(self.macrosteps);
            let position = self.state(done).position;
            self.arm.motors(&position).map_err(|cause| GeneratorError::Path { s, cause })?;
        }
        Ok(())
    }

    /// The phase that reduces an acceleration to zero. Its duration is zero without an acceleration.
    fn reduction(&self, from: &AxesState, acceleration: &Axes) -> Phase {
        let time = |axis: usize| match acceleration[axis].abs() {
            value if value > NO_ACCELERATION => value / self.limits.max_jerk[axis],
            _ => 0.0,
        };
        let duration = (0..self.arm.axes()).map(time).fold(0.0, f64::max);
        let gained = |axis: usize| from.velocity[axis] + acceleration[axis] * duration / 2.0;
        let to = std::array::from_fn(gained);
        Phase { start: 0.0, duration, position: from.position, from: from.velocity, to, shape: Shape::Reduction }
    }

    /// The fastest change from the end of a phase to a velocity. Its duration is zero without a change.
    fn change(&self, before: &Phase, to: &Axes) -> Phase {
        // Greatest reciprocals of the limits of the first and second derivative of a step from 0 to 1, s and s².
        let (mut push, mut jerk): (f64, f64) = (0.0, 0.0);
        for (axis, (to, from)) in to.iter().zip(before.to).enumerate().take(self.arm.axes()) {
            let by = (to - from).abs();
            if by > NO_CHANGE {
                push = push.max(by / self.limits.max_acceleration[axis]);
                jerk = jerk.max(by / self.limits.max_jerk[axis]);
            }
        }
        let (from, duration, ramp) = match push {
            0.0 => (*to, 0.0, 0.0),
            _ if jerk >= push * push => (before.to, 2.0 * jerk.sqrt(), jerk.sqrt()),
            _ => (before.to, push + jerk / push, jerk / push),
        };
        let (start, position) = (before.start + before.duration, before.at(before.duration).position);
        Phase { start, duration, position, from, to: *to, shape: Shape::Change { ramp } }
    }
}

/// Part of the motion in which the velocities of all joints change in proportion.
#[derive(Clone, Copy, Debug, Default)]
struct Phase {
    /// Start and duration, s.
    start: f64,
    duration: f64,
    /// Positions at the start.
    position: Axes,
    /// Velocities at both ends.
    from: Axes,
    to: Axes,
    shape: Shape,
}

/// Velocities over the time of a phase.
#[derive(Clone, Copy, Debug, Default)]
enum Shape {
    /// The acceleration at the start decreases to zero with constant jerk.
    #[default]
    Reduction,
    /// The acceleration rises from zero for the time `ramp`, s, is constant, and decreases to zero for the same time.
    Change { ramp: f64 },
}

impl Phase {
    /// State `time` s after the start of the phase.
    fn at(&self, time: f64) -> AxesState {
        if self.duration == 0.0 {
            return AxesState::new(self.position, self.to).accelerating(Axes::default());
        }
        let [sum, value, rate] = self.step(time);
        let by = |axis: usize| self.to[axis] - self.from[axis];
        let position = |axis: usize| self.position[axis] + self.from[axis] * time + by(axis) * sum;
        let velocity = std::array::from_fn(|axis| self.from[axis] + by(axis) * value);
        AxesState::new(std::array::from_fn(position), velocity)
            .accelerating(std::array::from_fn(|axis| by(axis) * rate))
    }

    /// The step from 0 to 1 at `time`: its integral, its value and its derivative.
    fn step(&self, time: f64) -> [f64; 3] {
        let whole = self.duration;
        match self.shape {
            Shape::Reduction => {
                let u = time / whole;
                [whole * u * u * (1.0 - u / 3.0), u * (2.0 - u), 2.0 * (1.0 - u) / whole]
            }
            Shape::Change { ramp } if time > whole / 2.0 => {
                let rest = whole - time;
                let [sum, value, rate] = first_half(rest, ramp, whole);
                [whole / 2.0 - rest + sum, 1.0 - value, rate]
            }
            Shape::Change { ramp } => first_half(time, ramp, whole),
        }
    }

    /// Stretches the phase to a duration, s.
    fn stretch(&mut self, duration: f64) {
        if let (Shape::Change { ramp }, true) = (&mut self.shape, self.duration > 0.0) {
            *ramp *= duration / self.duration;
        }
        // Whole macrosteps may be shorter by a rounding error.
        self.duration = duration.max(0.0);
    }
}

/// First half of a step whose derivative has a ramp at both ends: integral, value and derivative.
fn first_half(time: f64, ramp: f64, duration: f64) -> [f64; 3] {
    let rate = 1.0 / (duration - ramp);
    if time < ramp {
        let share = time / ramp;
        return [rate * time * time * share / 6.0, rate * time * share / 2.0, rate * share];
    }
    [rate * (time * (time - ramp) + ramp * ramp / 3.0) / 2.0, rate * (time - ramp / 2.0), rate]
}

impl Generator for ConstantVelocity {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    /// One period: the set-points then keep the limit of jerk.
    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn begins_in_motion(&self) -> bool {
        true
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        self.plan(e)?;
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, (): &()) -> bool {
        *done == self.macrosteps
    }

    fn next_step(&self, done: &u32, (): &()) -> Result<Next<u32>, GeneratorError> {
        let done = done + 1;
        Ok(Next::command(Setpoint::Joints(self.state(done)), done))
    }
}
