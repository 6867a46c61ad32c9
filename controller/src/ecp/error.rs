//! Errors of instructions.

use std::time::Duration;

use servo::{Phase, ServoFault};
use thiserror::Error;

use crate::generator::GeneratorError;
use crate::robot::KinematicsError;

/// Why an instruction failed. The effector stands, or is faulted, by the time this is reported.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum EcpError {
    /// The servo stopped the effector.
    #[error("{0}")]
    Servo(ServoFault),
    /// The servo is faulted and does not say why.
    #[error("effector is faulted")]
    Faulted,
    /// The generator refused or gave up.
    #[error("step {step}: {error}")]
    Generator {
        /// Macrosteps sent for this instruction before.
        step: u64,
        /// Its reason.
        error: GeneratorError,
    },
    /// The generator asked for a state that the arm cannot take.
    #[error("step {step}: {error}")]
    OutOfReach {
        /// Macrosteps sent for this instruction before.
        step: u64,
        /// Which axis, and why.
        error: KinematicsError,
    },
    /// The generator asked for NaN or infinity.
    #[error("step {step}, axis {axis}: set-point is not a finite number")]
    NotFinite {
        /// Macrosteps sent for this instruction before.
        step: u64,
        /// Index of the axis.
        axis: u8,
    },
    /// A motion was asked of an effector that does not stand with its drives on.
    #[error("effector is {phase:?}, a motion begins from Standing")]
    NotStanding {
        /// What it does.
        phase: Phase,
    },
    /// A motion was asked of an effector that is not homed.
    #[error("effector is not homed")]
    NotHomed,
    /// The effector left the motion without a fault.
    #[error("motion broke off, effector is {phase:?}")]
    BrokenOff {
        /// What it does.
        phase: Phase,
    },
    /// The servo neither reported nor took an order for too long.
    #[error("servo silent for {waited:?}")]
    Silent {
        /// How long.
        waited: Duration,
    },
    /// The servo reports, but did not get where it was asked to in time.
    #[error("still {phase:?} after {waited:?}")]
    TimedOut {
        /// What the effector does.
        phase: Phase,
        /// How long.
        waited: Duration,
    },
    /// Nobody, or not everybody, came to a meeting in time.
    #[error("the partners of a meeting did not come within {waited:?}")]
    Unmet {
        /// How long it waited for them.
        waited: Duration,
    },
    /// It was told to stop.
    #[error("stopped")]
    Stopped,
}
