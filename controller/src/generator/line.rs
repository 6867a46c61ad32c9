//! Straight lines of the tool.

use std::time::Duration;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::bounds::Bounds;
use super::guide::Guide;
use super::newsmooth::whole_macrosteps;
use super::plan::Plan;
use super::progress::{Course, Place, Rates};
use super::survey::{PLACES, Survey};
use super::{
    Axes, AxesState, EffectorImage, EffectorState, Generator, GeneratorError, MotionLimits, Next, Pace, Pose, Setpoint,
    SlowedPart, is_limit,
};
use crate::robot::Arm;

/// Spacing of the poses that are checked before the motion: at most 5 mm and 10 mrad.
const CHECK_DISTANCE: f64 = 0.005;
const CHECK_ANGLE: f64 = 0.01;
/// Smallest and largest number of poses checked before the motion.
const CHECKS: (usize, usize) = (32, 2_000);
/// Largest motion of an axis, rad or m, between two neighbouring checks. A larger motion changes the branch.
const JUMP: f64 = 0.35;
/// Longest and shortest distance of two places at which the limits of the joints are computed.
const STEPS: (f64, f64) = (1.0 / 128.0, 5e-5);
/// Longest distance of two places on a long line: there are at most 1024 places.
const LONG_STEP: f64 = 1e-3;
/// Change of the slope of a joint from place to place, relative to the largest slope, that is aimed at.
const CHANGE: f64 = 1.0 / 24.0;
/// Largest factor from one distance of places to the next.
const GROWTH: f64 = 1.5;
/// Share of the joint limits for the motion. The rest is for the course between the places.
const SHARE: f64 = 0.99;
/// Half the interval of the path parameter for numerical derivatives of joint positions. The truncation error is q‴
/// ε² / 6, about 1e-7 relative. Rounding adds errors of 1e-12 / ε to the first derivative, and of 1e-12 / ε² to the
/// second.
const EPSILON: f64 = 1e-4;
/// Allowance for rounding errors, relative to the tolerances of a planned start.
const ROUNDING: f64 = 1e-9;

/// Limits of the tool on a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineLimits {
    /// Velocity, m/s.
    pub max_velocity: f64,
    /// Acceleration, m/s².
    pub max_acceleration: f64,
    /// Jerk, m/s³.
    pub max_jerk: f64,
    /// Angular velocity, rad/s.
    pub max_angular_velocity: f64,
    /// Angular acceleration, rad/s².
    pub max_angular_acceleration: f64,
    /// Angular jerk, rad/s³.
    pub max_angular_jerk: f64,
}

impl LineLimits {
    /// Pairs of limits, origin and rotation: velocities, accelerations, jerks.
    const fn pairs(&self) -> [[f64; 2]; 3] {
        [
            [self.max_velocity, self.max_angular_velocity],
            [self.max_acceleration, self.max_angular_acceleration],
            [self.max_jerk, self.max_angular_jerk],
        ]
    }
}

/// Planned start of a line, and the tolerance within which the arm counts as standing at this start.
///
/// After homing, the arm stands at a small distance from its home position, the remainder: the braking distance after
/// the index pulse, and some counts. A path from the actual position would contain the remainder in each pose, and
/// could be refused. An arm of five axes reaches no pose outside its plane. Near a singular pose, even a small
/// remainder can change the branch of the inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedStart {
    /// Motor positions, rad.
    pub motors: Axes,
    /// Largest accepted distance of each motor from `motors`, rad.
    pub tolerance: Axes,
}

impl PlannedStart {
    /// Whether these motor positions lie within the tolerance, apart from rounding.
    pub fn admits(&self, motors: &Axes) -> bool {
        let mut both = motors.iter().zip(&self.motors).map(|(a, b)| (a - b).abs()).zip(&self.tolerance);
        both.all(|(distance, tolerance)| distance <= tolerance * (1.0 + ROUNDING))
    }
}

/// A straight line of the tool's origin with the shortest rotation of the tool, both with one jerk-limited profile.
/// Class 0, planned from the effector.
///
/// An arm that stands within the tolerance of a [`PlannedStart`] follows the path from that start. At first the joints
/// differ from the path by a remainder d, which decreases to d·(1 − s) at the path parameter s, 0 to 1. The end is
/// exact. With the Jacobian J, the tool deviates from the straight line through its actual start by (1 − s)·(J(s) −
/// J(0))·d. The maximum is about d/4 times the length of the path: 6 µm for 0.25 mrad of the column and 0.1 m.
///
/// Poses of the line at most 5 mm and 10 mrad apart are checked before the motion. The checks cover reach, ranges of
/// joints, and jumps between branches of the inverse kinematics. If the limits of the tool alone would let a joint
/// exceed its velocity or acceleration limit, for instance near a singularity, the motion is the fastest of a family of
/// profiles within all limits. These profiles are slower as a whole, or only where a joint is fast
/// ([`at_constant_speed`](Self::at_constant_speed) excludes the second kind). No duration rises by more than a servo
/// period if a limit rises.
///
/// An arm with more axes than a pose determines follows a smooth course of its joints near the course that the inverse
/// kinematics chooses. The ends of both are equal.
///
/// The macrosteps last [one servo period](Pace::PERIOD): each set-point lies on the line, and keeps the limits of the
/// tool.
///
/// The first step solves the inverse kinematics once per checked pose, and at most about 1000 times for the limits of
/// the joints, more often near a singularity. Each next step solves the inverse kinematics three times. No step
/// allocates.
#[doc(alias = "linear")]
#[derive(Debug)]
pub struct StraightLine {
    arm: Arm,
    target: Pose,
    limits: LineLimits,
    joint_limits: MotionLimits,
    start: Option<PlannedStart>,
    path: Path,
    /// Joint positions at the start of the motion minus joint positions at the start of the path.
    remainder: Axes,
    /// Whether a line that joints limit is slower as a whole.
    constant_speed: bool,
    /// Smooth joint positions near the path, if the poses do not determine the joints.
    guide: Option<Guide>,
    /// The part that joints slow.
    slowed: Option<SlowedPart>,
    /// Derivatives of the joint positions along the path.
    places: Vec<Place>,
    profile: Profile,
}

/// Progress of the path parameter over time.
#[derive(Debug)]
struct Profile {
    /// The motion if the limits of the tool alone determine it.
    by_tool: Plan<1>,
    /// The motion if joints limit it.
    by_joints: Option<Course>,
    macrosteps: u32,
    /// Duration, s.
    duration: f64,
}

impl Profile {
    /// Path parameter, velocity and acceleration after `done` macrosteps.
    fn at(&self, done: u32) -> Rates {
        let Some(course) = &self.by_joints else {
            return self.by_tool.at(done).map(|[value]| value);
        };
        let [s, rate, push] = course.at(f64::from(done) / f64::from(self.macrosteps));
        [s, rate / self.duration, push / (self.duration * self.duration)]
    }
}

/// The geometry: tool poses over the path parameter `s`, 0 to 1.
#[derive(Clone, Copy, Debug)]
struct Path {
    from: Pose,
    to: Pose,
    /// Displacement in the base frame, m.
    displacement: Vector3<f64>,
    /// Rotation vector in the frame of the first pose, rad, of length π at most.
    turn: Vector3<f64>,
}

impl Path {
    fn between(from: &Pose, to: &Pose) -> Self {
        let displacement = to.translation.vector - from.translation.vector;
        let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
        Self { from: *from, to: *to, displacement, turn }
    }

    fn at(&self, s: f64) -> Pose {
        if s >= 1.0 {
            return self.to;
        }
        let position = self.from.translation.vector + self.displacement * s;
        let rotation = self.from.rotation * UnitQuaternion::from_scaled_axis(self.turn * s);
        Pose::from_parts(Translation3::from(position), rotation)
    }

    /// Number of checks that gives the required spacing.
    fn checks(&self) -> usize {
        let count = (self.displacement.norm() / CHECK_DISTANCE).max(self.turn.norm() / CHECK_ANGLE).ceil();
        (count as usize).clamp(CHECKS.0, CHECKS.1)
    }
}

/// Progress of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineMemory {
    /// Number of macrosteps done.
    done: u32,
    /// Last joints on the path, for the branch of the next inverse kinematics.
    joints: Axes,
}

impl StraightLine {
    /// A line from the effector's position to `target`, the pose of the tool in the base frame.
    pub fn new(arm: Arm, target: Pose, limits: LineLimits, joint_limits: MotionLimits) -> Result<Self, GeneratorError> {
        joint_limits.check(arm.axes())?;
        if !limits.pairs().into_iter().flatten().all(is_limit) {
            return Err(GeneratorError::PathLimit);
        }
        let position = target.translation.vector.iter();
        let mut coordinates = position.chain(target.rotation.coords.iter());
        if let Some(at) = coordinates.position(|c| !c.is_finite()) {
            const NAMES: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];
            return Err(GeneratorError::TargetNotFinite { coordinate: NAMES[at] });
        }
        Ok(Self {
            arm,
            target,
            limits,
            joint_limits,
            start: None,
            path: Path::between(&target, &target),
            remainder: Axes::default(),
            constant_speed: false,
            guide: None,
            slowed: None,
            places: Vec::with_capacity(PLACES),
            profile: Profile { by_tool: Plan::new(), by_joints: None, macrosteps: 0, duration: 0.0 },
        })
    }

    /// The same line from a planned start. If the arm stands elsewhere when the line begins, the line begins at the
    /// actual position.
    #[must_use]
    pub fn beginning_at(self, start: PlannedStart) -> Self {
        Self { start: Some(start), ..self }
    }

    /// The same line with a constant speed between acceleration and braking, for example for engraving: a line that
    /// joints limit is slower as a whole, not only where a joint is fast.
    #[must_use]
    pub fn at_constant_speed(self) -> Self {
        Self { constant_speed: true, ..self }
    }

    /// Number of servo periods of the planned motion; 0 before the first step.
    pub const fn periods(&self) -> u32 {
        self.profile.macrosteps
    }

    /// Sets the path, from the planned start if the arm stands there. Returns the joint positions at the start of the
    /// path.
    fn lay(&mut self, e: &EffectorImage) -> Result<Axes, GeneratorError> {
        let EffectorState { motors, joints, pose } = &e.commanded;
        self.remainder = Axes::default();
        let Some(start) = self.start.filter(|start| start.admits(&motors.position)) else {
            self.path = Path::between(pose, &self.target);
            return Ok(joints.position);
        };
        let planned = self.arm.joints(&start.motors).map_err(GeneratorError::Image)?;
        let from = self.arm.forward(&planned).map_err(GeneratorError::Image)?;
        self.path = Path::between(&from, &self.target);
        for (axis, remainder) in self.remainder.iter_mut().enumerate() {
            *remainder = joints.position[axis] - planned[axis];
        }
        Ok(planned)
    }

    /// The largest rates within the tool's limits on the path from `here`; `None` if there is no motion.
    fn tool_rates(&self, here: &Pose) -> Option<Rates> {
        // A remainder can be longer than the path.
        let way = Path::between(here, &self.target);
        let length = way.displacement.norm().max(self.path.displacement.norm());
        let angle = way.turn.norm().max(self.path.turn.norm());
        let rate = |[linear, angular]: [f64; 2]| (linear / length).min(angular / angle);
        (length > 1e-12 || angle > 1e-12).then(|| self.limits.pairs().map(rate))
    }

    /// Checks the whole line, and computes the derivatives of the joint positions along the line within these limits.
    fn survey(&mut self, start: &Axes, limits: &MotionLimits) -> Result<(), GeneratorError> {
        self.guide = None;
        self.guide = self.check(start)?;
        let mut change = CHANGE;
        loop {
            let places = std::mem::take(&mut self.places);
            let mut survey = Survey::begin(places, limits, self.arm.axes(), &self.remainder, start);
            let followed = self.follow(start, change, &mut survey);
            self.places = survey.end();
            match followed {
                Ok(true) => return Ok(()),
                Ok(false) => change *= 2.0,
                Err(_) if self.guide.is_some() => self.guide = None,
                Err(error) => return Err(error),
            }
        }
    }

    /// Checks reach, ranges and jumps. Returns a guide if the poses do not determine the joints.
    fn check(&self, start: &Axes) -> Result<Option<Guide>, GeneratorError> {
        let checks = self.path.checks();
        let mut guide = Guide::of(&self.arm);
        let (mut last, mut joints) = (0.0, *start);
        for check in 1..=checks {
            let s = if check == checks { 1.0 } else { check as f64 / checks as f64 };
            let ahead = self.inverse(s, &joints)?;
            self.on_the_way(s, &ahead)?;
            self.check_jump(s, &joints, &ahead)?;
            if let Some(guide) = &mut guide {
                guide.follow((last, &joints), (s, &ahead));
            }
            (last, joints) = (s, ahead);
        }
        Ok(guide)
    }

    fn check_jump(&self, s: f64, from: &Axes, to: &Axes) -> Result<(), GeneratorError> {
        for axis in 0..self.arm.axes() {
            if (to[axis] - from[axis]).abs() > JUMP {
                return Err(GeneratorError::jump(s, axis, &self.arm, (from, to)));
            }
        }
        Ok(())
    }

    /// Follows the line in steps at which the slopes of the joints change by about `change`, relative to the largest
    /// slope. Returns whether there are enough places.
    fn follow(&self, start: &Axes, change: f64, survey: &mut Survey) -> Result<bool, GeneratorError> {
        let (longest, shortest) = STEPS;
        let longest = longest.min(1.0 / self.path.checks() as f64).max(LONG_STEP);
        let (mut s, mut joints, mut step) = (0.0, *start, shortest);
        while s < 1.0 {
            let next = if 1.0 - s < GROWTH * step { 1.0 } else { s + step };
            let ahead = self.joints_at(next, &joints)?;
            let changed = survey.change(next, &ahead);
            if changed > 2.0 * change && step > shortest {
                step = (step / 2.0).max(shortest);
                continue;
            }
            if survey.is_full() {
                return Ok(false);
            }
            self.check_jump(next, &joints, &ahead)?;
            self.on_the_way(next, &ahead)?;
            survey.add(next, ahead);
            (s, joints) = (next, ahead);
            step = (step * (change / changed).clamp(0.5, GROWTH)).clamp(shortest, longest);
        }
        Ok(true)
    }

    /// Joint positions on the path. `near` selects the branch if the pose determines the joints.
    fn joints_at(&self, s: f64, near: &Axes) -> Result<Axes, GeneratorError> {
        let Some(guide) = &self.guide else { return self.inverse(s, near) };
        guide.inverse(&self.arm, &self.path.at(s), s).map_err(|cause| GeneratorError::Path { s, cause })
    }

    /// The joint positions to command at `s`: the joint positions of the path plus the rest of the remainder. Fails
    /// if the arm cannot take these positions.
    fn on_the_way(&self, s: f64, joints: &Axes) -> Result<Axes, GeneratorError> {
        if self.remainder == Axes::default() {
            return Ok(*joints);
        }
        let beside = |axis: usize| joints[axis] + self.remainder[axis] * (1.0 - s);
        let joints = std::array::from_fn(beside);
        self.arm.motors(&joints).map_err(|cause| GeneratorError::Path { s, cause })?;
        Ok(joints)
    }

    fn inverse(&self, s: f64, near: &Axes) -> Result<Axes, GeneratorError> {
        self.arm.inverse(&self.path.at(s), near).map_err(|cause| GeneratorError::Path { s, cause })
    }
}

impl Generator for StraightLine {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    type Memory = LineMemory;

    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<LineMemory>, GeneratorError> {
        let memory = LineMemory { done: 0, joints: self.lay(e)? };
        self.profile.macrosteps = 0;
        self.slowed = None;
        let Some(tool) = self.tool_rates(&e.commanded.pose) else {
            return Ok(Next::remember(memory));
        };
        self.on_the_way(0.0, &memory.joints)?;
        let share = |limits: Axes| limits.map(|limit| limit * SHARE);
        let limits = MotionLimits {
            max_velocity: share(self.joint_limits.max_velocity),
            max_acceleration: share(self.joint_limits.max_acceleration),
            ..self.joint_limits
        };
        self.survey(&memory.joints, &limits)?;
        let (axes, constant_speed) = (self.arm.axes(), self.constant_speed);
        let bounds = Bounds { tool, axes, places: &self.places, constant_speed };
        let profile = &mut self.profile;
        match bounds.fastest() {
            Some((course, duration)) => {
                profile.macrosteps = whole_macrosteps(duration, macrostep.as_secs_f64())?;
                profile.duration = f64::from(profile.macrosteps) * macrostep.as_secs_f64();
                profile.by_joints = Some(course);
                self.slowed = bounds.slowed();
            }
            None => {
                let [velocity, acceleration, jerk] = tool;
                let input = &mut profile.by_tool.input;
                input.target_position[0] = 1.0;
                input.max_velocity[0] = velocity;
                input.max_acceleration[0] = acceleration;
                input.max_jerk[0] = jerk;
                profile.by_tool.solve(None, macrostep.as_secs_f64())?;
                profile.macrosteps = profile.by_tool.macrosteps;
                profile.by_joints = None;
            }
        }
        Ok(Next::remember(memory))
    }

    fn slowed(&self) -> Option<SlowedPart> {
        self.slowed
    }

    fn terminal(&self, memory: &LineMemory, _: &()) -> bool {
        memory.done == self.profile.macrosteps
    }

    fn next_step(&self, memory: &LineMemory, _: &()) -> Result<Next<LineMemory>, GeneratorError> {
        let done = memory.done + 1;
        if done == self.profile.macrosteps {
            let joints = self.joints_at(1.0, &memory.joints)?;
            return Ok(Next::command(Setpoint::Joints(AxesState::at_rest(joints)), LineMemory { done, joints }));
        }
        let [s, rate, push] = self.profile.at(done);
        let s = s.clamp(0.0, 1.0);

        let joints = self.joints_at(s, &memory.joints)?;
        let (before, after) = ((s - EPSILON).max(0.0), (s + EPSILON).min(1.0));
        let (behind, ahead) = (self.joints_at(before, &joints)?, self.joints_at(after, &joints)?);
        let mut state = AxesState::at_rest(self.on_the_way(s, &joints)?);
        let mut acceleration = Axes::default();
        for axis in 0..self.arm.axes() {
            let slope = (ahead[axis] - behind[axis]) / (after - before);
            let (gained, lost) = (ahead[axis] - joints[axis], joints[axis] - behind[axis]);
            // Second derivative over the path. At an end of the path, one of the distances is zero.
            let bend = if s > before && s < after {
                2.0 * (gained / (after - s) - lost / (s - before)) / (after - before)
            } else {
                0.0
            };
            state.velocity[axis] = (slope - self.remainder[axis]) * rate;
            acceleration[axis] = (slope - self.remainder[axis]) * push + bend * rate * rate;
        }
        let state = state.accelerating(acceleration);
        Ok(Next::command(Setpoint::Joints(state), LineMemory { done, joints }))
    }
}
