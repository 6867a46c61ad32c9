//! Errors of tasks.

use controller::coordination::carry::CarryError;
use controller::coordination::{CoordinatorError, LinkError};
use controller::ecp::{Class, ReplaceRefused};
use controller::executor::{InstructionError, SystemError};
use controller::generator::GeneratorError;
use controller::path::PathError;
use controller::robot::KinematicsError;
use controller::sensor::{EchoError, ForceError, OperatorError, SensorRefused, SightError};
use thiserror::Error;

use super::device::DeviceReadError;
use crate::cell::FileError;

/// Result of a task and of each of its instructions.
pub type Outcome = Result<(), TaskError>;

/// Errors that a task receives or returns.
#[derive(Debug, Error)]
pub enum TaskError {
    /// An instruction of a robot failed.
    #[error("robot {robot}: instruction {}: {error}", .error.instruction + 1)]
    Instruction {
        /// Name of the robot.
        robot: Box<str>,
        /// Place and cause of the error.
        error: InstructionError,
    },
    /// The coordinator of a team failed, and all its members were stopped.
    #[error("coordinator of a team: {0}")]
    Coordinator(CoordinatorError),
    /// An error that stops all robots. A task does not receive such an error.
    #[error("{0}")]
    System(SystemError),
    /// The cell has no robot of this name.
    #[error("the cell has no robot {name:?}, only {known}")]
    UnknownRobot {
        /// The requested name.
        name: String,
        /// The names of all robots.
        known: String,
    },
    /// The cell has no digital input of this name.
    #[error("the cell has no digital input {name:?}")]
    UnknownInput {
        /// The requested name.
        name: String,
    },
    /// The cell has no digital output of this name.
    #[error("the cell has no digital output {name:?}")]
    UnknownOutput {
        /// The requested name.
        name: String,
    },
    /// The cell has no force sensor of this name.
    #[error("the cell has no force sensor {name:?}: add it as [[force_sensor]]")]
    UnknownForceSensor {
        /// The requested name.
        name: String,
    },
    /// A force sensor has no reading or cannot be zeroed.
    #[error("force sensor {name}: {error}")]
    ForceSensor {
        /// Name of the sensor.
        name: Box<str>,
        /// The reason.
        error: ForceError,
    },
    /// The cell has no ultrasonic matrix of this name.
    #[error("the cell has no ultrasonic matrix {name:?}: add it as [[ultrasonic]]")]
    UnknownUltrasonic {
        /// The requested name.
        name: String,
    },
    /// An ultrasonic matrix gives no place of a box.
    #[error("ultrasonic matrix {name}: {error}")]
    Ultrasonic {
        /// Name of the matrix.
        name: Box<str>,
        /// The reason.
        error: EchoError,
    },
    /// The cell has no device of this name.
    #[error("the cell has no device {name:?}, it has: {known}; add the device as [[device]]")]
    UnknownDevice {
        /// The requested name.
        name: String,
        /// The names of all devices.
        known: String,
    },
    /// A device of another crate gives no reading.
    #[error("device {name}: {error}")]
    Device {
        /// Name of the device.
        name: Box<str>,
        /// The reason.
        error: Box<DeviceReadError>,
    },
    /// The cell has no camera of this name.
    #[error("the cell has no camera {name:?}: add it as [[camera]]")]
    UnknownCamera {
        /// The requested name.
        name: String,
    },
    /// A camera gives no place of an object.
    #[error("camera {name}: {error}")]
    Camera {
        /// Name of the camera.
        name: Box<str>,
        /// The reason.
        error: SightError,
    },
    /// The robot already has a handle.
    #[error("robot {name:?} is in use: a robot has one handle at a time")]
    RobotInUse {
        /// Name of the robot.
        name: String,
    },
    /// The table `task` of the cell file has other keys or values than the task reads.
    #[error("{0}")]
    Parameters(FileError),
    /// The task ended its rehearsal.
    #[error("not rehearsed from here: {why}")]
    NotRehearsed {
        /// The reason, as the task gave it.
        why: &'static str,
    },
    /// The task asked a question, and the run has no operator.
    #[error("the task asks the operator {question:?}: run the task with --operator")]
    NoOperator {
        /// Text of the question.
        question: String,
    },
    /// The operator did not answer a question.
    #[error("question {question:?}: {error}")]
    Unanswered {
        /// Text of the question.
        question: String,
        /// The reason.
        error: OperatorError,
    },
    /// The answer for rehearsals is not a choice of its question.
    #[error("question {question:?}: the answer {answer:?} for rehearsals is none of its choices, {choices}")]
    RehearsedAnswer {
        /// Text of the question.
        question: String,
        /// The answer.
        answer: String,
        /// The choices.
        choices: String,
    },
    /// Any other refusal: by the library of a motion that cannot be planned, or by the task itself.
    #[error("{0:#}")]
    Refused(anyhow::Error),
}

impl TaskError {
    /// Class of the error. After an error of the class non-fatal, the robots take further instructions.
    pub fn class(&self) -> Class {
        match self {
            Self::Instruction { error, .. } => error.class(),
            Self::System(_) => Class::System,
            Self::Coordinator(_)
            | Self::UnknownRobot { .. }
            | Self::UnknownInput { .. }
            | Self::UnknownOutput { .. }
            | Self::UnknownForceSensor { .. }
            | Self::ForceSensor { .. }
            | Self::UnknownUltrasonic { .. }
            | Self::Ultrasonic { .. }
            | Self::UnknownDevice { .. }
            | Self::Device { .. }
            | Self::UnknownCamera { .. }
            | Self::Camera { .. }
            | Self::RobotInUse { .. }
            | Self::Parameters(_)
            | Self::NotRehearsed { .. }
            | Self::NoOperator { .. }
            | Self::Unanswered { .. }
            | Self::RehearsedAnswer { .. }
            | Self::Refused(_) => Class::NonFatal,
        }
    }

    /// Place and cause of the error of an instruction.
    pub fn instruction(&self) -> Option<&InstructionError> {
        match self {
            Self::Instruction { error, .. } | Self::System(SystemError::Instruction(error)) => Some(error),
            _ => None,
        }
    }
}

impl From<anyhow::Error> for TaskError {
    fn from(error: anyhow::Error) -> Self {
        Self::Refused(error)
    }
}

impl From<GeneratorError> for TaskError {
    fn from(error: GeneratorError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<KinematicsError> for TaskError {
    fn from(error: KinematicsError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<CarryError> for TaskError {
    fn from(error: CarryError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<PathError> for TaskError {
    fn from(error: PathError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<LinkError> for TaskError {
    fn from(error: LinkError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<ReplaceRefused> for TaskError {
    fn from(error: ReplaceRefused) -> Self {
        Self::Refused(error.into())
    }
}

impl From<SensorRefused> for TaskError {
    fn from(error: SensorRefused) -> Self {
        Self::Refused(error.into())
    }
}
