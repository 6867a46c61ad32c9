//! Configuration of a bundle of axis controllers.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serial::{Settings, hi_moxa, nfv2};
use thiserror::Error;

use super::stream::{NFV2_ANSWER, NFV2_REQUEST};
use crate::{Milliamperes, Scale};

/// Bound of the counts that a motor may move in a cycle. A plausibility check cannot see a move of half the counter's
/// range.
const FARTHEST: f64 = (1 << 24) as f64;

/// What serial axis controllers speak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    // `serial::nfv2`.
    /// Framed and addressed, with a CRC-8.
    #[default]
    Nfv2,
    // `serial::hi_moxa`.
    /// The older one, without a checksum. Pulse widths only.
    HiMoxa,
}

/// What the axis controllers of a group have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupConfig {
    /// The servo period; a request and its answer must fit into it.
    pub period: Duration,
    /// What the drives speak.
    pub protocol: Protocol,
    /// How their lines are set; [`Settings::AXIS_CONTROLLER`].
    pub settings: Settings,
    /// Missing answers in a row that are tolerated. One more is a fault and an emergency stop. A refused answer counts as
    /// missing. The line may refuse as many set-points in a row. At least 1: an index pulse takes two answers.
    pub tolerated_missing: u32,
    /// Bring-up: how long an answer to one request may take, rounded up to calls of it.
    pub answer_timeout: Duration,
}

impl GroupConfig {
    /// As the laboratory ran its robots: 921600 8N2, a cycle of 2 ms, and the third missing answer in a row is an
    /// emergency stop.
    pub const fn new(protocol: Protocol) -> Self {
        Self {
            period: Duration::from_millis(2),
            protocol,
            settings: Settings::AXIS_CONTROLLER,
            tolerated_missing: 2,
            answer_timeout: Duration::from_millis(10),
        }
    }

    /// Refuses what cannot work before a byte is sent: all that
    /// [`AxisControllerGroup::new`](super::AxisControllerGroup::new) refuses.
    pub fn check(&self, axes: &[AxisConfig], lines: usize) -> Result<(), ConfigError> {
        if !(1..=usize::from(u8::MAX)).contains(&axes.len()) {
            return Err(ConfigError::Axes(axes.len()));
        }
        if axes.len() != lines {
            let axes = axes.len();
            return Err(ConfigError::Lines { axes, lines });
        }
        let (request, answer) = self.protocol.telegrams();
        let exchange = self.settings.line_time(request + answer);
        if exchange >= self.period {
            let period = self.period;
            return Err(ConfigError::Period { period, exchange });
        }
        if self.tolerated_missing == 0 {
            return Err(ConfigError::ToleratedMissing);
        }
        for (line, axis) in (0..).zip(axes) {
            check_axis(self, axis, line)?;
        }
        Ok(())
    }
}

/// One drive, its motor and its line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisConfig {
    /// Address on the line; 0 to 15 at the laboratory. Without meaning in [`Protocol::HiMoxa`].
    pub address: u8,
    /// Between motor positions and the drive's counts.
    pub scale: Scale,
    /// Torque constant of the motor, N·m/A.
    pub torque_constant: f64,
    /// What its set-points are.
    pub control: Control,
    /// Current at which the drive's protection acts, A, and the greatest that a set-point may ask for.
    pub max_current: f64,
    /// Greatest velocity that the motor can physically have, rad/s: no limit of motion, but that of the plausibility
    /// check of positions. A third above the limit of motion, for instance. A faster axis stops by a fault.
    pub max_velocity: f64,
    /// Greatest acceleration that the motor can physically have, rad/s², for the same check: the torque of the greatest
    /// current and of friction, over the inertia.
    pub max_acceleration: f64,
}

// These docs are those of the cell-file reference, where links into this crate lead nowhere. The set-points come from
// `Setpoint::Torque` and `Setpoint::Duty`.
/// What an axis controller is commanded by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Control {
    /// Motor current; its own loop keeps it. NFv2 only.
    #[default]
    Current,
    /// Pulse width: the share of the supply voltage that the motor gets.
    Pwm,
}

/// Why a group cannot be configured so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum ConfigError {
    #[error("a group has 1 to 255 axes, not {0}")]
    Axes(usize),
    #[error("{axes} axes need as many lines, not {lines}")]
    Lines { axes: usize, lines: usize },
    #[error("a period of {period:?} is too short for {exchange:?} of bytes on the line")]
    Period { period: Duration, exchange: Duration },
    #[error("the number of tolerated missing answers must be at least 1")]
    ToleratedMissing,
    #[error("line {line}: {quantity} is out of range")]
    OutOfRange { line: u8, quantity: Quantity },
    #[error("line {line}: control by current takes protocol nfv2; hi_moxa has pulse widths only")]
    NeedsNfv2 { line: u8 },
}

/// A quantity of an axis that has bounds in the drive or in the plausibility check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum Quantity {
    #[error("address")]
    Address,
    #[error("torque constant")]
    TorqueConstant,
    #[error("greatest current")]
    MaxCurrent,
    /// [`AxisConfig::max_velocity`]: a count to half of the counter per period.
    #[error("greatest velocity")]
    MaxVelocity,
    #[error("greatest acceleration")]
    MaxAcceleration,
}

impl Protocol {
    /// Its name in cell files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nfv2 => "nfv2",
            Self::HiMoxa => "hi-moxa",
        }
    }

    pub(super) const fn other(self) -> Self {
        match self {
            Self::Nfv2 => Self::HiMoxa,
            Self::HiMoxa => Self::Nfv2,
        }
    }

    /// Bytes of a cyclic request, and of the answer to it.
    pub const fn telegrams(self) -> (usize, usize) {
        match self {
            Self::Nfv2 => (NFV2_REQUEST, NFV2_ANSWER),
            Self::HiMoxa => (hi_moxa::CYCLIC_REQUEST, hi_moxa::ANSWER),
        }
    }
}

impl AxisConfig {
    /// Its greatest current; `None` if that is no current or beyond 16 bits.
    pub(super) fn limit(&self) -> Option<Milliamperes> {
        let torque = self.max_current * self.torque_constant;
        let signed = self.scale.milliamperes(torque, self.torque_constant)?;
        Some(Milliamperes(signed.0.abs())).filter(|limit| limit.0 > 0)
    }
}

fn check_axis(config: &GroupConfig, axis: &AxisConfig, line: u8) -> Result<(), ConfigError> {
    if config.protocol == Protocol::HiMoxa && axis.control == Control::Current {
        return Err(ConfigError::NeedsNfv2 { line });
    }
    let positive = |value: f64| value > 0.0 && value.is_finite();
    let reach = axis.max_velocity * config.period.as_secs_f64();
    let counts = |distance: f64| distance * axis.scale.increments_per_radian().abs();
    for (quantity, right) in [
        (Quantity::Address, config.protocol == Protocol::HiMoxa || axis.address < nfv2::MASTER),
        (Quantity::TorqueConstant, positive(axis.torque_constant)),
        (Quantity::MaxCurrent, axis.max_current > 0.0 && axis.limit().is_some()),
        (Quantity::MaxVelocity, positive(axis.max_velocity) && (1.0..FARTHEST).contains(&counts(reach))),
        (Quantity::MaxAcceleration, positive(axis.max_acceleration)),
    ] {
        if !right {
            return Err(ConfigError::OutOfRange { line, quantity });
        }
    }
    Ok(())
}
