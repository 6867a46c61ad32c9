//! Generator of a time-synchronised motion through a list of poses, with trapezoidal velocity profiles.

use std::time::Duration;

use servo::MAX_AXES;

use super::profile::{Course, Trapezoid};
use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, Setpoint};
use crate::robot::Space;

/// Maximum number of macrosteps of one motion: more than four hours with macrosteps of 1 ms.
pub(super) const MAX_MACROSTEPS: u32 = 1 << 24;

impl Space {
    pub(super) const fn commanded(self, image: &EffectorImage) -> AxesState {
        match self {
            Self::Joint => image.commanded.joints,
            Self::Motor => image.commanded.motors,
        }
    }

    pub(super) const fn acceleration(self, image: &EffectorImage) -> Axes {
        match self {
            Self::Joint => image.commanded_acceleration.joints,
            Self::Motor => image.commanded_acceleration.motors,
        }
    }

    pub(super) const fn setpoint(self, state: AxesState) -> Setpoint {
        match self {
            Self::Joint => Setpoint::Joints(state),
            Self::Motor => Setpoint::Motors(state),
        }
    }
}

/// One pose of a [`Newsmooth`] motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothPose {
    /// Target position of each axis, rad, or m for a linear joint.
    pub position: Axes,
    /// Fraction of each axis's velocity limit on the segment to this pose, in (0, 1].
    pub velocity: Axes,
    /// Fraction of each axis's acceleration limit on the segment to this pose, in (0, 1].
    pub acceleration: Axes,
}

impl SmoothPose {
    /// A pose whose segment uses the full velocity and acceleration limits.
    pub const fn fast(position: Axes) -> Self {
        Self { position, velocity: [1.0; MAX_AXES], acceleration: [1.0; MAX_AXES] }
    }
}

/// A time-synchronised motion through a list of poses, with trapezoidal velocity profiles. An axis does not stop at a
/// pose if its direction of travel is the same before and after the pose. Class 0, planned from the effector.
///
/// The macrosteps last [one servo period](Pace::PERIOD): each set-point is a sample of the profiles, whose acceleration
/// jumps. Every pose is reached exactly, at the end of a period. The slowest axis determines the duration of a segment (the
/// motion between two poses), rounded up to whole periods. The profiles of the other axes are stretched to this duration.
///
/// The speed of an axis at a pose that it passes has two bounds. The first bound is the smaller of the speeds in the
/// segments before and after the pose if all axes moved at constant speed. With the second bound, the axis can brake to a
/// standstill and accelerate again within either segment. Each segment can therefore be planned once and independently.
///
/// The computing time of the first step is proportional to the number of poses. The first step of a clone may allocate,
/// all other steps do not.
#[doc(alias = "smooth")]
#[doc(alias = "trapezoid")]
#[derive(Clone, Debug)]
pub struct Newsmooth {
    space: Space,
    axes: usize,
    limits: MotionLimits,
    poses: Vec<SmoothPose>,
    /// Positions are displacements from the pose before. The first step replaces them by positions.
    displacements: bool,
    macrostep: f64,
    segments: Vec<Segment>,
}

#[derive(Clone, Debug)]
struct Segment {
    macrosteps: u32,
    start: Axes,
    end: Axes,
    profiles: [Trapezoid; MAX_AXES],
}

impl Segment {
    fn direction(&self, axis: usize) -> f64 {
        if self.end[axis] < self.start[axis] { -1.0 } else { 1.0 }
    }
}

/// Progress of a [`Newsmooth`] motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Number of completed segments, which is the index of the current segment.
    segment: usize,
    /// Number of completed macrosteps in the current segment.
    macrostep: u32,
}

impl Newsmooth {
    /// A motion of the first `axes` axes from the commanded position of the effector through `poses`.
    pub fn new(
        space: Space,
        axes: usize,
        limits: MotionLimits,
        poses: Vec<SmoothPose>,
    ) -> Result<Self, GeneratorError> {
        limits.check(axes)?;
        if poses.is_empty() {
            return Err(GeneratorError::NoPoses);
        }
        for (index, pose) in poses.iter().enumerate() {
            for axis in 0..axes {
                if !pose.position[axis].is_finite() {
                    return Err(GeneratorError::NotFinite { pose: index, axis: axis as u8 });
                }
                for value in [pose.velocity[axis], pose.acceleration[axis]] {
                    if !(value > 0.0 && value <= 1.0) {
                        return Err(GeneratorError::Fraction { pose: index, axis: axis as u8, value });
                    }
                }
            }
        }
        let segments = Vec::with_capacity(poses.len());
        Ok(Self { space, axes, limits, poses, displacements: false, macrostep: 0.0, segments })
    }

    /// The same motion, in which each position is the displacement from the pose before. The first displacement is from the
    /// commanded position of the effector.
    #[must_use]
    pub fn by_displacements(self) -> Self {
        Self { displacements: true, ..self }
    }

    /// Replaces displacements by positions.
    fn add_up(&mut self, start: &Axes) {
        let mut from = *start;
        for pose in &mut self.poses {
            for (position, from) in pose.position.iter_mut().zip(from) {
                *position += from;
            }
            from = pose.position;
        }
        self.displacements = false;
    }

    /// Signed distance of one axis in the segment to pose `index`; zero beyond the last pose.
    fn distance(&self, start: &Axes, index: usize, axis: usize) -> f64 {
        let Some(pose) = self.poses.get(index) else {
            return 0.0;
        };
        let from = if index == 0 { start } else { &self.poses[index - 1].position };
        pose.position[axis] - from[axis]
    }

    /// Shortest duration of the segment to pose `index` if all axes moved at constant speed, s.
    fn cruise_time(&self, start: &Axes, index: usize) -> f64 {
        let times = (0..self.axes).map(|axis| {
            let limit = self.poses[index].velocity[axis] * self.limits.max_velocity[axis];
            self.distance(start, index, axis).abs() / limit
        });
        times.fold(0.0, f64::max)
    }

    /// Whether an axis travels in the same direction before and after pose `index`.
    fn passes(&self, start: &Axes, index: usize, axis: usize) -> bool {
        self.distance(start, index, axis) * self.distance(start, index + 1, axis) > 0.0
    }

    /// Speed of each axis at pose `index`.
    fn junction(&self, start: &Axes, index: usize) -> Axes {
        let mut speeds = [0.0; MAX_AXES];
        if index + 1 >= self.poses.len() {
            return speeds;
        }
        let [before, after] = [index, index + 1].map(|segment| self.cruise_time(start, segment));
        for (axis, speed) in speeds.iter_mut().enumerate().take(self.axes) {
            if !self.passes(start, index, axis) {
                continue;
            }
            // Bound of v² at one end: a s, so that both ends together stay within 2 a s. If the axis stands at the
            // other end, the bound is 2 a s.
            let claim = |segment: usize, other_end_stands: bool| {
                let a = self.poses[segment].acceleration[axis] * self.limits.max_acceleration[axis];
                let s = self.distance(start, segment, axis).abs();
                (if other_end_stands { 2.0 * a * s } else { a * s }).sqrt()
            };
            let stood_before = index == 0 || !self.passes(start, index - 1, axis);
            let stands_after = !self.passes(start, index + 1, axis);
            let cruise = |segment, time| self.distance(start, segment, axis).abs() / time;
            *speed = cruise(index, before)
                .min(cruise(index + 1, after))
                .min(claim(index, stood_before))
                .min(claim(index + 1, stands_after));
        }
        speeds
    }

    fn plan(&mut self, start: &Axes) -> Result<(), GeneratorError> {
        self.segments.clear();
        let mut from = *start;
        let mut entry = [0.0; MAX_AXES];
        let mut total = 0_u32;
        for index in 0..self.poses.len() {
            let exit = self.junction(start, index);
            let pose = &self.poses[index];
            let course = |axis: usize| Course {
                distance: (pose.position[axis] - from[axis]).abs(),
                start_velocity: entry[axis],
                end_velocity: exit[axis],
                acceleration: pose.acceleration[axis] * self.limits.max_acceleration[axis],
            };
            let times =
                (0..self.axes).map(|axis| course(axis).shortest(pose.velocity[axis] * self.limits.max_velocity[axis]));
            let macrosteps = whole_macrosteps(times.fold(0.0, f64::max), self.macrostep)?;
            total = total.saturating_add(macrosteps);
            if total > MAX_MACROSTEPS {
                return Err(GeneratorError::TooLong { limit: MAX_MACROSTEPS });
            }
            if macrosteps > 0 {
                let duration = f64::from(macrosteps) * self.macrostep;
                let mut profiles = [Trapezoid::default(); MAX_AXES];
                for (axis, profile) in profiles.iter_mut().enumerate().take(self.axes) {
                    *profile = course(axis).lasting(duration);
                }
                self.segments.push(Segment { macrosteps, start: from, end: pose.position, profiles });
            }
            from = pose.position;
            entry = exit;
        }
        Ok(())
    }
}

/// Smallest number of macrosteps that lasts at least `seconds`, with a tolerance of a billionth of a macrostep.
pub(super) fn whole_macrosteps(seconds: f64, macrostep: f64) -> Result<u32, GeneratorError> {
    let count = (seconds / macrostep - 1e-9).ceil().max(0.0);
    if count <= f64::from(MAX_MACROSTEPS) {
        Ok(count as u32)
    } else {
        Err(GeneratorError::TooLong { limit: MAX_MACROSTEPS })
    }
}

impl Generator for Newsmooth {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    type Memory = Progress;

    fn pace(&self, _: Pace) -> Pace {
        Pace::PERIOD
    }

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<Progress>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        let start = self.space.commanded(e).position;
        if self.displacements {
            self.add_up(&start);
        }
        self.plan(&start)?;
        Ok(Next::remember(Progress::default()))
    }

    fn terminal(&self, progress: &Progress, _: &()) -> bool {
        progress.segment == self.segments.len()
    }

    fn next_step(&self, progress: &Progress, _: &()) -> Result<Next<Progress>, GeneratorError> {
        let segment = &self.segments[progress.segment];
        let macrostep = progress.macrostep + 1;
        let last = macrostep == segment.macrosteps;
        let t = f64::from(macrostep) * self.macrostep;
        let next = self.segments.get(progress.segment + 1).filter(|_| last);
        let over = last && next.is_none();
        let (mut state, mut acceleration) = (AxesState::default(), Axes::default());
        for (axis, profile) in segment.profiles.iter().enumerate().take(self.axes) {
            let (from, to) = (segment.start[axis], segment.end[axis]);
            let direction = segment.direction(axis);
            let (distance, speed) = profile.at(t);
            state.position[axis] = if last { to } else { from + direction * distance };
            state.velocity[axis] = direction * if last { profile.end_velocity } else { speed };
            if !over {
                // At a pose, half of each segment's acceleration is the mean of both.
                acceleration[axis] = direction * profile.acceleration(t)
                    + next.map_or(0.0, |next| next.direction(axis) * next.profiles[axis].acceleration(0.0));
            }
        }
        let state = state.accelerating(acceleration);
        let progress = if last {
            Progress { segment: progress.segment + 1, macrostep: 0 }
        } else {
            Progress { macrostep, ..*progress }
        };
        Ok(Next::command(self.space.setpoint(state), progress))
    }
}
