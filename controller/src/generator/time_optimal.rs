//! Time-optimal motion of joints or motors along a spline.

use std::time::Duration;

use servo::MAX_AXES;

use super::newsmooth::whole_macrosteps;
use super::{
    Axes, AxesState, EffectorImage, EndSpeeds, Generator, GeneratorError, MotionLimits, Next, Pace, PathTiming,
};
use crate::path::{JointPath, PathError, SplineEnds};
use crate::robot::Space;

/// If the effector is nearer to the first way-point than this, the path begins at this way-point; rad or m.
const THERE: f64 = 1e-9;
/// Share of the limits that is given to the timing, which exceeds limits by up to 0.1 % between the nodes of its grid.
const SHARE: f64 = 1.0 / 1.001;
/// Accepted distance of an axis from the start of a given path, rad or m.
const AT_START: f64 = 1e-6;

/// A time-optimal motion from rest to rest along the natural cubic spline through way-points, or along a given path.
/// Class 0, planned from the effector.
///
/// The first step lays the [`JointPath`] from the commanded position of the effector through the way-points, and
/// plans its [`PathTiming`] within the limits of velocity and acceleration. The macrosteps last [one servo
/// period](Pace::PERIOD): each set-point is a sample of this timing, which is stretched to a whole number of periods. The
/// acceleration jumps.
///
/// Between way-points the spline may leave the range that the way-points span.
///
/// The first step allocates. Its computing time is below 1 ms for seven axes. No next step allocates.
#[doc(alias = "toppra")]
#[derive(Clone, Debug)]
pub struct TimeOptimal {
    space: Space,
    axes: usize,
    limits: MotionLimits,
    course: Course,
    plan: Option<Plan>,
}

#[derive(Clone, Debug)]
enum Course {
    /// Way-points of a spline from the present position.
    Through(Vec<Axes>),
    /// A path that begins where the effector stands.
    Along(JointPath),
}

#[derive(Clone, Debug)]
struct Plan {
    timing: PathTiming,
    macrosteps: u32,
    /// Time in the timing per macrostep, s.
    step: f64,
    /// Time in the timing divided by real time; at most 1.
    pace: f64,
}

impl TimeOptimal {
    /// A motion of the first `axes` axes through way-points, rad, or m for a linear joint. `limits.max_jerk` has no
    /// effect.
    pub fn through(
        space: Space,
        axes: usize,
        limits: MotionLimits,
        way_points: Vec<Axes>,
    ) -> Result<Self, GeneratorError> {
        limits.check(axes)?;
        if way_points.is_empty() {
            return Err(GeneratorError::NoPoses);
        }
        for (pose, position) in way_points.iter().enumerate() {
            if let Some(axis) = position[..axes].iter().position(|p| !p.is_finite()) {
                return Err(GeneratorError::NotFinite { pose, axis: axis as u8 });
            }
        }
        if let Some(point) = way_points.windows(2).position(|pair| distance(&pair[0], &pair[1], axes) < THERE) {
            return Err(GeneratorError::JointPath(PathError::Coincident { point }));
        }
        Ok(Self { space, axes, limits, course: Course::Through(way_points), plan: None })
    }

    /// A motion along a path of the joints or motors, for example a B-spline ([`JointPath::along`]). The first step
    /// refuses an effector that stands more than 1e-6 rad or m from the start of the path. `limits.max_jerk` has no
    /// effect.
    pub fn along(space: Space, limits: MotionLimits, path: JointPath) -> Result<Self, GeneratorError> {
        let axes = path.axes();
        limits.check(axes)?;
        Ok(Self { space, axes, limits, course: Course::Along(path), plan: None })
    }

    /// The timing of the planned motion. `None` before the first step, and if the effector already stands at the only
    /// way-point.
    pub fn timing(&self) -> Option<&PathTiming> {
        self.plan.as_ref().map(|plan| &plan.timing)
    }

    fn planned(&self, start: Axes, macrostep: f64) -> Result<Option<Plan>, GeneratorError> {
        let path = match &self.course {
            Course::Through(way_points) => {
                let mut points = vec![start];
                let there = distance(&start, &way_points[0], self.axes) < THERE;
                points.extend(way_points.iter().skip(usize::from(there)));
                if points.len() < 2 {
                    return Ok(None);
                }
                let ends = SplineEnds::<MAX_AXES>::Natural;
                JointPath::through(self.axes, &points, ends).map_err(GeneratorError::JointPath)?
            }
            Course::Along(path) => {
                let begin = path.at(0.0).position;
                for (axis, (begin, start)) in begin.iter().zip(start).enumerate().take(self.axes) {
                    let distance = (start - begin).abs();
                    if distance > AT_START {
                        return Err(GeneratorError::NotAtJointStart { axis: axis as u8, distance });
                    }
                }
                path.clone()
            }
        };
        let limits = MotionLimits {
            max_velocity: self.limits.max_velocity.map(|limit| limit * SHARE),
            max_acceleration: self.limits.max_acceleration.map(|limit| limit * SHARE),
            ..self.limits
        };
        let timing = PathTiming::optimal(path, &limits, EndSpeeds::default()).map_err(GeneratorError::Timing)?;
        let macrosteps = whole_macrosteps(timing.duration(), macrostep)?;
        let step = timing.duration() / f64::from(macrosteps);
        Ok(Some(Plan { timing, macrosteps, step, pace: step / macrostep }))
    }
}

/// Straight distance of two positions, rad or m.
fn distance(from: &Axes, to: &Axes, axes: usize) -> f64 {
    from.iter().zip(to).take(axes).map(|(from, to)| (to - from).powi(2)).sum::<f64>().sqrt()
}

impl Generator for TimeOptimal {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.plan = self.planned(self.space.commanded(e).position, macrostep.as_secs_f64())?;
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &()) -> bool {
        self.plan.as_ref().is_none_or(|plan| *done == plan.macrosteps)
    }

    fn next_step(&self, done: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let Plan { timing, macrosteps, step, pace } = self.plan.as_ref().ok_or(GeneratorError::NoProfile)?;
        let done = done + 1;
        let state = if done == *macrosteps {
            AxesState::at_rest(timing.at(timing.duration()).position)
        } else {
            let AxesState { position, velocity, acceleration } = timing.at(f64::from(done) * step);
            let acceleration = acceleration.unwrap_or_default().map(|value| value * pace * pace);
            AxesState::new(position, velocity.map(|value| value * pace)).accelerating(acceleration)
        };
        Ok(Next::command(self.space.setpoint(state), done))
    }
}
