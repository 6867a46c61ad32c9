//! Paths of the tool with a feed profile.

use std::time::Duration;

use super::demands::Demands;
use super::feed::{Feed, FeedLimits, FeedState};
use super::newsmooth::whole_macrosteps;
use super::progress::Place;
use super::survey::Survey;
use super::{Axes, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, Pose, Setpoint, SlowedPart};
use crate::path::{Path, PoseState};
use crate::robot::Arm;

/// Spacing of the poses that are checked before the motion: at most 5 mm and 10 mrad.
const CHECK_DISTANCE: f64 = 0.005;
const CHECK_ANGLE: f64 = 0.01;
/// Largest motion of an axis, rad or m, between two neighbouring checks. A larger motion changes the branch.
const JUMP: f64 = 0.35;
/// Largest direction change of a B-spline between two places at which the limits of the joints are computed, rad.
const TURN: f64 = 0.05;
/// Longest and shortest distance of two such places, relative to the path.
const STEPS: [f64; 2] = [1.0 / 512.0, 5e-5];
/// Least number of such places in a part of constant curvature.
const PLACES: f64 = 4.0;
/// Greatest motion of an axis between two places at the shortest distance, rad or m, that needs no examination for a
/// jump.
const SUDDEN: f64 = 1e-6;
/// Greatest share of a motion in one half of the distance. A motion that exceeds this share in each halving is a jump.
const IN_ONE_HALF: f64 = 0.9;
const HALVINGS: u32 = 6;
/// Largest distance of an axis, rad or m, from the joint positions at the start of the path.
const BESIDE: f64 = 1e-3;
/// Largest change of the slope of a joint from place to place, relative to the largest slope.
const CHANGE: f64 = 1.0 / 12.0;
/// Share of the joint limits that a plan uses. The rest is a margin for the course between the places.
const SHARE: f64 = 0.99;
/// Accepted excess of a joint over its limit at the set-points, relative.
const EXCESS: f64 = 2e-3;
/// Largest number of plans, each slower in some places than the plan before.
const PLANS: u32 = 8;
/// Largest distance of the tool from the start of the path, m and rad.
const START_DISTANCE: f64 = 1e-6;
const START_ANGLE: f64 = 1e-5;
/// The joints are on the path from its start.
const NO_REMAINDER: Axes = [0.0; servo::MAX_AXES];

/// A motion of the tool along a [`Path`] with a [`Feed`] profile. Class 0, planned from the effector.
///
/// The effector must stand at the start of the path, within 1 µm and 10 µrad. A [`StraightLine`](super::StraightLine)
/// moves the tool there.
///
/// The first step plans the profile. Its duration is a whole number of servo periods, and the feed (speed along the
/// path) is exact where nothing limits the feed. Poses of the path at most 5 mm and 10 mrad apart are then checked for
/// reach, joint limits, and jumps between branches of the inverse kinematics. Where an axis would exceed its velocity
/// or acceleration limit, the feed is lower ([`at_constant_speed`](Self::at_constant_speed): on the whole path). If a
/// limit rises, no duration rises by more than a servo period. Exceptions are kinks in the course of the joints of an
/// arm with more axes than a pose determines.
///
/// The macrosteps last [one servo period](Pace::PERIOD): the pose of each set-point is exact.
///
/// The first step allocates. It solves the inverse kinematics at about 500 places or more, and once at each set-point.
/// If the course of the joints has kinks, it does so up to eight times at each set-point. No next step allocates.
#[doc(alias = "spline")]
#[derive(Debug)]
pub struct Contour {
    arm: Arm,
    path: Path,
    limits: FeedLimits,
    joint_limits: MotionLimits,
    /// Whether the slowest part that joints limit bounds the feed on the whole path.
    constant_speed: bool,
    plan: Option<Plan>,
    /// The part that joints slow.
    slowed: Option<SlowedPart>,
}

#[derive(Debug)]
struct Plan {
    feed: Feed,
    /// Duration of a macrostep, s.
    macrostep: f64,
    macrosteps: u32,
}

impl Contour {
    /// A motion along a path, which begins where the tool stands.
    pub fn along(arm: Arm, path: Path, limits: FeedLimits, joint_limits: MotionLimits) -> Result<Self, GeneratorError> {
        joint_limits.check(arm.axes())?;
        limits.check()?;
        Ok(Self { arm, path, limits, joint_limits, constant_speed: false, plan: None, slowed: None })
    }

    /// The same motion with one bound of the feed on the whole path, for example for engraving. A path that joints
    /// limit is then slower as a whole, not only where a joint is fast.
    #[must_use]
    pub fn at_constant_speed(self) -> Self {
        Self { constant_speed: true, ..self }
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

    /// Checks reach, ranges and jumps on the whole path, and computes the derivatives of the joint positions.
    fn survey(&self, start: &Axes) -> Result<Vec<Place>, GeneratorError> {
        let share = |limits: Axes| limits.map(|limit| limit * SHARE);
        let limits = MotionLimits {
            max_velocity: share(self.joint_limits.max_velocity),
            max_acceleration: share(self.joint_limits.max_acceleration),
            ..self.joint_limits
        };
        let length = self.path.length();
        let [longest, shortest] = STEPS.map(|step| step * length);
        let longest = longest.min(CHECK_DISTANCE).min(CHECK_ANGLE / self.path.max_turning_rate()).max(shortest);
        let mut stops = self.path.divisions(TURN);
        stops.push(length);
        stops.sort_by(f64::total_cmp);
        let begin = self.inverse(0.0, start)?;
        self.check_jump(0.0, (start, &begin), BESIDE)?;
        let mut survey = Survey::begin(Vec::new(), &limits, self.arm.axes(), &NO_REMAINDER, &begin);
        let (mut s, mut joints) = (0.0, begin);
        for stop in stops {
            let stop = if length - stop < shortest { length } else { stop };
            if stop - s < shortest {
                continue;
            }
            let longest = longest.min((stop - s) / PLACES).max(shortest);
            let mut step = longest;
            while s < stop {
                let next = if stop - s < 1.5 * step { stop } else { s + step };
                let ahead = self.inverse(next, &joints)?;
                if survey.change(next, &ahead) > 2.0 * CHANGE && step > shortest {
                    step = (step / 2.0).max(shortest);
                    continue;
                }
                self.check_jump(next, (&joints, &ahead), JUMP)?;
                if step <= shortest {
                    self.check_continuity([s, next], [joints, ahead])?;
                }
                survey.add(next, ahead);
                (s, joints) = (next, ahead);
                step = (1.5 * step).min(longest);
            }
        }
        Ok(survey.end())
    }

    fn check_jump(&self, distance: f64, (from, to): (&Axes, &Axes), most: f64) -> Result<(), GeneratorError> {
        for axis in 0..self.arm.axes() {
            let by = to[axis] - from[axis];
            if by.abs() > most {
                return Err(GeneratorError::jump(distance / self.path.length(), axis, &self.arm, (from, to)));
            }
        }
        Ok(())
    }

    /// Refuses a jump between two places. Halving the distance halves a continuous motion, and leaves a jump unchanged.
    fn check_continuity(&self, mut places: [f64; 2], mut ends: [Axes; 2]) -> Result<(), GeneratorError> {
        let most = |[from, to]: &[Axes; 2]| {
            let by = (0..self.arm.axes()).map(|axis| (axis, (to[axis] - from[axis]).abs()));
            by.fold((0, 0.0), |most, next| if next.1 > most.1 { next } else { most })
        };
        let (axis, by) = most(&ends);
        if by <= SUDDEN {
            return Ok(());
        }
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(places[0], places[1]);
            let between = self.inverse(middle, &ends[0])?;
            let halves = [[ends[0], between], [between, ends[1]]];
            let whole = most(&ends).1;
            let Some(half) = halves.iter().position(|half| most(half).1 > IN_ONE_HALF * whole) else {
                return Ok(());
            };
            places[1 - half] = middle;
            ends = halves[half];
        }
        Err(GeneratorError::jump(places[0] / self.path.length(), axis, &self.arm, (&ends[0], &ends[1])))
    }

    fn inverse(&self, distance: f64, near: &Axes) -> Result<Axes, GeneratorError> {
        let s = distance / self.path.length();
        self.arm.inverse(&self.path.at(distance).pose, near).map_err(|cause| GeneratorError::Path { s, cause })
    }

    /// Follows all set-points, and bounds the speed where a joint exceeds a limit. This happens at kinks in the course
    /// of the joints, which the places of the survey do not resolve. Returns whether a kink was found.
    fn slow_kinks(&self, start: &Axes, plan: &Plan, demands: &mut Demands) -> Result<bool, GeneratorError> {
        let dt = plan.macrostep;
        let mut found = false;
        let (mut joints, mut velocity) = (self.inverse(0.0, start)?, Axes::default());
        let mut way = [0.0; 2];
        for done in 1..=plan.macrosteps {
            let FeedState { distance, .. } = plan.feed.at(f64::from(done) * dt);
            let ahead = self.inverse(distance, &joints)?;
            for axis in 0..self.arm.axes() {
                let speed = (ahead[axis] - joints[axis]) / dt;
                let push = (speed - velocity[axis]).abs() / dt;
                let by_push = push / self.joint_limits.max_acceleration[axis];
                let times = by_push.max(speed.abs() / self.joint_limits.max_velocity[axis]);
                if times > 1.0 + EXCESS {
                    // A kink needs an acceleration in proportion to the speed.
                    let mean = (distance - way[0]) / (2.0 * dt);
                    demands.bound([way[0], distance], SHARE * mean / times, axis as u8);
                    found = true;
                }
                velocity[axis] = speed;
            }
            way = [way[1], distance];
            joints = ahead;
        }
        Ok(found)
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
        self.slowed = None;
        let start = &e.commanded.joints.position;
        let mut demands = Demands::new(self.survey(start)?, self.arm.axes(), self.constant_speed);
        for _ in 0..PLANS {
            let (feed, by_tool) = Feed::within(&self.path, &self.limits, macrostep, &demands)?;
            let macrosteps = whole_macrosteps(feed.duration(), macrostep.as_secs_f64())?;
            let plan = Plan { feed, macrostep: macrostep.as_secs_f64(), macrosteps };
            if !self.slow_kinks(start, &plan, &mut demands)? {
                self.slowed = by_tool.and_then(|feed| demands.slowed(&feed));
                self.plan = Some(plan);
                return Ok(Next::remember(0));
            }
        }
        Err(GeneratorError::NoProfile)
    }

    fn slowed(&self) -> Option<SlowedPart> {
        self.slowed
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
