//! Feed profile: arc length of a path over time.

use std::time::Duration;

use super::cells::TOLERANCE;
use super::demands::Demands;
use super::pacing::{Pacing, Profile};
use super::{GeneratorError, is_limit};
use crate::path::Path;

/// Limits of the tool on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedLimits {
    /// Feed: speed along the path, m/s.
    pub max_velocity: f64,
    /// Tangential acceleration, m/s².
    pub max_acceleration: f64,
    /// Tangential jerk, m/s³.
    pub max_jerk: f64,
    /// Normal acceleration, m/s²: curvature times the square of the speed.
    pub max_normal_acceleration: f64,
    /// Angular velocity, rad/s.
    pub max_angular_velocity: f64,
    /// Angular acceleration, rad/s².
    pub max_angular_acceleration: f64,
}

impl FeedLimits {
    pub(super) fn check(&self) -> Result<(), GeneratorError> {
        let Self { max_velocity, max_acceleration, max_jerk, .. } = *self;
        let Self { max_normal_acceleration, max_angular_velocity, max_angular_acceleration, .. } = *self;
        let linear = [max_velocity, max_acceleration, max_jerk, max_normal_acceleration];
        let sound = linear.into_iter().chain([max_angular_velocity, max_angular_acceleration]).all(is_limit);
        if sound { Ok(()) } else { Err(GeneratorError::PathLimit) }
    }
}

/// Progress along a path at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeedState {
    /// Arc length, m.
    pub distance: f64,
    /// Path speed, m/s.
    pub velocity: f64,
    /// Tangential acceleration, m/s².
    pub acceleration: f64,
    /// Tangential jerk, m/s³.
    pub jerk: f64,
}

/// Feed profile of a path, from rest to rest.
///
/// The path is divided into 2000 cells or more. Curvature, and rotation of the tool per length (rate of turn), limit the
/// speed in each cell. A forward and a backward pass limit the tangential acceleration to A. A moving average over the time
/// T = A / (jerk limit) then limits the jerk. T is the time with the shortest duration: on a path with short sections, a
/// smaller A is faster, because T is shorter as well. No duration rises by more than one step if a limit rises.
///
/// Guaranteed at every time, apart from rounding:
/// - The speed is at most the feed.
/// - The tangential acceleration is continuous and at most A. A is at most the least of the tangential limit, the angular
///   limit divided by the rate of turn, and the acceleration reachable within the jerk limit. The tangential jerk is at
///   most its limit.
/// - The normal acceleration is at most its limit on lines and arcs. On a B-spline, the excess is below 0.1 %.
/// - Angular velocity and angular acceleration are at most their limits. Where the rate of turn changes along the path,
///   the excess is below 0.1 %.
/// - The profile ends exactly at the end of the path.
///
/// In a section of constant curvature, the speed is exactly the bound. Before a lower bound, the tool slows down from a
/// distance of up to twice the speed times T. Where the curvature varies, the speed is below the bound, by the change of the
/// bound over this distance. Where neither curvature nor rate of turn limits the motion, [`along`](Self::along) gives the
/// time-optimal profile from rest to rest.
///
/// Planning allocates. Evaluation is two binary searches.
#[derive(Clone, Debug)]
pub struct Feed {
    /// Sections of constant acceleration, before the moving average. The last one is the standstill at the end.
    sections: Vec<Section>,
    /// Length of the moving average, s.
    window: f64,
}

#[derive(Clone, Copy, Debug)]
struct Section {
    /// Start of the section, s.
    time: f64,
    /// Integral of the distance over time up to the start, m·s.
    integral: f64,
    distance: f64,
    velocity: f64,
    acceleration: f64,
}

impl Section {
    /// Integral of the distance, distance, velocity and acceleration at a time of the section.
    fn at(&self, time: f64) -> [f64; 4] {
        let Self { integral, distance, velocity, acceleration, .. } = *self;
        let t = time - self.time;
        [
            integral + t * (distance + t * (velocity / 2.0 + t * acceleration / 6.0)),
            distance + t * (velocity + t * acceleration / 2.0),
            velocity + t * acceleration,
            acceleration,
        ]
    }
}

impl Feed {
    /// The profile of a path.
    pub fn along(path: &Path, limits: &FeedLimits) -> Result<Self, GeneratorError> {
        Self::plan(path, limits, None)
    }

    /// The profile of a path, with a duration that is a multiple of `step`. For this, the moving average is longer by less
    /// than one step. The feed does not change.
    pub fn in_steps(path: &Path, limits: &FeedLimits, step: Duration) -> Result<Self, GeneratorError> {
        if step.is_zero() {
            return Err(GeneratorError::NoMacrostep);
        }
        Self::plan(path, limits, Some(step.as_secs_f64()))
    }

    /// The profile within the limits of tool and joints. If the joints limit the motion somewhere, the second profile
    /// is the one within the limits of the tool alone.
    pub(super) fn within(
        path: &Path,
        limits: &FeedLimits,
        step: Duration,
        joints: &Demands,
    ) -> Result<(Self, Option<Self>), GeneratorError> {
        let step = Some(step.as_secs_f64());
        let pacing = Pacing::of(path, limits, step);
        let by_tool = Self::of(pacing.fastest(), step)?;
        match pacing.within(joints) {
            Some(pacing) => Ok((Self::of(pacing.fastest(), step)?, Some(by_tool))),
            None => Ok((by_tool, None)),
        }
    }

    fn plan(path: &Path, limits: &FeedLimits, step: Option<f64>) -> Result<Self, GeneratorError> {
        limits.check()?;
        Self::of(Pacing::of(path, limits, step).fastest(), step)
    }

    fn of(Profile { nodes, squares, window }: Profile, step: Option<f64>) -> Result<Self, GeneratorError> {
        let sections = sections(&nodes, &squares);
        let end = sections[sections.len() - 1].time;
        if !end.is_finite() {
            return Err(GeneratorError::NoProfile);
        }
        let window = match step {
            None => window,
            Some(step) => ((end + window) / step - TOLERANCE).ceil() * step - end,
        };
        Ok(Self { sections, window })
    }

    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.end().time + self.window
    }

    fn end(&self) -> &Section {
        &self.sections[self.sections.len() - 1]
    }

    /// State `time` s after the start. Times before the start and after the end give the states at the ends.
    pub fn at(&self, time: f64) -> FeedState {
        if time >= self.duration() {
            return FeedState { distance: self.end().distance, ..FeedState::default() };
        }
        let (now, before) = (self.before_average(time), self.before_average(time - self.window));
        let mean = |derivative: usize| (now[derivative] - before[derivative]) / self.window;
        FeedState {
            distance: mean(0).clamp(0.0, self.end().distance),
            velocity: mean(1),
            acceleration: mean(2),
            jerk: mean(3),
        }
    }

    fn before_average(&self, time: f64) -> [f64; 4] {
        match self.sections.partition_point(|section| section.time <= time) {
            0 => [0.0; 4],
            after => self.sections[after - 1].at(time),
        }
    }
}

/// Sections of constant acceleration between the nodes.
fn sections(nodes: &[f64], squares: &[f64]) -> Vec<Section> {
    let mut sections = Vec::with_capacity(nodes.len());
    let (mut time, mut integral) = (0.0, 0.0);
    for cell in 0..nodes.len() - 1 {
        let length = nodes[cell + 1] - nodes[cell];
        let (from, to) = (squares[cell].sqrt(), squares[cell + 1].sqrt());
        let acceleration = (squares[cell + 1] - squares[cell]) / (2.0 * length);
        let section = Section { time, integral, distance: nodes[cell], velocity: from, acceleration };
        sections.push(section);
        time += 2.0 * length / (from + to);
        [integral, ..] = section.at(time);
    }
    sections.push(Section { time, integral, distance: nodes[nodes.len() - 1], velocity: 0.0, acceleration: 0.0 });
    sections
}
