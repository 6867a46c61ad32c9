//! Configuration of an I/O node, and the checks made before the first frame.

use std::time::Duration;

use canopen::NodeId;
use canopen::cia401::CHANNELS;
use thiserror::Error;

use super::reserved::reserved;
use crate::cia402::{AxisConfig, ConfigError, GroupConfig, Identity, Setting, check_settings};

/// Unit of an inhibit time (CiA 301 §7.5.2.37).
const INHIBIT_UNIT: Duration = Duration::from_micros(100);

/// Event timers without inputs after which the node counts as silent.
const INPUTS_TO_LOSE: u32 = 3;

/// One I/O node. The heartbeat periods are those of the bus ([`GroupConfig::heartbeat_period`]).
#[derive(Clone, Debug, PartialEq)]
pub struct IoConfig {
    /// Node-ID.
    pub node: NodeId,
    /// Expected content of object 0x1018.
    pub identity: Identity,
    /// Number of inputs that are used, up to 64. They are the first inputs of the node.
    pub inputs: u8,
    /// Number of outputs that are used, up to 64. They are the first outputs of the node.
    pub outputs: u8,
    /// Shortest time between two frames with inputs, a multiple of 100 µs up to the event timer. The inhibit time
    /// bounds the bus load and the delay of an edge.
    pub inhibit_time: Duration,
    /// Longest time between two frames with inputs, whole milliseconds. Three event timers without inputs are
    /// [`IoFault::InputsSilent`](super::IoFault::InputsSilent).
    pub event_timer: Duration,
    /// Inputs whose level is inverted, input *n* in bit *n*. The driver inverts them, so a node may lack object 0x6002.
    pub inverted_inputs: u64,
    /// Inputs of the emergency stop, input *n* in bit *n*. While one of them is false after its inversion, or the node has a
    /// fault, all effectors of the servo are stopped.
    pub emergency_inputs: u64,
    /// Inputs that the node filters (0x6003), input *n* in bit *n*. The filter time belongs to the node.
    pub filtered_inputs: u64,
    /// Outputs whose level is inverted at the terminal, output *n* in bit *n*. The driver inverts them.
    pub inverted_outputs: u64,
    /// Outputs that take their [`error_value`](Self::error_value) in the error state (0x6206), output *n* in bit *n*.
    /// The other outputs keep their level.
    pub error_mode: u64,
    /// Levels of the outputs before the first command, output *n* in bit *n*, for the outputs of either
    /// [`error_mode`](Self::error_mode). For the outputs whose error mode is set, also the levels in the error state
    /// (0x6207, which takes them as levels at the terminal).
    pub error_value: u64,
    /// Objects downloaded in order before the settings of this driver. None of them may be
    /// [`reserved`](super::reserved).
    pub configuration: Vec<Setting>,
}

/// A quantity of an I/O node that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document the variants")]
pub enum IoQuantity {
    #[error("a node has up to 64 inputs and up to 64 outputs, and one of them at least")]
    Channels,
    #[error("inhibit time is not a multiple of 100 µs from 100 µs to the event timer")]
    InhibitTime,
    #[error("event timer is not 1 to 65535 whole milliseconds")]
    EventTimer,
    #[error("filter, inversion or emergency stop has a bit beyond the inputs")]
    InputMask,
    #[error("error mode, error value or inversion has a bit beyond the outputs")]
    OutputMask,
}

/// Checks the I/O nodes of a bus whose drives are `axes`: their node-IDs and their quantities. Refuses a bus without a
/// node. No frame is sent.
pub fn check(group: &GroupConfig, axes: &[AxisConfig], io: &[IoConfig]) -> Result<(), ConfigError> {
    if axes.is_empty() && io.is_empty() {
        return Err(ConfigError::NoNodes);
    }
    for (i, config) in io.iter().enumerate() {
        let node = config.node;
        let drives = axes.iter().map(|axis| axis.node);
        let mut others = drives.chain(io[..i].iter().map(|other| other.node)).chain([group.host_node]);
        if others.any(|other| other == node) {
            return Err(ConfigError::DuplicateNode(node.raw()));
        }
        let out_of_range = |quantity| ConfigError::IoOutOfRange { node: node.raw(), quantity };
        if config.inputs.max(config.outputs) > CHANNELS || config.inputs.max(config.outputs) == 0 {
            return Err(out_of_range(IoQuantity::Channels));
        }
        if (config.inverted_inputs | config.filtered_inputs | config.emergency_inputs) & !mask(config.inputs) != 0 {
            return Err(out_of_range(IoQuantity::InputMask));
        }
        if (config.error_mode | config.error_value | config.inverted_outputs) & !mask(config.outputs) != 0 {
            return Err(out_of_range(IoQuantity::OutputMask));
        }
        config.event_timer_ms()?;
        config.inhibit_units()?;
        check_settings(node, &config.configuration, reserved)?;
    }
    Ok(())
}

/// The bits of so many channels.
pub(super) fn mask(channels: u8) -> u64 {
    1_u64.checked_shl(channels.into()).map_or(u64::MAX, |bit| bit - 1)
}

impl IoConfig {
    /// Greatest number of frames with inputs that arrive within `time`.
    pub(crate) fn frames_per(&self, time: Duration) -> usize {
        1 + (time.as_nanos() / self.inhibit_time.as_nanos().max(1)) as usize
    }

    /// Time without inputs after which the node counts as silent.
    pub(super) fn inputs_lost_after(&self) -> Duration {
        self.event_timer * INPUTS_TO_LOSE
    }

    /// Inhibit time of TPDO 1, 100 µs.
    pub(super) fn inhibit_units(&self) -> Result<u16, ConfigError> {
        let error = ConfigError::IoOutOfRange { node: self.node.raw(), quantity: IoQuantity::InhibitTime };
        let units = whole(self.inhibit_time, INHIBIT_UNIT).ok_or(error)?;
        if self.inhibit_time <= self.event_timer { Ok(units) } else { Err(error) }
    }

    /// Event timer of TPDO 1, ms.
    pub(super) fn event_timer_ms(&self) -> Result<u16, ConfigError> {
        let error = ConfigError::IoOutOfRange { node: self.node.raw(), quantity: IoQuantity::EventTimer };
        whole(self.event_timer, Duration::from_millis(1)).ok_or(error)
    }
}

/// The time as a positive whole number of units; `None` for another time.
fn whole(time: Duration, unit: Duration) -> Option<u16> {
    let (time, unit) = (time.as_nanos(), unit.as_nanos());
    u16::try_from(time / unit).ok().filter(|count| *count > 0 && time.is_multiple_of(unit))
}
