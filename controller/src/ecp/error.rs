//! Errors of instructions and their classes, and refusals of calls.

use std::time::Duration;

use drive::Fault;
use serde::Serialize;
use servo::{Phase, ServoFault, StopCause};
use thiserror::Error;

use crate::{coordination::LinkError, generator::GeneratorError, robot::KinematicsError};

/// Class of an error, by its consequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// The effector stands and takes further instructions. The task decides and may try again.
    NonFatal,
    /// The effector is stopped and takes no motion. Other effectors may continue.
    Fatal,
    /// All effectors are stopped.
    System,
}

/// Phase of the flow chart of a motion (figure 3 of the paper) in which an error occurred.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChartPhase {
    /// The first step of the generator.
    FirstStep,
    /// A next step of the generator.
    NextStep,
    /// The transfer of a set-point to the effector, and its execution by the servo.
    Transfer,
}

/// Reasons why an instruction failed. When an error is reported, the effector already stands or is faulted. `step`
/// counts the macrosteps of the instruction that were sent before.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum EcpError {
    /// The servo stopped the effector.
    #[error("{0}")]
    Servo(ServoFault),
    /// The servo is faulted and reports no reason.
    #[error("effector is faulted")]
    Faulted,
    /// The generator refused the motion or gave it up.
    #[error("step {step}: {error}")]
    Generator { step: u64, error: GeneratorError },
    /// The generator requested a state that the arm cannot take.
    #[error("step {step}: {error}")]
    OutOfReach { step: u64, error: KinematicsError },
    /// The generator requested NaN or infinity.
    #[error("step {step}, axis {axis}: set-point is not a finite number")]
    NotFinite { step: u64, axis: u8 },
    /// A motion was requested while the effector does not stand with its drives on.
    #[error("effector is {phase:?}, a motion begins from Standing: call enable() before")]
    NotStanding { phase: Phase },
    /// A motion was requested while the effector is not homed.
    #[error("effector is not homed: call home() before")]
    NotHomed,
    /// The effector ended the motion early, without a fault.
    #[error("motion broke off, effector is {phase:?}")]
    BrokenOff { phase: Phase },
    /// For too long, the servo neither reported nor took an order.
    #[error("servo silent for {waited:?}")]
    Silent { waited: Duration },
    /// The servo reports, but did not complete the request in time.
    #[error("still {phase:?} after {waited:?}")]
    TimedOut { phase: Phase, waited: Duration },
    /// The first step of a generator takes too long.
    #[error("the first step of the generator takes longer than {waited:?}")]
    Unplanned { waited: Duration },
    /// At least one partner did not come to a meeting or a tie in time, or a partner of the team sent no macrostep.
    #[error("the partners of a meeting did not come within {waited:?}")]
    Unmet { waited: Duration },
    /// The link to the coordinator failed.
    #[error("step {step}: {error}")]
    Link { step: u64, error: LinkError },
    /// A virtual sensor gave no reading in time.
    #[error("step {step}: no reading of a sensor within {waited:?}")]
    Unread { step: u64, waited: Duration },
    /// The process was told to stop.
    #[error("stopped")]
    Stopped,
}

impl EcpError {
    /// Class of the error. A fault that concerns the cycle or the bus as a whole is a system error. An effector that
    /// was stopped with a partner of its team, or by its cycle law at a touch, stands and takes further instructions.
    pub fn class(&self) -> Class {
        match self {
            Self::Servo(ServoFault {
                cause:
                    StopCause::Overrun { .. }
                    | StopCause::Overloaded { .. }
                    | StopCause::Drive(Fault::OtherController { .. }),
                ..
            }) => Class::System,
            Self::Servo(ServoFault {
                cause: StopCause::Partner { .. } | StopCause::Touched | StopCause::BrakeSlips { .. },
                ..
            }) => Class::NonFatal,
            Self::Servo(_) | Self::Faulted | Self::BrokenOff { .. } | Self::Silent { .. } | Self::TimedOut { .. } => {
                Class::Fatal
            }
            Self::Generator { .. }
            | Self::OutOfReach { .. }
            | Self::NotFinite { .. }
            | Self::NotStanding { .. }
            | Self::NotHomed
            | Self::Unplanned { .. }
            | Self::Unmet { .. }
            | Self::Link { .. }
            | Self::Unread { .. }
            | Self::Stopped => Class::NonFatal,
        }
    }
}

/// A task was passed to an ECP that still executes another task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("instruction {instruction} is under way")]
pub struct Busy {
    /// Index of the current instruction in its task.
    pub instruction: usize,
}

/// Reasons why a generator is not replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ReplaceRefused {
    /// No generator computes macrosteps: there is no motion, the first step is still in computation, or the motion is
    /// ending.
    #[error("no generator runs that could be replaced")]
    NotRunning,
    /// The motion belongs to a team under a coordinator.
    #[error("the robot moves in a team: only the team's coordinator ends its motion, and the task gives the next one")]
    InTeam,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_refusal_says_what_is_missing_and_what_to_call() {
        let waited = Duration::from_millis(1500);
        for (error, text, class) in [
            (EcpError::Faulted, "effector is faulted", Class::Fatal),
            (
                EcpError::Generator { step: 3, error: GeneratorError::NotFinite { pose: 0, axis: 1 } },
                "step 3: pose 0, axis 1: not a finite number",
                Class::NonFatal,
            ),
            (
                EcpError::OutOfReach { step: 3, error: KinematicsError::NotFinite },
                "step 3: a number is not finite",
                Class::NonFatal,
            ),
            (
                EcpError::NotFinite { step: 3, axis: 1 },
                "step 3, axis 1: set-point is not a finite number",
                Class::NonFatal,
            ),
            (
                EcpError::NotStanding { phase: Phase::Off },
                "effector is Off, a motion begins from Standing: call enable() before",
                Class::NonFatal,
            ),
            (EcpError::NotHomed, "effector is not homed: call home() before", Class::NonFatal),
            (EcpError::BrokenOff { phase: Phase::Stopping }, "motion broke off, effector is Stopping", Class::Fatal),
            (EcpError::Silent { waited }, "servo silent for 1.5s", Class::Fatal),
            (EcpError::TimedOut { phase: Phase::Homing, waited }, "still Homing after 1.5s", Class::Fatal),
            (EcpError::Unplanned { waited }, "the first step of the generator takes longer than 1.5s", Class::NonFatal),
            (EcpError::Unmet { waited }, "the partners of a meeting did not come within 1.5s", Class::NonFatal),
            (EcpError::Unread { step: 3, waited }, "step 3: no reading of a sensor within 1.5s", Class::NonFatal),
            (EcpError::Stopped, "stopped", Class::NonFatal),
        ] {
            assert_eq!((error.to_string().as_str(), error.class()), (text, class));
        }
    }
}
