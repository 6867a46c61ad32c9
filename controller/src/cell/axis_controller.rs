//! The keys of serial lines and of the axis controllers on them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A bundle of serial lines that axis controllers of one kind hang on, one on each.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Serial {
    /// What axes and reports call it.
    pub name: String,
    /// What the axis controllers speak.
    #[serde(default)]
    pub protocol: Protocol,
    /// Bits per second of each line; 8 data bits, 2 stop bits.
    #[serde(default = "defaults::baud")]
    pub baud: u32,
    /// Cycles in a row that an axis controller's answer may be missing before it is a fault.
    #[serde(default = "defaults::tolerated_missing_on_lines")]
    pub tolerated_missing: u32,
    /// Deadline of the answer to a parameter, ms.
    #[serde(default = "defaults::answer_timeout_ms")]
    pub answer_timeout_ms: u32,
    /// Latency timer of the USB adapter between host and line, ms, where one is to be emulated; none
    /// for a card.
    #[serde(default)]
    pub emulated_latency_ms: Option<u32>,
}

/// What serial axis controllers speak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// Framed and addressed, with a CRC-8.
    #[default]
    Nfv2,
    /// The older one, without a checksum.
    HiMoxa,
}

/// An axis controller on a serial line; the host closes its position loop every period.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AxisController {
    /// The tty, `/dev/serial/by-id/…` for one that keeps its name; unused on the benches without hardware.
    pub line: String,
    /// Quadrature counts per motor revolution.
    pub counts_per_revolution: u32,
    /// Whether the counter falls while the motor turns in its positive direction.
    #[serde(default)]
    pub reversed: bool,
    /// What it is commanded by.
    #[serde(default)]
    pub control: Control,
    /// Motor current at which its protection acts, A.
    pub max_current: f64,
    /// Torque of the motor per current, N·m/A.
    pub torque_constant: f64,
    /// Greatest velocity that the motor can physically have, rad/s: a position that would need more is not
    /// believed. Twice the axis's `max_velocity` where absent.
    #[serde(default)]
    pub plausible_velocity: Option<f64>,
    /// Greatest acceleration that it can physically have, rad/s², for the same purpose. Twenty times the
    /// axis's `max_acceleration` where absent.
    #[serde(default)]
    pub plausible_acceleration: Option<f64>,
}

/// What an axis controller is commanded by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Control {
    /// Motor current; its own loop keeps it. NFv2 only.
    #[default]
    Current,
    /// Pulse width: the share of the supply voltage that the motor gets.
    Pwm,
}

mod defaults {
    pub(super) fn baud() -> u32 {
        921_600
    }
    pub(super) fn tolerated_missing_on_lines() -> u32 {
        2
    }
    pub(super) fn answer_timeout_ms() -> u32 {
        10
    }
}
