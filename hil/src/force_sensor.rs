//! Emulated force/torque sensors: one at a serial line, one on a CAN bus, both behind the same transducer.
//!
//! ```text
//! WrenchProbe ──► gain ──► offset, temperature drift ──► noise ──► range ──► bias ──► counts ──► wire
//! ```
//!
//! A [`WrenchProbe`] gives the true wrench. The transducer ([`TransducerConfig`]) turns the wrench into a reading with
//! the errors of a strain-gauge sensor. [`SerialForceSensor`] sends readings when a host queries them.
//! [`CanForceSensor`] sends readings as process data of a CANopen node. The same seed, wrench and requests give the
//! same readings, bit for bit.
//!
//! The order of all six channels is Fx, Fy, Fz, Tx, Ty, Tz: forces in N, torques in N·m, in the frame of the sensor.
//!
//! Not modelled: crosstalk between channels, hysteresis, an anti-aliasing filter, and drift of the gain.

mod can_config;
mod can_node;
mod eds;
mod line;
mod table;
#[cfg(test)]
mod tests;
mod transducer;

use thiserror::Error;

pub use can_config::{CanForceSensorConfig, CountWidth, Resolution};
pub use can_node::CanForceSensor;
pub use line::{SerialForceSensor, SerialForceSensorConfig};
pub use transducer::{TemperatureCourse, TransducerConfig};

use crate::scene::WrenchProbe;

/// Reasons why the configuration of a sensor is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum ForceSensorError {
    #[error("gain of channel {channel} is {value}, it must be finite")]
    Gain { channel: Channel, value: f64 },
    #[error("offset of channel {channel} is {value}, it must be finite")]
    Offset { channel: Channel, value: f64 },
    #[error("drift of channel {channel} is {value} per K, it must be finite")]
    Drift { channel: Channel, value: f64 },
    #[error("range of channel {channel} is {value}, it must be above 0 and finite")]
    Range { channel: Channel, value: f64 },
    #[error("noise of channel {channel} is {value}, it must be 0 or above, and finite")]
    Noise { channel: Channel, value: f64 },
    #[error("temperature goes from {start} to {end} °C, both must be finite")]
    Temperature { start: f64, end: f64 },
    #[error("a count is {force} N and {torque} N·m, both must be above 0 and finite")]
    Count { force: f64, torque: f64 },
    #[error("the sample period is 0")]
    NoSamplePeriod,
}

/// One of the six channels of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names are those of the components of a wrench")]
pub enum Channel {
    Fx,
    Fy,
    Fz,
    Tx,
    Ty,
    Tz,
}

impl Channel {
    /// All channels in the order of a reading.
    pub const ALL: [Self; 6] = [Self::Fx, Self::Fy, Self::Fz, Self::Tx, Self::Ty, Self::Tz];
}

impl std::fmt::Display for Channel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Debug::fmt(self, f)
    }
}
