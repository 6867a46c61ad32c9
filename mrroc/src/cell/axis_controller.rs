//! The keys of serial lines and of the axis controllers on them.

use serde::{Deserialize, Serialize};

use super::{Control, FeedForward, Law, Protocol, defaults};

/// A bundle of serial lines that axis controllers of one kind hang on, one on each.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Serial {
    /// What axes and reports call it.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// What the axis controllers speak.
    #[serde(default)]
    pub protocol: Protocol,
    /// Bits per second of each line; 8 data bits, 2 stop bits.
    #[serde(default = "defaults::count::<921_600, u32>")]
    pub baud: u32,
    /// Cycles in a row, 1 to 10, that an axis controller's answer may be missing before it is a fault: unheard, it
    /// goes on by its last set-point.
    #[serde(default = "defaults::count::<2, u32>")]
    pub tolerated_missing: u32,
    /// Deadline of the answer to a parameter, ms, at most 1000.
    #[serde(default = "defaults::count::<10, u32>")]
    pub answer_timeout_ms: u32,
    /// Latency timer of the USB adapter between host and line, ms, below the servo period, where one is to be emulated; none
    /// for a card.
    pub emulated_latency_ms: Option<u32>,
}

/// An axis controller on a serial line; the host closes its position loop every period.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    /// How the host closes the position loop.
    pub r#loop: Loop,
    /// Greatest velocity that the motor can physically have, rad/s: a position that would need more is not
    /// believed. A third above the axis's `max_velocity` where absent.
    pub plausible_velocity: Option<f64>,
    /// Greatest acceleration that it can physically have, rad/s², for the same purpose. Twenty times the
    /// axis's `max_acceleration` where absent.
    pub plausible_acceleration: Option<f64>,
}

// The output and the defaults of a `servo::HostLoop` follow from the axis and its drive.
/// A position loop that the host closes. What it puts out is, of an axis controller, torque, N·m, under `control =
/// "current"`, and a share of the full pulse width, -1 to 1, under `control = "pwm"`; of a drive on CAN velocity, rad/s,
/// under `control = "velocity"`, and torque, N·m, under `control = "torque"`.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Loop {
    /// From position error to output.
    pub law: Law,
    /// What the commanded motion needs, put out beforehand.
    #[serde(default)]
    pub feed_forward: FeedForward,
    /// Measured motor velocity, rad/s, that no working loop reaches: beyond it the power is taken at once. Above
    /// the axis's `max_velocity`; 1.2 times that where absent.
    pub runaway_velocity: Option<f64>,
}
