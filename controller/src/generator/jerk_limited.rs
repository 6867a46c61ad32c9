//! Jerk-limited motion of joints or motors, time-synchronised.

use std::time::Duration;

use rsruckig::prelude::DataArrayOrVec;
use servo::MAX_AXES;

use super::through::Sections;
use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, plan::Plan};
use crate::robot::Space;

/// A jerk-limited, time-synchronised motion through intermediate poses to a final pose. Class 0, planned from the effector.
///
/// Without intermediate poses the motion is time-optimal. At an intermediate pose, an axis stops only if its direction of
/// travel changes there. All accelerations are zero there. The motion between two poses is time-optimal. No
/// duration rises if a limit rises. The trajectory is stretched by less than a servo period, to a whole number of periods.
///
/// Its macrosteps last [one servo period](Pace::PERIOD): each set-point is a sample of the trajectory. Velocity,
/// acceleration and jerk of the set-points therefore keep their limits. In longer macrosteps, the servo's quintic needs up
/// to 1.4 times the jerk limit where the jerk changes inside a macrostep.
///
/// Without intermediate poses, the motion [begins in motion](Generator::begins_in_motion) if the previous generator
/// ended in motion, and can [end in motion](Self::ending_at). With [`Ecp::replace`](crate::ecp::Ecp::replace), a motion
/// therefore continues to another target without a stop. If velocity or acceleration at the start exceeds a limit, the
/// motion returns below the limit as fast as the jerk limit permits.
///
/// The first step solves the whole motion, in microseconds per pose. For a single pose, the first step allocates only in
/// a refusal. No next step allocates.
#[doc(alias = "ruckig")]
#[derive(Debug)]
pub struct JerkLimited {
    space: Space,
    axes: usize,
    /// The motion without intermediate poses, and the limits of every motion.
    plan: Plan<MAX_AXES>,
    /// The motion through intermediate poses.
    through: Option<Sections>,
    /// Start, intermediate poses and target.
    poses: Vec<Axes>,
    /// The end, with zero acceleration. The other axes stay at their position at the start.
    target: AxesState,
    duration: Option<Duration>,
    ahead: Option<u16>,
}

impl JerkLimited {
    /// A motion from the effector's position through `poses`, for its first `axes` axes. The other axes stand.
    pub fn new(space: Space, axes: usize, limits: MotionLimits, poses: &[Axes]) -> Result<Self, GeneratorError> {
        limits.check(axes)?;
        let Some((&target, on_the_way)) = poses.split_last() else {
            return Err(GeneratorError::NoPoses);
        };
        for (pose, position) in poses.iter().enumerate() {
            if let Some(axis) = position[..axes].iter().position(|p| !p.is_finite()) {
                return Err(GeneratorError::NotFinite { pose, axis: axis as u8 });
            }
        }
        let mut plan = Plan::new();
        let input = &mut plan.input;
        let target = masked(&target, axes);
        input.target_position = DataArrayOrVec::Stack(target);
        for axis in 0..MAX_AXES {
            input.enabled[axis] = axis < axes;
            // The solver needs limits even for axes that do not move.
            let limit = |limits: &Axes| if axis < axes { limits[axis] } else { 1.0 };
            input.max_velocity[axis] = limit(&limits.max_velocity);
            input.max_acceleration[axis] = limit(&limits.max_acceleration);
            input.max_jerk[axis] = limit(&limits.max_jerk);
        }
        let through = (!on_the_way.is_empty()).then(|| Sections::new(poses.len()));
        let poses = [Axes::default()].into_iter().chain(poses.iter().map(|pose| masked(pose, axes))).collect();
        let target = AxesState::at_rest(target);
        Ok(Self { space, axes, plan, through, poses, target, duration: None, ahead: None })
    }

    /// The same motion, with at most this number of the cell's macrosteps sent ahead of the servo. A replacement acts after
    /// these macrosteps.
    #[must_use]
    pub fn sent_ahead(self, macrosteps: u16) -> Self {
        Self { ahead: Some(macrosteps), ..self }
    }

    /// The same motion, ending at `velocity`, rad/s or m/s, with zero acceleration. Refuses intermediate poses, and a
    /// velocity that is not finite or above the limit of its axis.
    pub fn ending_at(mut self, velocity: Axes) -> Result<Self, GeneratorError> {
        if self.through.is_some() {
            return Err(GeneratorError::PassesPoses);
        }
        let velocity = masked(&velocity, self.axes);
        for (axis, value) in velocity.into_iter().enumerate() {
            let limit = self.plan.input.max_velocity[axis];
            if !value.is_finite() {
                return Err(GeneratorError::NotFinite { pose: 0, axis: axis as u8 });
            }
            if value.abs() > limit {
                return Err(GeneratorError::EndVelocity { axis: axis as u8, value, limit });
            }
        }
        self.plan.input.target_velocity = DataArrayOrVec::Stack(velocity);
        self.target.velocity = velocity;
        Ok(self)
    }

    fn macrosteps(&self) -> u32 {
        self.through.as_ref().map_or(self.plan.macrosteps, |sections| sections.macrosteps)
    }

    /// The same motion in the time `duration`, rounded up to whole servo periods. The first step refuses a time that is too
    /// short.
    #[must_use]
    pub fn lasting(self, duration: Duration) -> Self {
        Self { duration: Some(duration), ..self }
    }
}

fn masked(position: &Axes, axes: usize) -> Axes {
    let mut masked = [0.0; MAX_AXES];
    masked[..axes].copy_from_slice(&position[..axes]);
    masked
}

impl Generator for JerkLimited {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn macrosteps_ahead(&self, most: u16) -> u16 {
        self.ahead.unwrap_or(most)
    }

    fn begins_in_motion(&self) -> bool {
        self.through.is_none()
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        let from = self.space.commanded(e);
        let acceleration = self.space.acceleration(e);
        self.target.position[self.axes..].copy_from_slice(&from.position[self.axes..]);
        let input = &mut self.plan.input;
        for (axis, acceleration) in acceleration.into_iter().enumerate().take(self.axes) {
            input.current_position[axis] = from.position[axis];
            input.current_velocity[axis] = from.velocity[axis];
            input.current_acceleration[axis] = acceleration;
        }
        let (given, macrostep) = (self.duration.map(|given| given.as_secs_f64()), macrostep.as_secs_f64());
        if let Some(sections) = &mut self.through {
            self.poses[0] = masked(&from.position, self.axes);
            sections.solve(&self.plan.input, &self.poses, given, macrostep)?;
        } else {
            self.plan.solve(given, macrostep)?;
        }
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &()) -> bool {
        *done == self.macrosteps()
    }

    fn next_step(&self, done: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let done = done + 1;
        if done == self.macrosteps() {
            return Ok(Next::command(self.space.setpoint(self.target), done));
        }
        let state = self.through.as_ref().map_or_else(|| self.plan.at(done), |sections| sections.at(done));
        let [mut position, velocity, acceleration] = state.map(|axes| masked(&axes, self.axes));
        position[self.axes..].copy_from_slice(&self.target.position[self.axes..]);
        let state = AxesState::new(position, velocity).accelerating(acceleration);
        Ok(Next::command(self.space.setpoint(state), done))
    }
}
