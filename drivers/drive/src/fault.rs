//! Faults of an axis, and errors of bring-up.

use std::fmt;
use std::time::Duration;

use canopen::cia402::{FaultTable, ModeOfOperation};
use canopen::sdo::AbortCode;
use thiserror::Error;

use crate::axis_controller::{AxisControllerError, AxisControllerFault};
use crate::cia402::Sign;

/// A latched condition of one axis, cleared by [`AxisCommand::ResetFault`](crate::AxisCommand::ResetFault).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Fault {
    /// The drive reported a fault (EMCY and object 0x603F of CiA 402).
    #[error("node {node}: drive fault {code:#06x} ({text})", text = FaultTable::Epos4.text(*.code))]
    Drive {
        /// Node-ID.
        node: u8,
        /// Error code of CiA 402 or of the vendor.
        code: u16,
    },
    /// Answers were missing for more cycles than the cell allows.
    #[error("node {node}: no answer for {cycles} cycles")]
    Silent {
        /// Node-ID.
        node: u8,
        /// Cycles without an answer.
        cycles: u32,
    },
    /// The port took no set-point for the node, or not even the SYNC, for more cycles than the cell
    /// allows: the drive goes on by an old one.
    #[error("node {node}: set-point not taken by the bus for {cycles} cycles")]
    NotSent {
        /// Node-ID.
        node: u8,
        /// Cycles in a row.
        cycles: u32,
    },
    /// The node's heartbeat stopped.
    #[error("node {node}: no heartbeat for {waited:.1?}")]
    HeartbeatLost {
        /// Node-ID.
        node: u8,
        /// Time since the last one.
        waited: Duration,
    },
    /// We sent no SYNC for longer than the drives wait for our heartbeat: they have stopped by themselves.
    #[error("node {node}: no SYNC was sent for {waited:.1?}")]
    HostLate {
        /// Node-ID.
        node: u8,
        /// Time since the last one.
        waited: Duration,
    },
    /// The port took no heartbeat of ours for longer than the drives wait for it: they have stopped by themselves.
    #[error("bus: the host's heartbeat was not sent for {waited:.1?}")]
    HeartbeatNotSent {
        /// Time since the last one, or since bring-up.
        waited: Duration,
    },
    /// The node booted again, or left NMT state operational, during operation.
    #[error("node {node}: left operational state")]
    LeftOperational {
        /// Node-ID.
        node: u8,
    },
    /// The drive dropped out of operation enabled without being asked and without a fault.
    #[error("node {node}: power was lost (statusword {statusword:#06x})")]
    PowerLost {
        /// Node-ID.
        node: u8,
        /// Object 0x6041.
        statusword: u16,
    },
    /// The drive's position counter jumped. The position is not believed.
    #[error(
        "node {node}: position jumped by {moved} increments within {within:.1?}; the motor cannot have turned by more than \
         {most}"
    )]
    Implausible {
        /// Node-ID.
        node: u8,
        /// Increments from the last position believed.
        moved: i32,
        /// Most increments that the motor can have turned by.
        most: u32,
        /// Longest time that the motor can have had since that position.
        within: Duration,
    },
    /// The drive is in another mode of operation than it was told, by a command of somebody else.
    #[error("node {node}: mode of operation is {found}, commanded was {expected}")]
    ModeChanged {
        /// Node-ID.
        node: u8,
        /// The mode that the drive was told (object 0x6060).
        expected: ModeOfOperation,
        /// The mode that the drive shows (object 0x6061).
        found: ModeOfOperation,
    },
    /// The drive did not reach the asked state in time.
    #[error(
        "node {node}: did not reach the asked state within {waited:.1?} (statusword {statusword:#06x})"
    )]
    Stuck {
        /// Node-ID.
        node: u8,
        /// Object 0x6041.
        statusword: u16,
        /// Time waited.
        waited: Duration,
    },
    /// The drive refused a service request, or did not answer it in time.
    #[error("node {node}: {index:#06x}:{subindex:02x} failed: {abort}", abort = AbortCode(*.code))]
    Aborted {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index.
        subindex: u8,
        /// SDO abort code; 0x0504_0000 if the drive did not answer.
        code: u32,
    },
    /// A set-point that was not sent, nor any other of its cycle.
    #[error("node {node}: set-point {refusal}")]
    Refused {
        /// Node-ID.
        node: u8,
        /// Why.
        refusal: Refusal,
    },
    /// A fault of an axis controller on a serial line.
    #[error("line {line}: {fault}")]
    AxisController {
        /// Index of its axis in the group.
        line: u8,
        /// Which.
        fault: AxisControllerFault,
    },
    /// A second controller commands the drives of the bus.
    #[error("bus: another controller is at work: it sent {sign}")]
    OtherController {
        /// The frame that gave it away.
        sign: Sign,
    },
    /// The port cannot send or receive.
    #[error("bus: {0}")]
    Port(can::PortError),
    /// Our controller made too many errors and left the bus: no drive hears us.
    #[error("bus: the controller is bus-off")]
    BusOff,
}

/// What was wrong with a set-point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// Its kind is not what the drive's mode of operation follows.
    #[error("is of another kind than the drive's mode of operation follows")]
    WrongKind,
    /// The drive has no torque to follow it with.
    #[error("came while the drive was not on")]
    NotOn,
    /// The drive's units cannot hold it.
    #[error("does not fit the drive's units")]
    OutOfRange,
}

/// Why a group could not be brought up. Nothing has moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BringUpError {
    /// No boot-up message and no answer.
    #[error("node {node}: never booted, waited {waited:.1?}")]
    NeverBooted {
        /// Node-ID.
        node: u8,
        /// Time waited.
        waited: Duration,
    },
    /// The node answers, and is no drive: its device profile is not CiA 402.
    #[error("node {node}: not a CiA 402 drive (0x1000 is {device_type:#010x})")]
    NotADrive {
        /// Node-ID.
        node: u8,
        /// Object 0x1000.
        device_type: u32,
    },
    /// The node was started and no heartbeat said that it became operational.
    #[error("node {node}: not operational, waited {waited:.1?}")]
    NotOperational {
        /// Node-ID.
        node: u8,
        /// Time waited.
        waited: Duration,
    },
    /// Object 0x1018 does not say what the cell says.
    #[error(
        "node {node}: identity 0x1018:{subindex:02x} is {found:#010x}, the cell expects {expected:#010x}"
    )]
    WrongIdentity {
        /// Node-ID.
        node: u8,
        /// Sub-index of 0x1018: 1 vendor, 2 product, 3 revision, 4 serial number.
        subindex: u8,
        /// What the cell file says.
        expected: u32,
        /// What the drive says.
        found: u32,
    },
    /// The drive scales its positions or torques otherwise than the cell.
    #[error(
        "node {node}: {index:#06x}:{subindex:02x} is {ratio} {what}, the cell says {expected}: {remedy}",
        ratio = Ratio(*.found, *.per)
    )]
    WrongScale {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index; of a ratio that of its dividend.
        subindex: u8,
        /// What the drive says; of a ratio its dividend.
        found: u32,
        /// The divisor of a ratio, else 1.
        per: u32,
        /// What the cell file says, in the drive's unit.
        expected: u32,
        /// The quantity and its unit.
        what: &'static str,
        /// What to do.
        remedy: &'static str,
    },
    /// The drive refused a parameter.
    #[error("node {node}: {index:#06x}:{subindex:02x} refused: {abort}", abort = AbortCode(*.code))]
    Aborted {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index.
        subindex: u8,
        /// SDO abort code.
        code: u32,
    },
    /// The drive took a parameter and holds another.
    #[error("node {node}: {index:#06x}:{subindex:02x} reads back {found:#x}, wrote {written:#x}")]
    ReadBack {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index.
        subindex: u8,
        /// What was written.
        written: u32,
        /// What was read back.
        found: u32,
    },
    /// The drive took bytes and holds others.
    #[error(
        "node {node}: {index:#06x}:{subindex:02x} reads back {found} bytes, wrote {written}, the first {same} are equal"
    )]
    ReadBackBytes {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index.
        subindex: u8,
        /// Bytes written.
        written: usize,
        /// Bytes read back.
        found: usize,
        /// Bytes that are equal, from the first.
        same: usize,
    },
    /// The drive did not answer a service request in time.
    #[error("node {node}: {index:#06x}:{subindex:02x} timed out after {waited:.1?}")]
    TimedOut {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index.
        subindex: u8,
        /// Time waited.
        waited: Duration,
    },
    /// The drive cannot do the asked mode of operation (object 0x6502).
    #[error("node {node}: mode {mode} is not supported (0x6502 is {supported:#010x})")]
    ModeUnsupported {
        /// Node-ID.
        node: u8,
        /// Value for object 0x6060.
        mode: i8,
        /// Object 0x6502.
        supported: u32,
    },
    /// An axis controller on a serial line.
    #[error("line {line}: {error}")]
    AxisController {
        /// Index of its axis in the group.
        line: u8,
        /// Why.
        error: AxisControllerError,
    },
    /// A second controller commands the drives of the bus.
    #[error("another controller is at work: it sent {sign}; end it before this one is started")]
    OtherController {
        /// The frame that gave it away.
        sign: Sign,
    },
    /// The port cannot send or receive.
    #[error("bus: {0}")]
    Port(#[from] can::PortError),
}

impl BringUpError {
    /// The node it is about; `None` on a serial line, whose index is [`line`](Self::line).
    pub fn node(&self) -> Option<u8> {
        match *self {
            Self::NeverBooted { node, .. }
            | Self::NotADrive { node, .. }
            | Self::NotOperational { node, .. }
            | Self::WrongIdentity { node, .. }
            | Self::WrongScale { node, .. }
            | Self::Aborted { node, .. }
            | Self::ReadBack { node, .. }
            | Self::ReadBackBytes { node, .. }
            | Self::TimedOut { node, .. }
            | Self::ModeUnsupported { node, .. } => Some(node),
            Self::AxisController { .. } | Self::OtherController { .. } | Self::Port(_) => None,
        }
    }

    /// The index in its group of the axis that it is about, on a serial line.
    pub fn line(&self) -> Option<usize> {
        match *self {
            Self::AxisController { line, .. } => Some(usize::from(line)),
            _ => None,
        }
    }
}

/// `4000`, or `8000/3`.
struct Ratio(u32, u32);

impl fmt::Display for Ratio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(dividend, divisor) = self;
        match divisor {
            1 => write!(f, "{dividend}"),
            _ => write!(f, "{dividend}/{divisor}"),
        }
    }
}
