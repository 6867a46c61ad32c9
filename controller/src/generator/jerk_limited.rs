//! Jerk-limited motion of joints or motors, time-synchronised.

use std::time::Duration;

use rsruckig::prelude::{
    DataArrayOrVec, InputParameter, Ruckig, RuckigResult, ThrowErrorHandler, Trajectory,
};
use servo::MAX_AXES;

use super::newsmooth::whole_macrosteps;
use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next};
use crate::robot::Space;

/// A jerk-limited, time-synchronised motion through intermediate poses to a final pose. Class 1, sporadic feedback.
///
/// Without intermediate poses the motion is time-optimal. With intermediate poses the motion passes through each pose
/// without stopping, and its duration is near the optimum. The trajectory is stretched by less than a macrostep, so
/// that it ends with a macrostep.
///
/// The first step solves the whole motion. The computing time is microseconds for one pose, and some 30 ms for six
/// axes through five poses. Meanwhile the thread runs nothing else. For a single pose only a refusal allocates. With
/// intermediate poses the solver formats a message for each discarded candidate, which costs hundreds of allocations
/// per pose. No next step allocates.
#[derive(Debug)]
pub struct JerkLimited {
    space: Space,
    axes: usize,
    solver: Ruckig<MAX_AXES, ThrowErrorHandler>,
    input: InputParameter<MAX_AXES>,
    trajectory: Trajectory<MAX_AXES>,
    target: Axes,
    duration: Option<Duration>,
    macrosteps: u32,
    /// Trajectory seconds per macrostep.
    step: f64,
    /// Trajectory seconds per second, at most 1.
    pace: f64,
}

impl JerkLimited {
    /// A motion from the effector's position through `poses`, for its first `axes` axes.
    pub fn new(
        space: Space,
        axes: usize,
        limits: MotionLimits,
        poses: &[Axes],
    ) -> Result<Self, GeneratorError> {
        if axes == 0 || axes > MAX_AXES {
            return Err(GeneratorError::Axes {
                axes,
                max: MAX_AXES,
            });
        }
        let Some((&target, on_the_way)) = poses.split_last() else {
            return Err(GeneratorError::NoPoses);
        };
        limits.check(axes)?;
        for (pose, position) in poses.iter().enumerate() {
            if let Some(axis) = position[..axes].iter().position(|p| !p.is_finite()) {
                return Err(GeneratorError::NotFinite {
                    pose,
                    axis: axis as u8,
                });
            }
        }
        let mut input = InputParameter::with_waypoints(None, on_the_way.len());
        let mut trajectory = Trajectory::new(None);
        trajectory.reserve_sections(poses.len());
        for pose in on_the_way {
            input
                .intermediate_positions
                .push(DataArrayOrVec::Stack(masked(pose, axes)));
        }
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
        Ok(Self {
            space,
            axes,
            solver: Ruckig::with_waypoints(None, 1.0, on_the_way.len()),
            input,
            trajectory,
            target,
            duration: None,
            macrosteps: 0,
            step: 0.0,
            pace: 1.0,
        })
    }

    /// The same motion, stretched to `duration` and then to the end of a macrostep. Its first step refuses a time
    /// that is too short.
    #[must_use]
    pub fn lasting(self, duration: Duration) -> Self {
        Self {
            duration: Some(duration),
            ..self
        }
    }

    /// Number of macrosteps of the planned motion; 0 before its first step.
    pub const fn macrosteps(&self) -> u32 {
        self.macrosteps
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
    /// Number of macrosteps done.
    type Memory = u32;

    fn first_step(
        &mut self,
        e: &EffectorImage,
        macrostep: Duration,
    ) -> Result<Next<u32>, GeneratorError> {
        if macrostep.is_zero() {
            return Err(GeneratorError::NoMacrostep);
        }
        let from = self.space.commanded(e);
        for axis in 0..self.axes {
            self.input.current_position[axis] = from.position[axis];
        }
        match self.solver.calculate(&self.input, &mut self.trajectory) {
            Ok(RuckigResult::Working | RuckigResult::Finished) => {}
            Ok(_) | Err(_) => return Err(GeneratorError::NoProfile),
        }
        let macrostep = macrostep.as_secs_f64();
        let duration = self.trajectory.get_duration();
        let given = self.duration.map_or(duration, |given| given.as_secs_f64());
        if given < duration {
            return Err(GeneratorError::TooShort {
                needed: duration,
                given,
            });
        }
        self.macrosteps = whole_macrosteps(given, macrostep)?;
        if self.macrosteps > 0 {
            self.step = duration / f64::from(self.macrosteps);
            self.pace = self.step / macrostep;
        }
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &()) -> bool {
        *done == self.macrosteps
    }

    fn next_step(&self, done: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let done = done + 1;
        if done == self.macrosteps {
            return Ok(Next::command(
                self.space.setpoint(AxesState::at_rest(self.target)),
                done,
            ));
        }
        let mut position = DataArrayOrVec::Stack([0.0; MAX_AXES]);
        let mut velocity = DataArrayOrVec::Stack([0.0; MAX_AXES]);
        let t = f64::from(done) * self.step;
        self.trajectory.at_time(
            t,
            &mut Some(&mut position),
            &mut Some(&mut velocity),
            &mut None,
            &mut None,
            &mut None,
        );
        let mut state = AxesState::default();
        for axis in 0..self.axes {
            state.position[axis] = position[axis];
            state.velocity[axis] = velocity[axis] * self.pace;
        }
        Ok(Next::command(self.space.setpoint(state), done))
    }
}
