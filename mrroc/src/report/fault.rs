//! A fault in a report: one record for programs, one line for a person.
//!
//! The line says where, what happened, what to check next, when, and which robots stopped in which category:
//!
//! `irb6: axis column: node 3: drive fault 0x2310 (over-current): look for an obstacle, check load, brake, gains and
//! motor cable [3.482 s, cycle 1741; category 1: irb6]`
//!
//! `remedies.rs` of the servo and of the drives have the phrases on what to check.

use std::fmt;
use std::num::NonZeroU64;

use controller::ecp::{ChartPhase, Class};
use controller::executor::InstructionError;
use serde::Serialize;
use servo::StopCategory;

use super::{LastCycles, Tracks};
use crate::cell::CellFile;

/// One fault, or an error that did not end the task.
#[derive(Debug, PartialEq, Serialize)]
pub struct FaultReport {
    /// The robot; absent if it is not of one.
    pub robot: Option<String>,
    /// The axis, as in [`AxisReport::name`](super::AxisReport::name); absent if it is not of one.
    pub axis: Option<String>,
    /// What happened.
    pub what: String,
    /// What to check next; null if `what` says it.
    pub check: Option<&'static str>,
    /// Category of the stop (IEC 60204-1), 0 to 2; null without a stop by the servo.
    pub stop_category: Option<StopCategory>,
    /// Robots that began to stop in the cycle of the fault; empty without a stop by the servo.
    pub stopped: Vec<String>,
    /// Time of the fault since the first cycle, s; null before the first cycle, and if the time is not known.
    pub time_s: Option<f64>,
    /// Number of the servo cycle of the fault, from 0; null if the cycle is not known.
    #[serde(rename = "cycle")]
    pub number: Option<u64>,
    /// Place in the task, for an error of an instruction.
    #[serde(flatten)]
    pub place: Option<ErrorPlace>,
    /// The axes of the robot in the last cycles up to a fault of the servo; absent if the records of these cycles were
    /// lost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_cycles: Option<LastCycles>,
    /// The robot with a fault of the servo, and the number of a cycle in which the fault was latched.
    #[serde(skip)]
    pub(crate) latched: Option<(usize, u64)>,
}

/// Place of an error in a task, and its class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ErrorPlace {
    /// Class of the error.
    pub class: Class,
    /// Number of earlier instructions of the robot in the task.
    pub instruction: usize,
    /// Number of macrosteps of the motion before the error; null outside a motion.
    pub step: Option<u64>,
    /// Phase of the flow chart of the motion; null outside a motion.
    pub phase: Option<ChartPhase>,
    /// Number of the macrostep in which the servo stopped the robot, counted from the start of the run; absent for other
    /// errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub macrostep: Option<NonZeroU64>,
}

impl ErrorPlace {
    pub(crate) fn of(error: &InstructionError) -> Self {
        let &InstructionError { instruction, step, phase, macrostep, .. } = error;
        Self { class: error.class(), instruction, step, phase, macrostep }
    }
}

impl FaultReport {
    /// A fault of robot `robot`, or of one of its axes.
    pub(crate) fn of_robot(file: &CellFile, robot: usize, axis: Option<usize>, what: String) -> Self {
        Self {
            robot: Some(file.cell.robot[robot].name.clone()),
            axis: axis.map(|axis| file.axis_name(robot, axis)),
            ..Self::of_run(what)
        }
    }

    /// A fault of the run itself.
    pub fn of_run(what: impl fmt::Display) -> Self {
        Self {
            robot: None,
            axis: None,
            what: format!("{what:#}"),
            check: None,
            stop_category: None,
            stopped: Vec::new(),
            time_s: None,
            number: None,
            place: None,
            last_cycles: None,
            latched: None,
        }
    }

    /// This fault with a phrase on what to check next.
    pub(crate) fn checked_by(self, check: impl Into<Option<&'static str>>) -> Self {
        Self { check: check.into(), ..self }
    }

    /// Adds what the records of the servo have of the fault: its cycle, the last cycles before, and the robots that
    /// stopped.
    pub(crate) fn add_cycles(&mut self, tracks: &Tracks) {
        let Some((robot, cycle)) = self.latched else {
            return;
        };
        self.last_cycles = tracks.up_to_fault(robot, cycle);
        if let Some(fault) = self.last_cycles.as_ref().and_then(|last| last.cycles.last()) {
            (self.number, self.time_s) = (Some(fault.cycle), Some(fault.time_s));
            self.stopped = tracks.stopped_in(fault.cycle);
        }
        let own = self.robot.iter().filter(|robot| self.stop_category.is_some() && !self.stopped.contains(robot));
        self.stopped.extend(own.cloned().collect::<Vec<_>>());
    }

    /// Whether `other` is the same fault, perhaps without its place.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        (&self.robot, &self.axis, &self.what) == (&other.robot, &other.axis, &other.what)
    }
}

impl fmt::Display for FaultReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(robot) = &self.robot {
            write!(f, "{robot}: ")?;
        }
        if let Some(axis) = &self.axis {
            write!(f, "axis {axis}: ")?;
        }
        f.write_str(&self.what)?;
        if let Some(check) = self.check {
            write!(f, ": {check}")?;
        }
        let time = self.time_s.map(|time| format!("{time:.3} s"));
        let cycle = self.number.map(|number| format!("cycle {number}"));
        let when = [time, cycle].into_iter().flatten().collect::<Vec<_>>().join(", ");
        let done = self.stop_category.map(u8::from).map(|category| match &self.stopped[..] {
            [] => format!("category {category}"),
            stopped => format!("category {category}: {}", stopped.join(", ")),
        });
        let noted: Vec<_> = Some(when).filter(|when| !when.is_empty()).into_iter().chain(done).collect();
        if !noted.is_empty() {
            write!(f, " [{}]", noted.join("; "))?;
        }
        Ok(())
    }
}
