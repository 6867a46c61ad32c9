//! Rows of the fault table, and their judgement.

use std::time::Duration;

use mrroc::cell::CellFile;
use servo::MAX_AXES;

use super::catalogue::{Expected, FaultCase};
use super::detector::Detector;
use super::phase::FaultPhase;
use super::stage::{Observation, Played, Recovery};

/// One row.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the fault.
    pub fault: &'static str,
    /// Name of the robot.
    pub robot: String,
    /// The phase.
    pub phase: FaultPhase,
    /// What happened; `None` where the phase has no meaning.
    pub result: Option<RowResult>,
    /// Why the row is red, or why the phase has no meaning. A row with a result and without reasons is good.
    pub reasons: Vec<String>,
}

/// What happened in a row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowResult {
    /// The detector of the stop.
    pub detector: Option<Detector>,
    /// The cause of the stop in words.
    pub cause: Option<String>,
    /// Time from the fault to its detection.
    pub detection: Option<Duration>,
    /// Stop category of IEC 60204-1.
    pub category: Option<u8>,
    /// Time from the fault to standstill.
    pub still_after: Option<Duration>,
    /// Distance from the fault to standstill of the axis that comes nearest to its bound, degrees or mm of the joint.
    pub distance: f64,
    /// The bound of this distance.
    pub bound: f64,
    /// Whether the two are mm.
    pub linear: bool,
    /// How the robot was brought back.
    pub recovery: &'static str,
}

impl Row {
    pub(super) fn without_meaning(fault: &'static str, robot: &str, phase: FaultPhase, reason: &str) -> Self {
        Self { fault, robot: robot.to_owned(), phase, result: None, reasons: vec![reason.to_owned()] }
    }

    /// Whether the row is red.
    pub fn is_red(&self) -> bool {
        self.result.is_some() && !self.reasons.is_empty()
    }

    /// Whether the robot went on.
    pub fn is_tolerated(&self) -> bool {
        self.result.as_ref().is_some_and(|result| result.detection.is_none())
    }

    pub(super) fn judge(
        file: &CellFile,
        (case, expected): (&FaultCase, Expected),
        phase: FaultPhase,
        axis: usize,
        played: anyhow::Result<Played>,
        again: Option<anyhow::Result<Played>>,
    ) -> Self {
        let robot = &file.cell.robot[0];
        let row = |result, reasons| Self { fault: case.name, robot: robot.name.clone(), phase, result, reasons };
        let Played { velocity, observation: seen } = match played {
            Ok(played) => played,
            Err(error) => return row(Some(RowResult::default()), vec![format!("cannot be played: {error:#}")]),
        };
        let speeds = if phase == FaultPhase::Homing {
            std::array::from_fn(|number| robot.axis.get(number).map_or(0.0, |axis| axis.homing.search_velocity))
        } else {
            velocity
        };
        let bounds = case.bounds(file, axis, &speeds, phase, seen.detected.map(|(at, _)| at));
        let mut reasons = Vec::new();
        let mut red = |reason: &str| reasons.push(reason.to_owned());
        let detector = seen.detected.and_then(|(_, fault)| Detector::of(&fault.cause));
        match (expected, seen.detected) {
            (Expected::Tolerated, Some(_)) => red("stops, and should go on"),
            (Expected::By(_), None) => red("not detected"),
            (Expected::By(by) | Expected::Either(by), Some((at, _))) => {
                if !detector.is_some_and(|detector| by.contains(&detector)) {
                    red("found by another detector");
                }
                if at > bounds.detection {
                    red("found late");
                }
            }
            (Expected::Tolerated | Expected::Either(_), None) => {}
        }
        let (worst, ratio) = worst(&seen, &bounds.distance, robot.axis.len());
        if seen.detected.is_some() {
            if seen.still_after.is_none() {
                red("does not come to rest");
            }
            // The search goes on until its end is known to be missing.
            if ratio > 1.0 && case.observed_for < Duration::from_secs(10) {
                red("moves beyond its bound");
            }
        } else {
            if !seen.completed {
                red("the motion does not end");
            }
            let strays =
                |axis: usize| seen.strays.is_some_and(|strays| strays[axis] > 2.0 * robot.axis[axis].following_error);
            if (0..robot.axis.len()).any(strays) {
                red("strays from its set-points");
            }
        }
        if detector == Some(Detector::Brake) && seen.recovery != Recovery::Stop {
            red("is not held by its motors");
        }
        if let Recovery::Jumped(_) = seen.recovery {
            red("jumps when it is enabled again");
        }
        match again {
            Some(Ok(again)) if again.observation != seen => red("two verdicts with one seed"),
            Some(Err(_)) => red("two verdicts with one seed"),
            Some(Ok(_)) | None => {}
        }
        let (per_radian, linear) = joint_per_motor(file, worst);
        let result = RowResult {
            detector,
            cause: seen.detected.map(|(_, fault)| robot.naming_axes(fault)),
            detection: seen.detected.map(|(at, _)| at),
            category: seen.category,
            still_after: seen.still_after,
            distance: seen.distances[worst] * per_radian,
            bound: bounds.distance[worst] * per_radian,
            linear,
            recovery: match seen.recovery {
                Recovery::None => "—",
                Recovery::Stop => "stop",
                Recovery::Reset => "reset, enable",
                Recovery::Home => "reset, enable, home",
                Recovery::Restart => "restart",
                Recovery::Jumped(_) => "jumped",
            },
        };
        row(Some(result), reasons)
    }
}

/// The axis that comes nearest to its bound, and the share of the bound.
fn worst(seen: &Observation, bounds: &[f64; MAX_AXES], axes: usize) -> (usize, f64) {
    let shares = (0..axes).map(|axis| (axis, seen.distances[axis] / bounds[axis]));
    shares.max_by(|(_, one), (_, other)| one.total_cmp(other)).unwrap_or((0, 0.0))
}

/// Motion of joint `axis` per radian of its motor at home, degrees or mm, and whether it is mm.
fn joint_per_motor(file: &CellFile, axis: usize) -> (f64, bool) {
    let arm = &file.arms[0];
    let home = arm.robot().home();
    let at = |delta: f64| {
        let motors = std::array::from_fn(|number| {
            let home = if number < arm.axes() { home[number] } else { 0.0 };
            if number == axis { home + delta } else { home }
        });
        arm.joints(&motors).ok()
    };
    let (Some(low), Some(high)) = (at(-0.5), at(0.5)) else {
        return (f64::NAN, false);
    };
    let numbers = file.cell.robot[0].numbers();
    let linear = numbers.is_linear(axis);
    // A coupled motor moves several joints: the most moved one counts.
    let joints = (0..arm.axes()).filter(|joint| numbers.is_linear(*joint) == linear);
    let moved = joints.map(|joint| (high[joint] - low[joint]).abs()).fold(0.0, f64::max);
    (if linear { moved * 1e3 } else { moved.to_degrees() }, linear)
}
