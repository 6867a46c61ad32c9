//! What a person checks next after a fault: one phrase per fault, for the line of a report.
//!
//! A phrase does not repeat the message of its fault. Faults whose message already says what to do have none.

use can::PortError;

use crate::Fault;
use crate::axis_controller::AxisControllerFault;
use crate::cia401::IoFault;
use crate::device::DeviceFault;
use crate::ultrasonic::UltrasonicFault;
use crate::wrench::WrenchFault;

const OVERLOAD: &str = "look for an obstacle, a closed brake or a high load";
const BUS_CABLE: &str = "check cable, terminators and bit rate of the bus";
const NODE_SUPPLY: &str = "check supply and bus cable of the node";
const HOST_LATE: &str = "check the host with `mrroc doctor`";
const BUS_TAKES: &str = "check that a node acknowledges, and the load of the bus";
const ONE_CONTROLLER: &str = "end the other controller";

impl Fault {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Self::Drive { code, .. } => of_class(*code),
            Self::Silent { .. } | Self::HeartbeatLost { .. } => NODE_SUPPLY,
            Self::Late { .. } => "check adapter, gateway, load of bus and host",
            Self::NotSent { .. } => BUS_TAKES,
            Self::NotAcknowledged { .. } => "check plug and bit rate of the bus, and the supply of its nodes",
            Self::HostLate { .. } => HOST_LATE,
            Self::HeartbeatNotSent { .. } => BUS_TAKES,
            Self::LeftOperational { .. } => "check the supply of the node and other masters, then reset and home",
            Self::NotBack { error } if error.object().is_some() => "compare the object with the cell file",
            Self::NotBack { .. } => "check supply and bus cable of the node, then reset again",
            Self::PowerLost { .. } => "check motor supply and enable input",
            Self::Implausible { .. } => "home again",
            Self::NoSearch { .. } => "check homing of the drive, and start_timeout_ms",
            Self::NotAtZero { .. } => "check home offset of the drive, then home again",
            Self::ModeChanged { .. } => "look for another master",
            Self::Stuck { .. } => "check motor supply and brake",
            Self::Aborted { .. } => "read the object with `mrroc sdo`",
            Self::Refused { refusal: _, .. } => "report this as a defect of the program",
            Self::AxisController { fault, .. } => return fault.remedy(),
            Self::OtherController { .. } => ONE_CONTROLLER,
            Self::Port(error) => of_port(*error),
            Self::BusOff => BUS_CABLE,
        })
    }
}

/// What to check after an error of a drive (EMCY and object 0x603F), by the class of its code (CiA 301 §7.2.7.1).
const fn of_class(code: u16) -> &'static str {
    match code {
        0x0000..=0x00FF => "read 0x1001 and 0x1003 with `mrroc sdo`",
        // Short circuits, leakages to earth, and output stages that protect themselves against them.
        0x2130 | 0x2230 | 0x2240 | 0x2320 | 0x2330 | 0x2340 => "check motor cable and motor",
        0x2000..=0x2FFF => "look for an obstacle, check load, brake, gains and motor cable",
        0x3000..=0x3FFF => "check the supply voltage",
        0x4000..=0x4FFF => "let it cool, check load and cooling",
        0x7121 => OVERLOAD,
        0x7300..=0x73FF => "check encoder and encoder cable",
        0x7000..=0x7FFF => "check motor, brake and encoder",
        0x8100..=0x81FF => BUS_CABLE,
        0x8200..=0x82FF => "check the PDOs, and the host with `mrroc doctor`",
        0x8A80 | 0x8A81 => "move the axis off the switch, check switch and wiring",
        0x8A82 => "correct the motion, or the position limits of the drive",
        0x8A88..=0x8A8B => "check the STO circuit of the drive",
        // Codes of maxon: system overloaded, system peak overloaded.
        0x8300..=0x8FFF | 0xFF01 | 0xFF0B => OVERLOAD,
        _ => "see the manual of the drive",
    }
}

const fn of_port(error: PortError) -> &'static str {
    match error {
        PortError::Down => "set the interface up and start again",
        PortError::Gone => "plug the adapter in and start again",
        PortError::Os(_) => "see the kernel's log (dmesg)",
    }
}

impl AxisControllerFault {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Self::Silent { .. }
            | Self::Delayed { .. }
            | Self::Repeated { .. }
            | Self::Old { .. }
            | Self::Reversed { .. }
            | Self::Garbled { .. }
            | Self::OtherDrive { .. }
            | Self::Swapped { .. }
            | Self::Late { .. }
            | Self::Line(_)
            | Self::Jumped { .. }
            | Self::Restarted
            | Self::KeepsReference { .. }
            | Self::NotIndexed { .. }
            | Self::PowerStage
            | Self::Cabinet { .. } => return None,
            Self::NotSent { .. } => "check the cable, and the host with `mrroc doctor`",
            Self::Frozen { .. } => "check encoder cable and brake, restart the drive",
            Self::Overcurrent => "look for an obstacle, check load, brake, gains and motor cable",
            Self::Error => "see what the drive displays, then reset it",
            Self::Refused(_) => "report this as a defect of the program",
        })
    }
}

impl IoFault {
    /// What to check next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NotStarted { .. } | Self::Ended { .. } => "see why its bus was not brought up or ended",
            Self::InputsSilent { .. } | Self::HeartbeatLost { .. } => NODE_SUPPLY,
            Self::LeftOperational { .. } => "check the supply of the node, and other masters on the bus",
            Self::NotBack { .. } => "check supply and bus cable of the node, then reset again",
            Self::NotConfigured { .. } => "read the object with `mrroc sdo`",
            Self::OutputsNotSent { .. } | Self::HeartbeatNotSent { .. } => BUS_TAKES,
            Self::OtherController { .. } => ONE_CONTROLLER,
            Self::Port(error) => of_port(*error),
            Self::BusOff => BUS_CABLE,
        }
    }
}

impl WrenchFault {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Self::Silent { .. }
            | Self::Garbage { .. }
            | Self::Missing { .. }
            | Self::Incomplete { .. }
            | Self::Saturated { .. }
            | Self::StillSaturated { .. }
            | Self::OfAnotherRate { .. }
            | Self::Status { .. }
            | Self::Line(_)
            | Self::LeftOperational => return None,
            Self::NotStarted | Self::Ended => "see why its line or bus was not brought up or ended",
            Self::HeartbeatLost { .. } => "check supply and bus cable of the sensor",
            Self::HeartbeatNotSent { .. } => BUS_TAKES,
            Self::OtherController { .. } => ONE_CONTROLLER,
            Self::Port(error) => of_port(*error),
            Self::BusOff => BUS_CABLE,
        })
    }
}

impl UltrasonicFault {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        match self {
            Self::NotStarted | Self::Ended => Some("see why its line was not opened or ended"),
            Self::Silent { .. } | Self::Garbage { .. } | Self::Refused { .. } | Self::Line(_) => None,
        }
    }
}

impl DeviceFault {
    /// What to check next. `None` if the message says it.
    pub fn remedy(&self) -> Option<&'static str> {
        match self {
            Self::NotStarted | Self::Ended => Some("see why its line was not opened or ended"),
            Self::Silent { .. } | Self::Garbage { .. } | Self::Refused { .. } | Self::Line(_) => None,
        }
    }
}
