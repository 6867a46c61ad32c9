//! Motions that joints slowed.

use std::fmt;

use controller::generator::SlowedPart;
use serde::Serialize;

use crate::cell::CellFile;

/// Largest number of slowed motions that a report lists.
pub(crate) const MOST: usize = 100;

/// A motion of a robot that joints slowed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlowedMotion {
    pub robot: usize,
    /// Time of its end, from the first cycle, s.
    pub time_s: f64,
    pub part: SlowedPart,
}

/// One motion of which a part was slower than the limits of the tool permit, because of the limits of a joint.
#[derive(Debug, Serialize)]
pub struct SlowedReport {
    /// The joint that determined the motion most, by the name of its axis.
    axis: String,
    /// Begin of the part, from 0 at the start of the path to 1 at its end.
    from: f64,
    /// End of the part.
    to: f64,
    /// The limit of the joint: velocity or acceleration.
    limit: String,
    /// How many times slower the motion had to be for this limit.
    times: f64,
    /// Time of the end of the motion, from the first cycle, s.
    time_s: f64,
}

impl SlowedReport {
    pub(crate) fn of(file: &CellFile, motion: &SlowedMotion) -> Self {
        let SlowedMotion { robot, time_s, part: SlowedPart { from, to, joint, limit, times } } = *motion;
        let axis = file.axis_name(robot, usize::from(joint));
        Self { axis, from, to, limit: limit.to_string(), times, time_s }
    }
}

impl fmt::Display for SlowedReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, from, to, limit, times, time_s } = self;
        write!(
            f,
            "the motion that ended at {time_s:.3} s, from {from:.3} to {to:.3} of its path: {limit} of axis {axis}"
        )?;
        write!(f, ", {times:.2} times slower than by the limits of the tool")
    }
}
