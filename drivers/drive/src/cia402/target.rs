//! Targets in the units of a drive.

use super::config::{AxisConfig, CyclicMode};
use crate::{Finite, Permille, Refusal, Setpoint};

/// Target of a drive, in the drive's units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Target {
    /// Target position (increments), velocity (rpm) or torque (thousandths of the rated torque, within 16 bits).
    pub(super) value: i32,
    /// Torque offset (0x60B2), which the drive adds to the torque demand (CiA 402-2 §17.4).
    pub(super) torque: Permille,
}

impl Target {
    /// Converts a set-point to the target of the drive of `axis`; `None` beyond the drive's range.
    pub(super) fn of(setpoint: Setpoint, axis: &AxisConfig) -> Result<Option<Self>, Refusal> {
        let AxisConfig { mode, scale, .. } = axis;
        let at = |position: Finite| scale.increments(position.get());
        let permille = |torque: Finite| scale.permille(torque.get(), axis.rated_torque);
        Ok(match (mode, setpoint) {
            (CyclicMode::Csp | CyclicMode::CspWithTorque, Setpoint::Position(position)) => {
                at(position).map(|increments| increments.0.into())
            }
            (CyclicMode::CspWithTorque, Setpoint::PositionWithTorque { position, torque }) => {
                let both = at(position).zip(permille(torque));
                both.map(|(increments, torque)| Self { value: increments.0, torque })
            }
            (CyclicMode::Csv, Setpoint::Velocity(velocity)) => scale.rpm(velocity.get()).map(|rpm| rpm.0.into()),
            (CyclicMode::Cst, Setpoint::Torque(torque)) => {
                permille(torque).map(|permille| i32::from(permille.0).into())
            }
            (
                CyclicMode::Csp | CyclicMode::CspWithTorque | CyclicMode::Csv | CyclicMode::Cst,
                Setpoint::Position(_)
                | Setpoint::PositionWithTorque { .. }
                | Setpoint::Velocity(_)
                | Setpoint::Torque(_)
                | Setpoint::Duty(_),
            ) => return Err(Refusal::WrongKind),
        })
    }
}

impl From<i32> for Target {
    fn from(value: i32) -> Self {
        Self { value, torque: Permille(0) }
    }
}
