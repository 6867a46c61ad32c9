use std::time::Duration;

use thiserror::Error;

/// A latched condition of one axis, cleared by [`AxisCommand::ResetFault`](crate::AxisCommand::ResetFault).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Fault {
    /// The drive reported a fault (EMCY and object 0x603F of CiA 402).
    #[error("node {node}: drive fault {code:#06x} ({text})", text = canopen_text(*.code))]
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
    /// The node's heartbeat stopped.
    #[error("node {node}: no heartbeat for {waited:?}")]
    HeartbeatLost {
        /// Node-ID.
        node: u8,
        /// Time since the last one.
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
    /// The drive did not reach the asked state in time.
    #[error("node {node}: did not reach the asked state within {waited:?} (statusword {statusword:#06x})")]
    Stuck {
        /// Node-ID.
        node: u8,
        /// Object 0x6041.
        statusword: u16,
        /// Time waited.
        waited: Duration,
    },
    /// The port cannot send or receive.
    #[error("bus: {0}")]
    Port(can::PortError),
}

/// The text of a drive's error code; a family may know more codes than CiA 402.
fn canopen_text(_code: u16) -> &'static str {
    "see the drive's manual"
}

/// Why a group could not be brought up. Nothing has moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BringUpError {
    /// No boot-up message and no answer.
    #[error("node {node}: never booted, waited {waited:?}")]
    NeverBooted {
        /// Node-ID.
        node: u8,
        /// Time waited.
        waited: Duration,
    },
    /// Object 0x1018 does not say what the cell says.
    #[error("node {node}: identity {subindex:02x} is {found:#010x}, the cell expects {expected:#010x}")]
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
    /// The drive refused a parameter.
    #[error("node {node}: {index:#06x}:{subindex:02x} refused with abort {code:#010x}")]
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
    /// The drive did not answer a service request in time.
    #[error("node {node}: {index:#06x}:{subindex:02x} timed out after {waited:?}")]
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
    /// The port cannot send or receive.
    #[error("bus: {0}")]
    Port(#[from] can::PortError),
}
