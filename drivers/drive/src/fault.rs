//! Faults of an axis, and errors of bring-up.

use std::time::Duration;

use can::counted;
use canopen::Object;
use canopen::cia402::{FaultTable, ModeOfOperation, PowerState, Statusword};
use canopen::objects::{DEVICE_TYPE, SUPPORTED_MODES, VENDOR_ID};
use canopen::sdo::AbortCode;
use thiserror::Error;

use crate::axis_controller::{AxisControllerError, AxisControllerFault};
use crate::bus::Sign;
use crate::device::DeviceError;
use crate::ultrasonic::UltrasonicError;
use crate::wrench::WrenchError;

/// A latched condition of one axis, cleared by [`AxisCommand::ResetFault`](crate::AxisCommand::ResetFault).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum Fault {
    /// The drive reported an error by its statusword (code in EMCY and object 0x603F, CiA 402-2 §8.4.3), or by an EMCY alone
    /// while it was commanded to be on. The code is of CiA 402-2 §7.1 or of the vendor.
    #[error("node {node}: {}", of_code(*.code))]
    Drive { node: u8, code: u16 },
    /// Answers were missing for more cycles than the cell tolerates.
    #[error("node {node}: no answer for {}", counted(*.cycles, "cycle"))]
    Silent { node: u8, cycles: u32 },
    /// All answers come `periods` later than in the period of their SYNC: longer than the loop of the axis, or the tolerated
    /// number of missing answers, permits. A SYNC that was left out proved the latency.
    #[error(
        "node {node}: answers come {latency:.1?} after SYNC, {} late, {most:.1?} permitted",
        counted(*.periods, "period")
    )]
    Late { node: u8, periods: u32, latency: Duration, most: Duration },
    /// The port refused the set-point of the node, or even the SYNC, for more cycles than the cell tolerates. The
    /// drive continues with an old set-point.
    #[error("node {node}: set-point not taken by the bus for {}", counted(*.cycles, "cycle"))]
    NotSent { node: u8, cycles: u32 },
    /// The host's controller is error passive, and the bus took no frame of the host in these cycles: no other node
    /// acknowledges the frames. At most the frames of one cycle wait in the controller.
    #[error("bus: no node acknowledges the host's frames, for {}", counted(*.cycles, "cycle"))]
    NotAcknowledged { cycles: u32 },
    #[error("node {node}: no heartbeat for {waited:.1?}")]
    HeartbeatLost { node: u8, waited: Duration },
    /// The host sent no SYNC for longer than the drives' heartbeat time-out. The drives have stopped by themselves.
    #[error("node {node}: no SYNC was sent for {waited:.1?}")]
    HostLate { node: u8, waited: Duration },
    /// The port took no heartbeat of ours for longer than the drives wait for it: they have stopped by themselves. The
    /// time counts from the last one, or from bring-up.
    #[error("bus: the host's heartbeat was not sent for {waited:.1?}")]
    HeartbeatNotSent { waited: Duration },
    /// The node booted again, or left NMT state operational, during operation.
    #[error("node {node}: left operational state")]
    LeftOperational { node: u8 },
    /// A reset of the fault failed: the node booted or left the state operational, and could not be brought up again.
    #[error("reset failed: {error}")]
    NotBack { error: BringUpError },
    /// The drive left the state operation enabled without a command and without a fault (object 0x6041).
    #[error("node {node}: power was lost (statusword {statusword:#06x}, {})", state(*.statusword))]
    PowerLost { node: u8, statusword: u16 },
    /// The drive's position counter jumped by `moved` from the last plausible position. The position is refused as
    /// implausible. `within` is the longest time that may have passed since that position.
    #[error(
        "node {node}: position jumped by {moved} increments within {within:.1?}; the motor cannot have turned by more than \
         {most}"
    )]
    Implausible { node: u8, moved: i32, most: u32, within: Duration },
    /// The drive was told to search for its reference, and neither its statusword nor its counter showed a search. A
    /// result that it shows is of an earlier search.
    #[error("node {node}: homing did not begin, no search was seen for {waited:.1?}")]
    NoSearch { node: u8, waited: Duration },
    /// The drive reported that it found its reference, and its position counter is further from zero than the motor can be.
    #[error("node {node}: homing ended at a count of {counter}, more than {most} from zero")]
    NotAtZero { node: u8, counter: i32, most: u32 },
    /// Another controller changed the drive's mode of operation from the commanded one (object 0x6060) to the reported
    /// one (object 0x6061).
    #[error("node {node}: mode of operation is {found}, commanded was {expected}")]
    ModeChanged { node: u8, expected: ModeOfOperation, found: ModeOfOperation },
    /// The drive did not reach the commanded state in time (object 0x6041).
    #[error(
        "node {node}: did not reach the asked state within {waited:.1?} (statusword {statusword:#06x}, {})",
        state(*.statusword)
    )]
    Stuck { node: u8, statusword: u16, waited: Duration },
    /// The drive refused a service request with an SDO abort code, or did not answer it in time (0x0504_0000).
    #[error("node {node}: {object} failed: {abort}", abort = AbortCode(*.code))]
    Aborted { node: u8, object: Object, code: u32 },
    /// A set-point was refused. No set-point of that cycle was sent.
    #[error("node {node}: set-point {refusal}")]
    Refused { node: u8, refusal: Refusal },
    /// A fault of an axis controller on a serial line. `line` is the index of its axis in the group.
    #[error("line {line}: {fault}")]
    AxisController { line: u8, fault: AxisControllerFault },
    #[error("bus: another controller is at work: it sent {sign}")]
    OtherController { sign: Sign },
    #[error("bus: {0}")]
    Port(can::PortError),
    /// The host's CAN controller counted too many errors and left the bus. No drive receives the host's frames.
    #[error("bus: the controller is bus-off")]
    BusOff,
}

/// Reason for refusing a set-point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum Refusal {
    #[error("is of another kind than the drive's mode of operation follows")]
    WrongKind,
    #[error("came while the drive was not on")]
    NotOn,
    #[error("does not fit the drive's units")]
    OutOfRange,
}

/// Failure of the bring-up of a group. Nothing has moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum BringUpError {
    /// Neither a boot-up message nor an answer was received.
    #[error("node {node}: never booted, waited {waited:.1?}")]
    NeverBooted { node: u8, waited: Duration },
    #[error("node {node}: not a CiA 402 drive (0x1000 is {device_type:#010x})")]
    NotADrive { node: u8, device_type: u32 },
    #[error("node {node}: not a CiA 401 I/O node (0x1000 is {device_type:#010x})")]
    NotAnIoNode { node: u8, device_type: u32 },
    /// The I/O node has too few inputs (0x6000) or outputs (0x6200).
    #[error("node {node}: {object} is {found} blocks of eight channels, {needed} are needed")]
    TooFewBlocks { node: u8, object: Object, found: u8, needed: u8 },
    /// The I/O node was started, but sent no TPDO with its inputs.
    #[error("node {node}: no inputs since the start, waited {waited:.1?}")]
    NoInputs { node: u8, waited: Duration },
    /// The drive was started, but sent no TPDO 1 after a SYNC.
    #[error("node {node}: no answer to SYNC, waited {waited:.1?}: check TPDO 1 of the drive (0x1800, 0x1A00)")]
    NoAnswer { node: u8, waited: Duration },
    /// Each answer to a SYNC that stands alone came later than the loop of the axis, or the tolerated number of missing
    /// answers, permits.
    #[error(
        "node {node}: answers come {latency:.1?} after their SYNC, {most:.1?} is tolerated: \
         remove what delays the frames (adapter, gateway, load of bus or host), or set a longer period"
    )]
    Late { node: u8, latency: Duration, most: Duration },
    /// The node was started, but no heartbeat showed the state operational.
    #[error("node {node}: no heartbeat showed the state operational, waited {waited:.1?}")]
    NotOperational { node: u8, waited: Duration },
    /// Object 0x1018 differs from the cell file: sub-index 1 vendor, 2 product, 3 revision, 4 serial number.
    #[error("node {node}: identity 0x1018:{subindex:02x} is {found:#010x}, the cell expects {expected:#010x}")]
    WrongIdentity { node: u8, subindex: u8, expected: u32, found: u32 },
    /// The scale of the drive's positions or torques differs from the cell, whose value is in the drive's unit. The scale
    /// is `found` / `per`, values of `object` and of its divisor; `per` is 1 without a divisor.
    #[error(
        "node {node}: {object} is {ratio} {what}, the cell says {expected}: {remedy}",
        ratio = ratio(*.found, *.per)
    )]
    WrongScale {
        node: u8,
        object: Object,
        found: u32,
        per: u32,
        expected: u32,
        what: &'static str,
        remedy: &'static str,
    },
    #[error("node {node}: {object} refused: {abort}", abort = AbortCode(*.code))]
    Aborted { node: u8, object: Object, code: u32 },
    /// The node refused a value of at most four bytes.
    #[error("node {node}: {object} refused {written:#x}: {abort}", abort = AbortCode(*.code))]
    WriteRefused { node: u8, object: Object, written: u32, code: u32 },
    #[error("node {node}: {object} reads back {found:#x}, wrote {written:#x}")]
    ReadBack { node: u8, object: Object, written: u32, found: u32 },
    #[error("node {node}: {object} reads back {found} bytes, wrote {written}, the first {same} are equal")]
    ReadBackBytes { node: u8, object: Object, written: usize, found: usize, same: usize },
    #[error("node {node}: {object} timed out after {waited:.1?}")]
    TimedOut { node: u8, object: Object, waited: Duration },
    /// The drive does not support the mode of operation, a value of object 0x6060 (object 0x6502).
    #[error(
        "node {node}: mode {mode} ({name}) is not supported (0x6502 is {supported:#010x})",
        name = ModeOfOperation::from_raw(*.mode)
    )]
    ModeUnsupported { node: u8, mode: i8, supported: u32 },
    /// An axis controller on a serial line could not be brought up. `line` is the index of its axis in the group.
    #[error("line {line}: {error}")]
    AxisController { line: u8, error: AxisControllerError },
    /// A force/torque sensor on a serial line of its own could not be brought up.
    #[error("force sensor: {error}")]
    WrenchLine { error: WrenchError },
    /// A force/torque sensor on a CAN bus could not be brought up.
    #[error("node {node}: force sensor: {error}")]
    WrenchNode { node: u8, error: WrenchError },
    /// An ultrasonic matrix on a serial line of its own could not be brought up.
    #[error("ultrasonic matrix: {error}")]
    Ultrasonic { error: UltrasonicError },
    /// A device of another crate could not be brought up.
    #[error("device: {error}")]
    Device { error: DeviceError },
    #[error("another controller is at work: it sent {sign}; end it before this one is started")]
    OtherController { sign: Sign },
    #[error("bus: {0}")]
    Port(#[from] can::PortError),
}

impl BringUpError {
    /// The node concerned; `None` on a serial line, whose index is [`line`](Self::line).
    pub fn node(&self) -> Option<u8> {
        match *self {
            Self::NeverBooted { node, .. }
            | Self::NotADrive { node, .. }
            | Self::NotAnIoNode { node, .. }
            | Self::TooFewBlocks { node, .. }
            | Self::NoInputs { node, .. }
            | Self::NotOperational { node, .. }
            | Self::NoAnswer { node, .. }
            | Self::Late { node, .. }
            | Self::WrongIdentity { node, .. }
            | Self::WrongScale { node, .. }
            | Self::Aborted { node, .. }
            | Self::WriteRefused { node, .. }
            | Self::ReadBack { node, .. }
            | Self::ReadBackBytes { node, .. }
            | Self::TimedOut { node, .. }
            | Self::ModeUnsupported { node, .. }
            | Self::WrenchNode { node, .. } => Some(node),
            Self::AxisController { .. }
            | Self::WrenchLine { .. }
            | Self::Ultrasonic { .. }
            | Self::Device { .. }
            | Self::OtherController { .. }
            | Self::Port(_) => None,
        }
    }

    /// The object that the node lacks, refuses or holds another value of.
    pub fn object(&self) -> Option<Object> {
        match *self {
            Self::NotADrive { .. }
            | Self::NotAnIoNode { .. }
            | Self::WrenchNode { error: WrenchError::OfAnotherType { .. }, .. } => Some(DEVICE_TYPE),
            Self::WrongIdentity { subindex, .. } => Some(Object { subindex, ..VENDOR_ID }),
            Self::ModeUnsupported { .. } => Some(SUPPORTED_MODES),
            Self::TooFewBlocks { object, .. }
            | Self::WrongScale { object, .. }
            | Self::Aborted { object, .. }
            | Self::WriteRefused { object, .. }
            | Self::ReadBack { object, .. }
            | Self::ReadBackBytes { object, .. }
            | Self::TimedOut { object, .. } => Some(object),
            Self::NeverBooted { .. }
            | Self::NoInputs { .. }
            | Self::NoAnswer { .. }
            | Self::Late { .. }
            | Self::NotOperational { .. }
            | Self::AxisController { .. }
            | Self::WrenchLine { .. }
            | Self::Ultrasonic { .. }
            | Self::Device { .. }
            | Self::WrenchNode { .. }
            | Self::OtherController { .. }
            | Self::Port(_) => None,
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

/// `drive fault 0x2310 (over-current)`. A drive without an error code says so in words.
fn of_code(code: u16) -> String {
    match code {
        0 => "drive fault, and the drive gives no error code (0x603F is 0, no EMCY)".to_owned(),
        _ => format!("drive fault {code:#06x} ({})", FaultTable::Epos4.text(code)),
    }
}

/// The power state of a statusword in words.
fn state(statusword: u16) -> PowerState {
    Statusword(statusword).power_state()
}

/// `4000` or `8000/3`.
fn ratio(dividend: u32, divisor: u32) -> String {
    match divisor {
        1 => dividend.to_string(),
        _ => format!("{dividend}/{divisor}"),
    }
}
