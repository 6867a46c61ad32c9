//! Straight lines of the tool.

use std::time::Duration;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::plan::Plan;
use super::{
    Axes, AxesState, EffectorImage, EffectorState, Generator, GeneratorError, MotionLimits, Next,
    Pose, Setpoint,
};
use crate::robot::Arm;

/// Spacing of the poses that are checked beforehand: at most 5 mm and 10 mrad apart.
const CHECK_DISTANCE: f64 = 0.005;
const CHECK_ANGLE: f64 = 0.01;
/// The fewest and the most poses checked beforehand.
const CHECKS: (usize, usize) = (32, 2_000);
/// An axis that moves further than this, rad, between two neighbouring checks has changed its branch.
const JUMP: f64 = 0.35;
/// A line that would have to be walked this many times slower for one axis is refused.
const SLOWEST: f64 = 50.0;
/// Half the path parameter over which joint positions are differentiated. The error of the difference is
/// q‴ ε² / 6, about 1e-9 relative, and rounding adds 1e-11 / ε of it.
const EPSILON: f64 = 1e-5;

/// What differences of positions lose by rounding, in relation to the tolerances of a planned start.
const ROUNDING: f64 = 1e-9;

/// Limits of the tool on a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineLimits {
    /// m/s.
    pub max_velocity: f64,
    /// m/s².
    pub max_acceleration: f64,
    /// m/s³.
    pub max_jerk: f64,
    /// rad/s.
    pub max_angular_velocity: f64,
    /// rad/s².
    pub max_angular_acceleration: f64,
    /// rad/s³.
    pub max_angular_jerk: f64,
}

/// Where a line is planned to begin, and how near to there the arm counts as standing there.
///
/// Homing takes an arm to its home position but for a remainder: the braking distance behind the index pulse, and some
/// counts. A line from there must neither inherit the remainder in each of its poses nor be refused for it. An arm of
/// five axes reaches no pose beside its plane, and next to a singular pose the smallest remainder decides on the branch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedStart {
    /// Motor positions, rad.
    pub motors: Axes,
    /// Greatest distance of each motor from there, rad.
    pub tolerance: Axes,
}

impl PlannedStart {
    /// Whether these motor positions are within the tolerance, but for rounding.
    pub fn admits(&self, motors: &Axes) -> bool {
        let distances = motors.iter().zip(&self.motors).map(|(a, b)| (a - b).abs());
        let mut both = distances.zip(&self.tolerance);
        both.all(|(distance, tolerance)| distance <= tolerance * (1.0 + ROUNDING))
    }
}

/// A straight line of the tool's origin with the shortest turn of the tool, both in one jerk-limited
/// profile. Class 1, sporadic feedback.
///
/// An arm that stands within the tolerance of a [`PlannedStart`] follows the path of that start. Its joints begin beside
/// the path by a remainder d, which falls to d·(1 − s) at the path parameter s. The end is exact. With the Jacobian J the
/// tool leaves the straight line from where it stood by (1 − s)·(J(s) − J(0))·d, about d/4 times the length of the path:
/// 6 µm for 0.25 mrad of the column and 0.1 m.
///
/// Before it begins, every pose of it is checked, at most 5 mm and 10 mrad apart: reach, joint limits,
/// and no jump from one branch of the inverse kinematics to another; the refusal names the place and the
/// axis. Where a joint would have to exceed its velocity or acceleration limit, near a singularity
/// for instance, the whole line is walked slower.
///
/// Poses are on the line at the ends of macrosteps. Between them motors follow cubics, which leave the
/// line by the fourth derivative of the joint path times macrostep⁴ / 384.
///
/// The first step makes two inverse kinematics per checked pose, each next step three; neither allocates.
#[derive(Debug)]
pub struct Line {
    arm: Arm,
    target: Pose,
    limits: LineLimits,
    joint_limits: MotionLimits,
    start: Option<PlannedStart>,
    path: Path,
    /// Joint positions at the start of the motion, less those at the start of the path.
    remainder: Axes,
    plan: Plan<1>,
}

/// The geometry: tool poses over the path parameter `s`, 0 to 1.
#[derive(Clone, Copy, Debug)]
struct Path {
    from: Pose,
    to: Pose,
    /// Base frame, m.
    displacement: Vector3<f64>,
    /// Rotation vector in the frame of the first pose, rad, no longer than π.
    turn: Vector3<f64>,
}

impl Path {
    fn between(from: &Pose, to: &Pose) -> Self {
        let displacement = to.translation.vector - from.translation.vector;
        let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
        Self {
            from: *from,
            to: *to,
            displacement,
            turn,
        }
    }

    fn at(&self, s: f64) -> Pose {
        if s >= 1.0 {
            return self.to;
        }
        let position = self.from.translation.vector + self.displacement * s;
        let rotation = self.from.rotation * UnitQuaternion::from_scaled_axis(self.turn * s);
        Pose::from_parts(Translation3::from(position), rotation)
    }

    /// Checks needed so that neighbours are close.
    fn checks(&self) -> usize {
        let count = (self.displacement.norm() / CHECK_DISTANCE)
            .max(self.turn.norm() / CHECK_ANGLE)
            .ceil();
        (count as usize).clamp(CHECKS.0, CHECKS.1)
    }
}

/// Velocity, acceleration and jerk of the path parameter, 1/s and so on.
#[derive(Clone, Copy, Debug)]
struct Rates {
    velocity: f64,
    acceleration: f64,
    jerk: f64,
}

/// Where a line has come to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineMemory {
    /// Macrosteps done.
    done: u32,
    /// Joints there, which choose the branch of the next inverse kinematics.
    joints: Axes,
}

impl Line {
    /// From where the effector stands to `target`, base from tool.
    pub fn new(
        arm: Arm,
        target: Pose,
        limits: LineLimits,
        joint_limits: MotionLimits,
    ) -> Result<Self, GeneratorError> {
        joint_limits.check(arm.axes())?;
        let LineLimits {
            max_velocity,
            max_acceleration,
            max_jerk,
            max_angular_velocity,
            max_angular_acceleration,
            max_angular_jerk,
        } = limits;
        for limit in [
            max_velocity,
            max_acceleration,
            max_jerk,
            max_angular_velocity,
            max_angular_acceleration,
            max_angular_jerk,
        ] {
            if !(limit.is_finite() && limit > 0.0) {
                return Err(GeneratorError::PathLimit);
            }
        }
        let coordinates = target
            .translation
            .vector
            .iter()
            .chain(target.rotation.coords.iter());
        if let Some(axis) = coordinates.into_iter().position(|c| !c.is_finite()) {
            return Err(GeneratorError::NotFinite {
                pose: 0,
                axis: axis as u8,
            });
        }
        Ok(Self {
            arm,
            target,
            limits,
            joint_limits,
            start: None,
            path: Path::between(&target, &target),
            remainder: Axes::default(),
            plan: Plan::new(0),
        })
    }

    /// The same line from a planned start. An arm that stands elsewhere when the line begins goes straight from there.
    #[must_use]
    pub fn beginning_at(self, start: PlannedStart) -> Self {
        Self {
            start: Some(start),
            ..self
        }
    }

    /// Macrosteps the planned line takes; 0 before its first step.
    pub const fn macrosteps(&self) -> u32 {
        self.plan.macrosteps
    }

    /// Lays the path, from the planned start if the arm stands there, and returns the joint positions at its start.
    fn lay(&mut self, e: &EffectorImage) -> Result<Axes, GeneratorError> {
        let EffectorState {
            motors,
            joints,
            pose,
        } = &e.commanded;
        self.remainder = Axes::default();
        let start = self.start.filter(|start| start.admits(&motors.position));
        let Some(start) = start else {
            self.path = Path::between(pose, &self.target);
            return Ok(joints.position);
        };
        let planned = self.arm.joints(&start.motors);
        let planned = planned.map_err(GeneratorError::Image)?;
        let from = self.arm.forward(&planned).map_err(GeneratorError::Image)?;
        self.path = Path::between(&from, &self.target);
        for (axis, remainder) in self.remainder.iter_mut().enumerate() {
            *remainder = joints.position[axis] - planned[axis];
        }
        Ok(planned)
    }

    /// What the tool's limits allow on the way from `here`; `None` if there is none.
    fn tool_rates(&self, here: &Pose) -> Option<Rates> {
        // A remainder can be longer than the path.
        let way = Path::between(here, &self.target);
        let length = way.displacement.norm().max(self.path.displacement.norm());
        let angle = way.turn.norm().max(self.path.turn.norm());
        let rate = |linear: f64, angular: f64| (linear / length).min(angular / angle);
        (length > 1e-12 || angle > 1e-12).then(|| Rates {
            velocity: rate(self.limits.max_velocity, self.limits.max_angular_velocity),
            acceleration: rate(
                self.limits.max_acceleration,
                self.limits.max_angular_acceleration,
            ),
            jerk: rate(self.limits.max_jerk, self.limits.max_angular_jerk),
        })
    }

    /// Walks the whole line and returns by how much it must be slowed, at least 1.
    fn slowdown(&self, start: &Axes, rates: &Rates) -> Result<f64, GeneratorError> {
        let checks = self.path.checks();
        let ds = 1.0 / checks as f64;
        let axes = self.arm.axes();
        let mut slowdown: f64 = 1.0;
        let mut joints = *start;
        let mut slopes: Option<Axes> = None;
        for check in 1..=checks {
            let s = if check == checks {
                1.0
            } else {
                check as f64 * ds
            };
            let ahead = self.inverse(s, &joints)?;
            self.on_the_way(s, &ahead)?;
            let mut slope = [0.0; servo::MAX_AXES];
            // The profile can be no faster here than what it gained since, or loses until, the ends.
            let reach = (s - ds / 2.0).min(1.0 - s + ds / 2.0);
            let velocity = rates
                .velocity
                .min((2.0 * rates.acceleration * reach).sqrt());
            for axis in 0..axes {
                let by = (ahead[axis] - joints[axis]).abs();
                if by > JUMP {
                    return Err(GeneratorError::Jump {
                        s,
                        axis: axis as u8,
                        by,
                    });
                }
                slope[axis] = (ahead[axis] - joints[axis]) / ds - self.remainder[axis];
                let bend = slopes.map_or(0.0, |last| (slope[axis] - last[axis]) / ds);
                let speed = slope[axis].abs() * velocity / self.joint_limits.max_velocity[axis];
                let push = (slope[axis].abs() * rates.acceleration
                    + bend.abs() * velocity * velocity)
                    / self.joint_limits.max_acceleration[axis];
                let times = speed.max(push.sqrt());
                if times > SLOWEST {
                    return Err(GeneratorError::Singular {
                        s,
                        axis: axis as u8,
                        times,
                    });
                }
                slowdown = slowdown.max(times);
            }
            joints = ahead;
            slopes = Some(slope);
        }
        Ok(slowdown)
    }

    /// The joint positions to command at `s`: those of the path and the rest of the remainder, if the arm can take them.
    fn on_the_way(&self, s: f64, joints: &Axes) -> Result<Axes, GeneratorError> {
        if self.remainder == Axes::default() {
            return Ok(*joints);
        }
        let beside = |axis: usize| joints[axis] + self.remainder[axis] * (1.0 - s);
        let joints = std::array::from_fn(beside);
        let motors = self.arm.motors(&joints);
        motors.map_err(|cause| GeneratorError::Path { s, cause })?;
        Ok(joints)
    }

    fn inverse(&self, s: f64, near: &Axes) -> Result<Axes, GeneratorError> {
        self.arm
            .inverse(&self.path.at(s), near)
            .map_err(|cause| GeneratorError::Path { s, cause })
    }
}

impl Generator for Line {
    type First = EffectorImage;
    type Every = ();
    type Memory = LineMemory;

    fn first_step(
        &mut self,
        e: &EffectorImage,
        macrostep: Duration,
    ) -> Result<Next<LineMemory>, GeneratorError> {
        if macrostep.is_zero() {
            return Err(GeneratorError::NoMacrostep);
        }
        let memory = LineMemory {
            done: 0,
            joints: self.lay(e)?,
        };
        self.plan.macrosteps = 0;
        let Some(rates) = self.tool_rates(&e.commanded.pose) else {
            return Ok(Next::remember(memory));
        };
        self.on_the_way(0.0, &memory.joints)?;
        let slowdown = self.slowdown(&memory.joints, &rates)?;
        let input = &mut self.plan.input;
        input.target_position[0] = 1.0;
        input.max_velocity[0] = rates.velocity / slowdown;
        input.max_acceleration[0] = rates.acceleration / slowdown.powi(2);
        input.max_jerk[0] = rates.jerk / slowdown.powi(3);
        self.plan.solve(None, macrostep.as_secs_f64())?;
        Ok(Next::remember(memory))
    }

    fn terminal(&self, memory: &LineMemory, _: &()) -> bool {
        memory.done == self.plan.macrosteps
    }

    fn next_step(&self, memory: &LineMemory, _: &()) -> Result<Next<LineMemory>, GeneratorError> {
        let done = memory.done + 1;
        if done == self.plan.macrosteps {
            let joints = self.inverse(1.0, &memory.joints)?;
            return Ok(Next::command(
                Setpoint::Joints(AxesState::at_rest(joints)),
                LineMemory { done, joints },
            ));
        }
        let ([s], [rate]) = self.plan.at(done);
        let s = s.clamp(0.0, 1.0);

        let joints = self.inverse(s, &memory.joints)?;
        let (before, after) = ((s - EPSILON).max(0.0), (s + EPSILON).min(1.0));
        let (behind, ahead) = (
            self.inverse(before, &joints)?,
            self.inverse(after, &joints)?,
        );
        let mut state = AxesState::at_rest(self.on_the_way(s, &joints)?);
        for axis in 0..self.arm.axes() {
            let slope = (ahead[axis] - behind[axis]) / (after - before);
            state.velocity[axis] = (slope - self.remainder[axis]) * rate;
        }
        Ok(Next::command(
            Setpoint::Joints(state),
            LineMemory { done, joints },
        ))
    }
}
