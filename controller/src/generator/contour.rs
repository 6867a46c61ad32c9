//! Paths of the tool with a feed profile.

use std::time::Duration;

use super::feed::{Feed, FeedLimits};
use super::newsmooth::whole_macrosteps;
use super::{Axes, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, Pose, Setpoint};
use crate::path::{Path, PoseState};
use crate::robot::Arm;

/// Spacing of the poses that are checked before the motion: at most 5 mm and 10 mrad.
const CHECK_DISTANCE: f64 = 0.005;
const CHECK_ANGLE: f64 = 0.01;
/// Largest motion of an axis, rad or m, between two neighbouring checks. A larger motion changes the branch.
const JUMP: f64 = 0.35;
/// Largest accepted factor by which one axis slows a path.
const SLOWEST: f64 = 50.0;
/// Accepted excess of an axis over its limit, as a factor by which the path would be slowed, less 1.
const EXCESS: f64 = 1e-3;
/// Largest number of plans, each slower than the plan before.
const PLANS: u32 = 8;
/// Largest distance of the tool from the start of the path, m and rad.
const START_DISTANCE: f64 = 1e-6;
const START_ANGLE: f64 = 1e-5;

/// A motion of the tool along a [`Path`] with a [`Feed`] profile. Class 0, planned from the effector.
///
/// The effector must stand at the start of the path, within 1 µm and 10 µrad. A [`StraightLine`](super::StraightLine)
/// moves the tool there.
///
/// The first step plans the profile. Its duration is a whole number of servo periods, and the feed (speed along the path)
/// is exact. Poses of the path at most 5 mm and 10 mrad apart are then checked for reach, joint limits, and jumps between
/// branches of the inverse kinematics. If an axis would exceed its velocity or acceleration limit, the whole path is slowed
/// down. A path that needs a factor above 50 is refused.
///
/// The macrosteps last [one servo period](Pace::PERIOD): the pose of each set-point is exact.
///
/// The first step allocates. It solves the inverse kinematics of each checked pose once per plan, with at most eight
/// plans. No next step allocates.
#[doc(alias = "spline")]
#[derive(Debug)]
pub struct Contour {
    arm: Arm,
    path: Path,
    limits: FeedLimits,
    joint_limits: MotionLimits,
    plan: Option<Plan>,
}

#[derive(Debug)]
struct Plan {
    feed: Feed,
    /// Duration of a macrostep, s.
    macrostep: f64,
    macrosteps: u32,
}

/// The axis that slows a path most.
struct Slowest {
    times: f64,
    axis: u8,
    /// Place on the path, from 0 at the start to 1 at the end.
    s: f64,
}

impl Contour {
    /// A motion along a path, which begins where the tool stands.
    pub fn along(arm: Arm, path: Path, limits: FeedLimits, joint_limits: MotionLimits) -> Result<Self, GeneratorError> {
        joint_limits.check(arm.axes())?;
        limits.check()?;
        Ok(Self { arm, path, limits, joint_limits, plan: None })
    }

    /// Exact state of the tool after `done` servo periods of the planned motion, with its acceleration. `None` before the
    /// first step.
    pub fn state(&self, done: u32) -> Option<PoseState> {
        let Plan { feed, macrostep, macrosteps } = self.plan.as_ref()?;
        if done >= *macrosteps {
            return Some(self.path.moving_at(self.path.length(), 0.0, 0.0));
        }
        let state = feed.at(f64::from(done) * macrostep);
        Some(self.path.moving_at(state.distance, state.velocity, state.acceleration))
    }

    /// The feed profile of the planned motion. `None` before the first step.
    pub fn feed(&self) -> Option<&Feed> {
        self.plan.as_ref().map(|plan| &plan.feed)
    }

    fn check_start(&self, pose: &Pose) -> Result<(), GeneratorError> {
        let start = self.path.at(0.0).pose;
        let distance = (pose.translation.vector - start.translation.vector).norm();
        let angle = pose.rotation.angle_to(&start.rotation);
        let there = distance <= START_DISTANCE && angle <= START_ANGLE;
        if there { Ok(()) } else { Err(GeneratorError::NotAtStart { distance, angle }) }
    }

    /// Follows the whole path. Returns the axis that slows the path most, by a factor of 1 at least.
    fn slowest(&self, start: &Axes, plan: &Plan, limits: &FeedLimits) -> Result<Slowest, GeneratorError> {
        let distance = limits.max_velocity * plan.macrostep / CHECK_DISTANCE;
        let angle = limits.max_angular_velocity.min(limits.max_velocity * self.path.turning_rate().0) * plan.macrostep
            / CHECK_ANGLE;
        let parts = distance.max(angle).ceil().max(1.0);
        let dt = plan.macrostep / parts;
        let mut slowest = Slowest { times: 1.0, axis: 0, s: 0.0 };
        let (mut joints, mut velocity) = (*start, Axes::default());
        for check in 1..=u64::from(plan.macrosteps) * parts as u64 {
            let distance = plan.feed.at(check as f64 * dt).distance;
            let s = distance / self.path.length();
            let pose = self.path.at(distance).pose;
            let ahead = self.arm.inverse(&pose, &joints).map_err(|cause| GeneratorError::Path { s, cause })?;
            for axis in 0..self.arm.axes() {
                let by = ahead[axis] - joints[axis];
                if by.abs() > JUMP {
                    return Err(GeneratorError::jump(s, axis, &self.arm, (&joints, &ahead)));
                }
                let speed = by / dt;
                let push = (speed - velocity[axis]).abs() / dt / self.joint_limits.max_acceleration[axis];
                let times = (speed.abs() / self.joint_limits.max_velocity[axis]).max(push.sqrt());
                if times > slowest.times {
                    slowest = Slowest { times, axis: axis as u8, s };
                }
                velocity[axis] = speed;
            }
            joints = ahead;
        }
        Ok(slowest)
    }
}

impl Generator for Contour {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.check_start(&e.commanded.pose)?;
        let mut slowdown = 1.0;
        for _ in 0..PLANS {
            let limits = self.limits.slowed(slowdown);
            let feed = Feed::in_steps(&self.path, &limits, macrostep)?;
            let macrosteps = whole_macrosteps(feed.duration(), macrostep.as_secs_f64())?;
            let plan = Plan { feed, macrostep: macrostep.as_secs_f64(), macrosteps };
            let Slowest { times, axis, s } = self.slowest(&e.commanded.joints.position, &plan, &limits)?;
            if times <= 1.0 + EXCESS {
                self.plan = Some(plan);
                return Ok(Next::remember(0));
            }
            slowdown *= times;
            if slowdown > SLOWEST {
                return Err(GeneratorError::Singular { s, axis, times: slowdown });
            }
        }
        Err(GeneratorError::NoProfile)
    }

    fn terminal(&self, done: &u32, _: &()) -> bool {
        self.plan.as_ref().is_none_or(|plan| *done == plan.macrosteps)
    }

    fn next_step(&self, done: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let done = done + 1;
        let state = self.state(done).ok_or(GeneratorError::NoProfile)?;
        Ok(Next::command(Setpoint::Tool(state), done))
    }
}
