//! Configuration of a force/torque sensor, and the checks made before the first byte.

use std::time::Duration;

use serial::{Settings, ati};
use thiserror::Error;

use super::node_config::NodeQuantity;
use super::state::WrenchAxis;
use crate::cia402;

/// Greatest magnitude of a scale, N or N·m per count. With this bound, every scaled count is finite.
const GREATEST_SCALE: f64 = 1e9;

/// Configuration that sensors on serial lines and on CAN buses share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchConfig {
    /// The channels, in the order of a wrench: Fx, Fy, Fz, Tx, Ty, Tz.
    pub channels: [Channel; 6],
    /// Number of samples in a row that may be missing. One more missing sample is a fault:
    /// [`Silent`](super::WrenchFault::Silent) by default, [`Garbage`](super::WrenchFault::Garbage) if a reading since
    /// the last sample was no answer, [`OfAnotherRate`](super::WrenchFault::OfAnotherRate) if an answer was late. A
    /// missing answer of a serial sensor costs two samples: the next query waits until a late answer would have come.
    pub tolerated_missing: u32,
    /// Number of saturated samples in a row that are tolerated. One more is
    /// [`WrenchFault::Saturated`](super::WrenchFault::Saturated). A tolerated saturated sample counts as missing. On a
    /// wire without a checksum the number must be at least 1: a flipped bit must not stop the robot.
    pub tolerated_saturated: u32,
    /// How the sensor is zeroed.
    pub zero: ZeroMethod,
}

/// Scale and range of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// Force or torque of one count, N or N·m. A negative scale inverts the sign.
    pub scale: f64,
    /// Limit of the magnitude, counts: the channel is saturated at and beyond this limit, with either sign.
    pub range: i32,
}

/// How [`WrenchLink::zero`](super::WrenchLink::zero) zeroes a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ZeroMethod {
    /// The host subtracts the mean of a number of samples. The counts of the sensor do not change, so
    /// [`Channel::range`] remains the saturation limit of the transducer.
    Host {
        /// Number of samples, at least 1. MRROC++ takes 10.
        samples: u16,
    },
    /// The sensor executes its bias command. Only [`SerialWrenchSensor`](super::SerialWrenchSensor) has this command. A
    /// restart of the sensor clears this zero.
    Device,
}

impl WrenchConfig {
    /// The ATI transducers of the IRp-6 robots on their controller board: 65 N, 65 N, 130 N and 5 N·m.
    pub const ATI: Self = {
        const fn force(range: i32) -> Channel {
            Channel { scale: 10.0 / 115.0, range }
        }
        const TORQUE: Channel = Channel { scale: 5.0 / 940.0, range: 940 };
        Self {
            channels: [force(747), force(747), force(1_495), TORQUE, TORQUE, TORQUE],
            tolerated_missing: 3,
            tolerated_saturated: 1,
            zero: ZeroMethod::Host { samples: 10 },
        }
    };

    /// Checks all values. `has_bias`: whether the sensor has a bias command.
    pub(super) fn check(&self, has_bias: bool) -> Result<(), ConfigError> {
        for (axis, channel) in WrenchAxis::ALL.into_iter().zip(self.channels) {
            let scale = channel.scale.abs();
            if !(scale > 0.0 && scale <= GREATEST_SCALE) {
                return Err(ConfigError::Scale { axis, scale: channel.scale });
            }
            if channel.range < 1 {
                return Err(ConfigError::Range { axis, range: channel.range });
            }
        }
        match self.zero {
            ZeroMethod::Host { samples: 0 } => Err(ConfigError::ZeroSamples),
            ZeroMethod::Device if !has_bias => Err(ConfigError::NoBias),
            ZeroMethod::Device if self.tolerated_missing == 0 => Err(ConfigError::BiasGap),
            ZeroMethod::Host { .. } | ZeroMethod::Device => Ok(()),
        }
    }
}

/// A sensor on a serial line of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SerialWrenchConfig {
    /// Servo period. The period must be longer than one query and its answer on the line.
    pub period: Duration,
    /// Settings of the line.
    pub settings: Settings,
    /// Scales, ranges and tolerances.
    pub sensor: WrenchConfig,
    /// Bring-up: longest wait for the answer to one query. The line is then drained, and the query repeated.
    pub answer_timeout: Duration,
    /// Bring-up: time limit from its begin to the first answer, and between two answers. After power-on the sensor
    /// first sends a text.
    pub boot_timeout: Duration,
}

impl SerialWrenchConfig {
    /// The sensors of the IRp-6 robots: 115200 8N1, one query per period.
    pub const fn new(period: Duration) -> Self {
        Self {
            period,
            settings: ati::SETTINGS,
            sensor: WrenchConfig::ATI,
            answer_timeout: Duration::from_millis(50),
            boot_timeout: Duration::from_secs(2),
        }
    }

    /// Checks the configuration. Bring-up relies on this check, which sends no byte.
    pub fn check(&self) -> Result<(), ConfigError> {
        let exchange = self.settings.line_time(ati::REQUEST + ati::REPLY);
        if exchange >= self.period {
            return Err(ConfigError::Period { period: self.period, exchange });
        }
        self.sensor.check(true)
    }
}

/// Why the configuration of a force/torque sensor is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum ConfigError {
    #[error("a period of {period:?} is too short for a query and its answer, {exchange:?} on the line")]
    Period { period: Duration, exchange: Duration },
    #[error("scale of {axis} is {scale}, it must be a number other than 0, up to 1e9 per count")]
    Scale { axis: WrenchAxis, scale: f64 },
    #[error("range of {axis} is {range} counts, it must be at least 1")]
    Range { axis: WrenchAxis, range: i32 },
    #[error("the zero is the mean of at least 1 sample")]
    ZeroSamples,
    #[error("a sensor on a CAN bus has no bias command: zero it in the host")]
    NoBias,
    #[error("the bias command takes the place of a query: at least 1 missing sample must be tolerated")]
    BiasGap,
    #[error("node {node}: {quantity}")]
    Node { node: u8, quantity: NodeQuantity },
    #[error("node {node}: COB-ID {cob_id:#05x} is reserved, or belongs to another frame of the bus")]
    CobId { node: u8, cob_id: u16 },
    #[error("{0}")]
    Bus(#[from] cia402::ConfigError),
}
