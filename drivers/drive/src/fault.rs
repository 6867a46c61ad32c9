//! Faults of an axis, and errors of bring-up.

use std::time::Duration;

use canopen::Object;
use canopen::cia402::{FaultTable, ModeOfOperation};
use canopen::sdo::AbortCode;
use thiserror::Error;

use crate::axis_controller::{AxisControllerError, AxisControllerFault};
use crate::cia402::Sign;

/// A latched condition of one axis, cleared by [`AxisCommand::ResetFault`](crate::AxisCommand::ResetFault).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Fault {
    /// The drive reported a fault (EMCY and object 0x603F, CiA 402-2 §8.4.3).
    #[error("node {node}: drive fault {code:#06x} ({text})", text = FaultTable::Epos4.text(*.code))]
    Drive {
        /// Node-ID.
        node: u8,
        /// Error code of CiA 402-2 §7.1 or of the vendor.
        code: u16,
    },
    /// Answers were missing for more cycles than the cell tolerates.
    #[error("node {node}: no answer for {cycles} cycles")]
    Silent {
        /// Node-ID.
        node: u8,
        /// Cycles without an answer.
        cycles: u32,
    },
    /// The port refused the set-point of the node, or even the SYNC, for more cycles than the cell tolerates. The
    /// drive continues with an old set-point.
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
        /// Time since the last heartbeat.
        waited: Duration,
    },
    /// The host sent no SYNC for longer than the drives' heartbeat time-out. The drives have stopped by themselves.
    #[error("node {node}: no SYNC was sent for {waited:.1?}")]
    HostLate {
        /// Node-ID.
        node: u8,
        /// Time since the last SYNC.
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
    /// The drive left the state operation enabled without a command and without a fault.
    #[error("node {node}: power was lost (statusword {statusword:#06x})")]
    PowerLost {
        /// Node-ID.
        node: u8,
        /// Object 0x6041.
        statusword: u16,
    },
    /// The drive's position counter jumped. The position is refused as implausible.
    #[error(
        "node {node}: position jumped by {moved} increments within {within:.1?}; the motor cannot have turned by more than \
         {most}"
    )]
    Implausible {
        /// Node-ID.
        node: u8,
        /// Increments from the last plausible position.
        moved: i32,
        /// Greatest possible displacement of the motor, increments.
        most: u32,
        /// Longest time that may have passed since that position.
        within: Duration,
    },
    /// Another controller changed the drive's mode of operation.
    #[error("node {node}: mode of operation is {found}, commanded was {expected}")]
    ModeChanged {
        /// Node-ID.
        node: u8,
        /// The commanded mode (object 0x6060).
        expected: ModeOfOperation,
        /// The mode that the drive reports (object 0x6061).
        found: ModeOfOperation,
    },
    /// The drive did not reach the commanded state in time.
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
    #[error("node {node}: {object} failed: {abort}", abort = AbortCode(*.code))]
    Aborted {
        /// Node-ID.
        node: u8,
        /// The object.
        object: Object,
        /// SDO abort code; 0x0504_0000 if the drive did not answer.
        code: u32,
    },
    /// A set-point was refused. No set-point of that cycle was sent.
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
        /// The fault of the axis controller.
        fault: AxisControllerFault,
    },
    /// A second controller commands the drives of the bus.
    #[error("bus: another controller is at work: it sent {sign}")]
    OtherController {
        /// The frame by which it was detected.
        sign: Sign,
    },
    /// The port cannot send or receive.
    #[error("bus: {0}")]
    Port(can::PortError),
    /// The host's CAN controller counted too many errors and left the bus. No drive receives the host's frames.
    #[error("bus: the controller is bus-off")]
    BusOff,
}

/// Reason for refusing a set-point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// The drive's mode of operation follows another kind of set-point.
    #[error("is of another kind than the drive's mode of operation follows")]
    WrongKind,
    /// The drive has no torque.
    #[error("came while the drive was not on")]
    NotOn,
    /// The set-point is beyond the range of the drive's units.
    #[error("does not fit the drive's units")]
    OutOfRange,
}

/// Failure of the bring-up of a group. Nothing has moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BringUpError {
    /// Neither a boot-up message nor an answer was received.
    #[error("node {node}: never booted, waited {waited:.1?}")]
    NeverBooted {
        /// Node-ID.
        node: u8,
        /// Time waited.
        waited: Duration,
    },
    /// The node answers, but its device profile is not CiA 402.
    #[error("node {node}: not a CiA 402 drive (0x1000 is {device_type:#010x})")]
    NotADrive {
        /// Node-ID.
        node: u8,
        /// Object 0x1000.
        device_type: u32,
    },
    /// The node was started, but no heartbeat showed the state operational.
    #[error("node {node}: not operational, waited {waited:.1?}")]
    NotOperational {
        /// Node-ID.
        node: u8,
        /// Time waited.
        waited: Duration,
    },
    /// Object 0x1018 differs from the cell file.
    #[error(
        "node {node}: identity 0x1018:{subindex:02x} is {found:#010x}, the cell expects {expected:#010x}"
    )]
    WrongIdentity {
        /// Node-ID.
        node: u8,
        /// Sub-index of 0x1018: 1 vendor, 2 product, 3 revision, 4 serial number.
        subindex: u8,
        /// The value in the cell file.
        expected: u32,
        /// The value in the drive.
        found: u32,
    },
    /// The scale of the drive's positions or torques differs from the cell.
    #[error(
        "node {node}: {object} is {ratio} {what}, the cell says {expected}: {remedy}",
        ratio = ratio(*.found, *.per)
    )]
    WrongScale {
        /// Node-ID.
        node: u8,
        /// The object; for a ratio, the dividend.
        object: Object,
        /// The value in the drive; for a ratio, the dividend.
        found: u32,
        /// The divisor of a ratio, otherwise 1.
        per: u32,
        /// The value in the cell file, in the drive's unit.
        expected: u32,
        /// The quantity and its unit.
        what: &'static str,
        /// The remedy.
        remedy: &'static str,
    },
    /// The drive refused a parameter.
    #[error("node {node}: {object} refused: {abort}", abort = AbortCode(*.code))]
    Aborted {
        /// Node-ID.
        node: u8,
        /// The object.
        object: Object,
        /// SDO abort code.
        code: u32,
    },
    /// The drive accepted a parameter but reads back another value.
    #[error("node {node}: {object} reads back {found:#x}, wrote {written:#x}")]
    ReadBack {
        /// Node-ID.
        node: u8,
        /// The object.
        object: Object,
        /// The written value.
        written: u32,
        /// The value read back.
        found: u32,
    },
    /// The drive accepted data but reads back other data.
    #[error(
        "node {node}: {object} reads back {found} bytes, wrote {written}, the first {same} are equal"
    )]
    ReadBackBytes {
        /// Node-ID.
        node: u8,
        /// The object.
        object: Object,
        /// Bytes written.
        written: usize,
        /// Bytes read back.
        found: usize,
        /// Number of equal bytes from the start.
        same: usize,
    },
    /// The drive did not answer a service request in time.
    #[error("node {node}: {object} timed out after {waited:.1?}")]
    TimedOut {
        /// Node-ID.
        node: u8,
        /// The object.
        object: Object,
        /// Time waited.
        waited: Duration,
    },
    /// The drive does not support the mode of operation (object 0x6502).
    #[error("node {node}: mode {mode} is not supported (0x6502 is {supported:#010x})")]
    ModeUnsupported {
        /// Node-ID.
        node: u8,
        /// The mode as a value of object 0x6060.
        mode: i8,
        /// Object 0x6502.
        supported: u32,
    },
    /// An axis controller on a serial line could not be brought up.
    #[error("line {line}: {error}")]
    AxisController {
        /// Index of its axis in the group.
        line: u8,
        /// The reason.
        error: AxisControllerError,
    },
    /// A second controller commands the drives of the bus.
    #[error("another controller is at work: it sent {sign}; end it before this one is started")]
    OtherController {
        /// The frame by which it was detected.
        sign: Sign,
    },
    /// The port cannot send or receive.
    #[error("bus: {0}")]
    Port(#[from] can::PortError),
}

impl BringUpError {
    /// The node concerned; `None` on a serial line, whose index is [`line`](Self::line).
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

    /// The index within the group of the axis concerned, on a serial line.
    pub fn line(&self) -> Option<usize> {
        match *self {
            Self::AxisController { line, .. } => Some(usize::from(line)),
            _ => None,
        }
    }
}

/// `4000` or `8000/3`.
fn ratio(dividend: u32, divisor: u32) -> String {
    match divisor {
        1 => dividend.to_string(),
        _ => format!("{dividend}/{divisor}"),
    }
}
