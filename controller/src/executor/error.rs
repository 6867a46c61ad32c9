//! Errors of instructions with their place, and errors that end a task.

use std::num::NonZeroU64;
use std::time::Duration;

use thiserror::Error;

use crate::ecp::{ChartPhase, Class, Ecp, EcpError};

/// An instruction failed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{cause}")]
pub struct InstructionError {
    /// Index of the robot in its cell.
    pub robot: usize,
    /// Index of the instruction in the sequence of all instructions of this robot in the task, from 0. Each instruction
    /// of a list counts. Instructions dropped after an error do not count.
    pub instruction: usize,
    /// Number of macrosteps of the motion before the error; `None` outside a motion, and if the fault occurred in a
    /// macrostep of the previous motion.
    pub step: Option<u64>,
    /// Phase of the flow chart; `None` outside a motion.
    pub phase: Option<ChartPhase>,
    /// Number of the macrostep in which the servo stopped the robot, counted from the start of the run. `None` if the servo
    /// did not stop the robot, or before the first macrostep. The macrostep may belong to the previous motion: the
    /// controller computes macrosteps ahead of the servo.
    pub macrostep: Option<NonZeroU64>,
    /// Number of the last servo cycle when the instruction ended.
    pub cycle: u64,
    /// Cause of the error.
    pub cause: EcpError,
}

/// An error of an instruction that did not end the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotedError {
    /// The error.
    pub error: InstructionError,
    /// Whether the task received the error. A task does not receive errors of instructions that it dropped.
    pub received: bool,
    /// Whether the robot has been in [`Phase::Faulted`](servo::Phase::Faulted) ever since the error.
    pub latched: bool,
}

impl InstructionError {
    /// The error of the last instruction of `ecp`.
    pub(super) fn of(robot: usize, instruction: usize, ecp: &Ecp, cause: EcpError) -> Self {
        let chart = ecp.chart();
        let (step, phase) = match cause {
            EcpError::Generator { step, .. } => (Some(step), chart.map(|(phase, _)| phase)),
            EcpError::Unplanned { .. } => (Some(0), Some(ChartPhase::FirstStep)),
            EcpError::Link { step, .. } | EcpError::Unread { step, .. } => (Some(step), chart.map(|(phase, _)| phase)),
            EcpError::OutOfReach { step, .. } | EcpError::NotFinite { step, .. } => {
                (Some(step), Some(ChartPhase::Transfer))
            }
            _ => (chart.and_then(|(_, step)| step), chart.map(|_| ChartPhase::Transfer)),
        };
        let by_servo = matches!(cause, EcpError::Servo(_));
        let macrostep = ecp.fault_macrostep().filter(|_| by_servo);
        Self { robot, instruction, step, phase, macrostep, cycle: ecp.latest().cycle, cause }
    }

    /// Class of the error.
    pub fn class(&self) -> Class {
        self.cause.class()
    }
}

/// Errors of the class system. They end the task, and all effectors brake.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SystemError {
    /// The task awaits a future of another library. Neither an instruction nor the time of the cycles can complete this
    /// future.
    #[error("the task awaits a future that is not of this library")]
    ForeignFuture,
    /// The panic hook received the message.
    #[error("the task panicked")]
    Panicked,
    /// The task blocks, or computes without an await.
    #[error("the task did not return from its turn within {limit:?}: a task must await, and must not block")]
    Hung {
        /// Limit of one turn.
        limit: Duration,
    },
    /// A generator blocks in a step.
    #[error("a generator did not return from a step within {limit:?}: a step must not block")]
    HungInStep {
        /// Limit of one step.
        limit: Duration,
    },
    /// An error of one effector that concerns all effectors.
    #[error("{0}")]
    Instruction(InstructionError),
    /// The rehearsal of the task from the present position of a robot failed.
    #[error("the task was refused from the present position of robot {robot}")]
    RefusedFromHere {
        /// Index of the robot in its cell.
        robot: usize,
    },
}
