//! The keys of serial lines and of the axis controllers on them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A bundle of serial lines that axis controllers of one kind hang on, one on each.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Serial {
    /// What axes and reports call it.
    #[schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"))]
    pub name: String,
    /// What the axis controllers speak.
    #[serde(default)]
    pub protocol: Protocol,
    /// Bits per second of each line; 8 data bits, 2 stop bits.
    #[serde(default = "defaults::baud")]
    pub baud: u32,
    /// Cycles in a row, 1 to 10, that an axis controller's answer may be missing before it is a fault: unheard, it
    /// goes on by its last set-point.
    #[serde(default = "defaults::tolerated_missing_on_lines")]
    pub tolerated_missing: u32,
    /// Deadline of the answer to a parameter, ms, at most 1000.
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

impl Protocol {
    /// Its name in cell files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nfv2 => "nfv2",
            Self::HiMoxa => "hi-moxa",
        }
    }
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
    /// How the host closes the position loop.
    pub r#loop: Loop,
    /// Greatest velocity that the motor can physically have, rad/s: a position that would need more is not
    /// believed. A third above the axis's `max_velocity` where absent.
    #[serde(default)]
    pub plausible_velocity: Option<f64>,
    /// Greatest acceleration that it can physically have, rad/s², for the same purpose. Twenty times the
    /// axis's `max_acceleration` where absent.
    #[serde(default)]
    pub plausible_acceleration: Option<f64>,
}

/// A position loop that the host closes. What it puts out is, of an axis controller, torque, N·m, under `control =
/// "current"`, and a share of the full pulse width, -1 to 1, under `control = "pwm"`; of a drive on CAN velocity, rad/s,
/// under `control = "velocity"`, and torque, N·m, under `control = "torque"`.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Loop {
    /// From position error to output.
    pub law: Law,
    /// What the commanded motion needs, put out beforehand.
    #[serde(default)]
    pub feed_forward: FeedForward,
    /// Measured motor velocity, rad/s, that no working loop reaches: beyond it the power is taken at once. Above
    /// the axis's `max_velocity`; 1.2 times that where absent.
    #[serde(default)]
    pub runaway_velocity: Option<f64>,
}

/// A control law.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// The law of the IRp-6: two zeros, one pole, one integrator, in encoder counts and periods.
    Incremental(Incremental),
    /// Proportional position loop over a proportional-integral velocity loop.
    Cascade(Cascade),
    /// Proportional-integral position loop, for a drive that closes the velocity loop itself.
    Proportional(Proportional),
}

/// Coefficients of `gain (b0 - b1/z) ((1 + eps) - (1 - eps)/z) / ((1 - 1/z) (1 - a/z))`, which acts on the position
/// error in counts; they hold for one servo period.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Incremental {
    /// Pole, from 0 to below 1.
    pub a: f64,
    /// Weight of the filtered error.
    pub b0: f64,
    /// Weight of the filtered error one period ago.
    pub b1: f64,
    /// How far the first zero lies from 1, about half of it.
    pub eps: f64,
    /// Whether the position error is integrated; a lead filter otherwise, in which eps means nothing.
    #[serde(default = "super::defaults::yes")]
    pub integral: bool,
    /// Output per unit of the law's own.
    pub gain: f64,
    /// The most that is put out either way.
    pub limit: f64,
}

/// Gains of `velocity_gain (1 + integral_rate / s) (position_gain + s)`, which acts on the position error in rad.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cascade {
    /// Velocity asked for per position error, 1/s.
    pub position_gain: f64,
    /// Output per velocity error, 1/(rad/s).
    pub velocity_gain: f64,
    /// How fast the velocity error is integrated, 1/s; zero for not at all.
    pub integral_rate: f64,
    /// The most that is put out either way.
    pub limit: f64,
}

/// Gains of `position_gain (1 + integral_rate / s)`, which acts on the position error in rad.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Proportional {
    /// Velocity per position error, 1/s: about the crossover, rad/s. Some fifth of what the drive's velocity loop
    /// passes, and less than 0.1 per delay from sample to effect (two and a half periods on CAN).
    pub position_gain: f64,
    /// How fast the position error is integrated, 1/s; zero for not at all.
    #[serde(default)]
    pub integral_rate: f64,
    /// The most that is put out either way, rad/s.
    pub limit: f64,
}

/// Output that the commanded motion needs.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FeedForward {
    /// Per commanded velocity, output·s/rad: viscous friction, and back-EMF under `control = "pwm"`; 1 under `control =
    /// "velocity"`.
    pub velocity: f64,
    /// Per commanded acceleration, output·s²/rad: inertia; under `control = "velocity"` the lag of the drive's loop, s.
    pub acceleration: f64,
    /// In the sense of the commanded velocity: dry friction while sliding fast.
    pub coulomb: f64,
    /// The same at break-away, at least `coulomb`; `coulomb` where absent.
    pub stiction: Option<f64>,
    /// Velocity over which it falls from `stiction` to `coulomb`, rad/s: to 0.37 of the difference. Needed with
    /// `stiction`.
    pub stribeck_velocity: Option<f64>,
    /// Per torque, 1/(N·m), that the robot's `weight` takes: 1 where absent under `control = "current"` or `"torque"`;
    /// under `control = "pwm"` winding resistance / (torque constant * supply voltage).
    pub weight: Option<f64>,
    /// Always: the mean weight of the load, where the robot has no `weight`.
    pub constant: f64,
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
