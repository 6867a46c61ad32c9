//! Jerk-limited motion through poses, section by section.
//!
//! The speed of each axis at each pose follows from the limits alone, and each section between two poses is the fastest
//! motion between these speeds. If a limit rises, no speed falls and no section takes longer.

use rsruckig::prelude::{DataArrayOrVec, InputParameter};
use servo::MAX_AXES;

use super::plan::Plan;
use super::{Axes, GeneratorError, newsmooth::whole_macrosteps};

/// Greatest speed of an axis at a pose, relative to its speed in a section if all axes moved at constant speed. A faster
/// axis would only wait for the others.
const AHEAD: f64 = 1.5;

/// Sections of a motion from rest to rest.
#[derive(Debug)]
pub(super) struct Sections {
    sections: Vec<Plan<MAX_AXES>>,
    /// Ends of the sections, s.
    ends: Vec<f64>,
    /// Duration in macrosteps.
    pub(super) macrosteps: u32,
    /// Time of the sections per macrostep, s.
    step: f64,
    /// Time of the sections divided by real time; at most 1, up to rounding.
    pace: f64,
}

impl Sections {
    /// Memory for a motion through this number of poses.
    pub(super) fn new(poses: usize) -> Self {
        let sections = (0..poses).map(|_| Plan::new()).collect();
        Self { sections, ends: Vec::with_capacity(poses), macrosteps: 0, step: 0.0, pace: 1.0 }
    }

    /// Plans a motion from the first pose through the others within the limits of `input`, for the duration `given`, s,
    /// or for the shortest. The duration is then rounded up to a multiple of `macrostep`, s.
    pub(super) fn solve(
        &mut self,
        input: &InputParameter<MAX_AXES>,
        poses: &[Axes],
        given: Option<f64>,
        macrostep: f64,
    ) -> Result<(), GeneratorError> {
        let needed = self.shortest(input, poses)?;
        let given = given.unwrap_or(needed);
        if given < needed {
            return Err(GeneratorError::TooShort { needed, given });
        }
        self.macrosteps = whole_macrosteps(given, macrostep)?;
        if self.macrosteps > 0 {
            self.step = needed / f64::from(self.macrosteps);
            self.pace = self.step / macrostep;
        }
        Ok(())
    }

    /// Plans the shortest motion. Returns its duration, s.
    pub(super) fn shortest(&mut self, input: &InputParameter<MAX_AXES>, poses: &[Axes]) -> Result<f64, GeneratorError> {
        let way = Way { input, poses };
        self.ends.clear();
        let mut end = 0.0;
        for (index, section) in self.sections.iter_mut().enumerate() {
            let own = &mut section.input;
            own.current_position = DataArrayOrVec::Stack(poses[index]);
            own.current_velocity = DataArrayOrVec::Stack(way.speeds(index));
            own.target_position = DataArrayOrVec::Stack(poses[index + 1]);
            own.target_velocity = DataArrayOrVec::Stack(way.speeds(index + 1));
            own.enabled = input.enabled.clone();
            own.max_velocity = input.max_velocity.clone();
            own.max_acceleration = input.max_acceleration.clone();
            own.max_jerk = input.max_jerk.clone();
            end += section.calculate()?;
            self.ends.push(end);
        }
        Ok(end)
    }

    /// Position, velocity and acceleration after `done` macrosteps.
    pub(super) fn at(&self, done: u32) -> [Axes; 3] {
        let time = f64::from(done) * self.step;
        let section = self.ends.partition_point(|end| *end <= time).min(self.sections.len() - 1);
        let begin = if section == 0 { 0.0 } else { self.ends[section - 1] };
        let [position, velocity, acceleration] = self.sections[section].state(time - begin);
        [position, velocity.map(|value| value * self.pace), acceleration.map(|value| value * self.pace * self.pace)]
    }
}

/// Poses, with the start as the first pose, and the limits.
struct Way<'a> {
    input: &'a InputParameter<MAX_AXES>,
    poses: &'a [Axes],
}

impl Way<'_> {
    fn distance(&self, section: usize, axis: usize) -> f64 {
        if self.input.enabled[axis] { self.poses[section + 1][axis] - self.poses[section][axis] } else { 0.0 }
    }

    /// Speed of an axis in a section if all axes moved at constant speed.
    fn cruise(&self, section: usize, axis: usize) -> f64 {
        let time = |axis: usize| self.distance(section, axis).abs() / self.input.max_velocity[axis];
        self.distance(section, axis).abs() / (0..MAX_AXES).map(time).fold(0.0, f64::max)
    }

    /// Whether an axis travels in the same direction before and after a pose.
    fn passes(&self, pose: usize, axis: usize) -> bool {
        let between = pose > 0 && pose + 1 < self.poses.len();
        between && self.distance(pose - 1, axis) * self.distance(pose, axis) > 0.0
    }

    /// The part of the section before or after `pose` in which the axis can come to rest: half of it, or the whole if
    /// the axis rests at the other end. Every longer duration of the section is then possible.
    fn room(&self, section: usize, other: usize, axis: usize) -> f64 {
        let share = if self.passes(other, axis) { 0.5 } else { 1.0 };
        share * self.distance(section, axis).abs()
    }

    /// Velocity of each axis at a pose.
    fn speeds(&self, pose: usize) -> Axes {
        let speed = |axis: usize| {
            if !self.passes(pose, axis) {
                return 0.0;
            }
            let [acceleration, jerk] = [self.input.max_acceleration[axis], self.input.max_jerk[axis]];
            let stopped = |section, other| speed_before(self.room(section, other, axis), acceleration, jerk);
            let bounds = [
                self.input.max_velocity[axis],
                AHEAD * self.cruise(pose - 1, axis),
                AHEAD * self.cruise(pose, axis),
                stopped(pose - 1, pose - 1),
                stopped(pose, pose + 1),
            ];
            bounds.into_iter().fold(f64::INFINITY, f64::min).copysign(self.distance(pose, axis))
        };
        std::array::from_fn(speed)
    }
}

/// The speed from which an axis stops within a distance.
fn speed_before(distance: f64, acceleration: f64, jerk: f64) -> f64 {
    let without_limit = (distance * distance * jerk).cbrt();
    let rise = acceleration / jerk;
    if without_limit <= acceleration * rise {
        return without_limit;
    }
    acceleration / 2.0 * ((rise * rise + 8.0 * distance / acceleration).sqrt() - rise)
}
