//! The steps of bring-up: reads and writes before a node is started.

use canopen::Object;
use canopen::cia402::ModeOfOperation;
use canopen::objects::*;
use canopen::sdo::Write;

use crate::Increments;
use crate::cia402::{Agreement, ConfigError, GroupConfig, Identity};

/// One read or write of bring-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Object 0x1018 must have this value.
    Identity(Object, u32),
    /// Object 0x6502 must list these modes. A drive without the object is accepted: object 0x6061 shows the mode.
    Modes([ModeOfOperation; 2]),
    /// Sub-index 0 of an array of an I/O node must be at least this number of blocks.
    Blocks(Object, u8),
    /// Reads the object of the agreement. A drive without the object is accepted.
    Value(Agreement),
    /// Reads the divisor of the agreement, if there is one, and checks the quotient against the cell.
    Agree(Agreement),
    /// Writes this setting of [`AxisConfig::configuration`](crate::cia402::AxisConfig::configuration) or
    /// [`IoConfig::configuration`](crate::cia401::IoConfig::configuration), and reads it back if the object is
    /// readable.
    Configure(Object, usize),
    /// Reads a limit. A drive without the object, or with at least this much, skips the next [`Need::Limit`].
    AtLeast(Object, u32),
    /// Writes and reads back.
    Set(Write, Need),
    /// Reads the lower software position limit. A drive without the object is accepted.
    LowerLimit,
    /// Reads the upper software position limit, and compares both with the least and the greatest position of the cell.
    UpperLimit([Increments; 2]),
    /// Object 0x6061 must come to show this mode.
    Shown(ModeOfOperation),
    /// Reads object 0x6041.
    Statusword,
    /// Reads object 0x6064.
    Position,
    /// Reads object 0x603F, used if the drive is in fault.
    ErrorCode,
    /// Reads object 0x60FD.
    Inputs,
}

/// What the absence of an object of [`Step::Set`] means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Need {
    /// The node is refused.
    Required,
    /// The node is accepted.
    Optional,
    /// The drive is refused, unless the last [`Step::AtLeast`] found no limit to raise.
    Limit,
    /// The drive is accepted, and its mode of operation is not watched.
    Watch,
}

impl Step {
    /// A write whose object the node must have.
    pub(crate) fn required(write: Write) -> Self {
        Self::Set(write, Need::Required)
    }

    /// A write whose object the node may lack.
    pub(crate) fn optional(write: Write) -> Self {
        Self::Set(write, Need::Optional)
    }

    /// The checks of a node's identity.
    pub(crate) fn identity(identity: &Identity) -> impl Iterator<Item = Self> + use<> {
        let expected =
            [(VENDOR_ID, Some(identity.vendor)), (PRODUCT_CODE, identity.product), (REVISION, identity.revision)];
        expected.into_iter().filter_map(|(object, expected)| Some(Self::Identity(object, expected?)))
    }

    /// The heartbeat of the node, and the node's time-out of the host's heartbeat.
    pub(crate) fn heartbeats(group: &GroupConfig) -> Result<[Self; 2], ConfigError> {
        let (period, lost) = group.heartbeat_times()?;
        let consumer = u32::from(group.host_node.raw()) << 16 | u32::from(lost);
        Ok([Write::new(PRODUCER_HEARTBEAT, period), Write::new(CONSUMER_HEARTBEAT_1, consumer)].map(Self::required))
    }

    /// The object that the step writes.
    pub(crate) fn written(&self) -> Option<Object> {
        match self {
            Self::Set(write, _) => Some(write.object),
            Self::Configure(object, _) => Some(*object),
            _ => None,
        }
    }

    /// Whether the written value stays in operation: all but the objects that set-points carry.
    pub(crate) fn persists(&self) -> bool {
        self.written().is_some_and(|object| object != CONTROLWORD && object != TORQUE_OFFSET)
    }

    pub(crate) fn object(&self) -> Object {
        match self {
            Self::Identity(object, _)
            | Self::Blocks(object, _)
            | Self::Configure(object, _)
            | Self::AtLeast(object, _) => *object,
            Self::Modes(_) => SUPPORTED_MODES,
            Self::Value(agreement) => agreement.object,
            Self::Agree(agreement) => agreement.divisor.unwrap_or(agreement.object),
            Self::Set(write, _) => write.object,
            Self::LowerLimit => MIN_POSITION_LIMIT,
            Self::UpperLimit(_) => MAX_POSITION_LIMIT,
            Self::Shown(_) => MODE_OF_OPERATION_DISPLAY,
            Self::Statusword => STATUSWORD,
            Self::Position => POSITION_ACTUAL,
            Self::ErrorCode => ERROR_CODE,
            Self::Inputs => DIGITAL_INPUTS,
        }
    }

    /// Whether the step is skipped if the drive has the object of the last agreement.
    pub(crate) fn instead(&self) -> bool {
        match self {
            Self::Value(agreement) | Self::Agree(agreement) => agreement.instead,
            Self::Set(_, Need::Limit) => true,
            _ => false,
        }
    }
}
