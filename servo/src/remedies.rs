//! Checks for a person after a stop: one phrase per cause, for the fault line of a report.

use crate::search::HomingFailure;
use crate::{LawFault, StopCause};

const DEFECT: &str = "report this as a defect of the program";

impl StopCause {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Self::Drive(fault) => return fault.remedy(),
            Self::FollowingError { .. } => "look for a collision, a blocked brake, a high load or missing answers",
            Self::Frozen { .. } => "check encoder, its cable and brake, then home",
            Self::Runaway { .. } => "check encoder, sign of the axis and motor phases",
            Self::Oscillates(_) => "check gains and load of the axis",
            Self::NotBraking { .. } => "check load and supply of the motor, and its current limit",
            Self::LimitSwitch { .. } => "move the axis off the switch by hand, check its limits",
            Self::PositionLimit { .. } | Self::NoRoomToStop { .. } => "correct the motion",
            // A set-point without its velocity stops the motor there.
            Self::VelocityLimit { .. } | Self::AccelerationLimit { .. } => "check velocities of the set-points",
            Self::NotFinite | Self::LawDisplacement { .. } | Self::LawSpeed { .. } => "correct generator or law",
            Self::Malformed { .. }
            | Self::UnequalSteps { .. }
            | Self::OutOfSequence { .. }
            | Self::NotAMember { .. }
            | Self::LawLeft { .. }
            | Self::NoLaw { .. } => DEFECT,
            Self::Partner { .. } => "see the fault of that robot",
            Self::BrakeSlips { .. } => "support the arm, check the brake",
            Self::Touched => "see what the tool touches",
            Self::Law(fault) => return fault.remedy(),
            Self::NotHomed => "home the robot first",
            Self::NotReady { .. } => "check motor supply, enable input and brake",
            Self::Starved { .. } => "check the host with `mrroc doctor`",
            Self::HomingFailed => "check home switch, index and homing parameters",
            Self::NoReference(failure) => return failure.remedy(),
            Self::EmergencyStop { .. } => "release the emergency stop, then reset",
            Self::Overrun { .. } | Self::Overloaded { .. } => "check the host with `mrroc doctor`",
        })
    }
}

impl HomingFailure {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Self::NoSwitch { .. } | Self::SwitchNotLeft { .. } => "check home switch and its wiring",
            Self::SwitchPassed => return None,
            Self::NoIndex { .. } => "check the index of the encoder",
            Self::TimedOut { .. } => "check brake, switches and homing speed",
            Self::LimitSwitch { .. } => "check home switch and direction of homing",
        })
    }
}

impl LawFault {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Self::Silent { .. } => "check cable and rate of the sensor",
            Self::Saturated { .. } => "unload the sensor, approach slower",
            Self::NotFinite | Self::Parameter { .. } => "correct generator or law",
            Self::Exceeded { .. } => "free the tool, approach slower",
            Self::Sensor(fault) => return fault.remedy(),
            Self::Panicked => "see the message of the panic, correct the law",
            Self::NotZeroed | Self::NoWeight { .. } => return None,
            Self::Unreachable => "move the task to another place",
        })
    }
}
