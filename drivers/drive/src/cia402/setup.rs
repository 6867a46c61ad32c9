//! Constant data of one drive.

use std::time::Duration;

use canopen::NodeId;
use canopen::cia402::Statusword;

use super::config::{AxisConfig, CyclicMode, GroupConfig};
use super::program::MAXON;
use crate::Scale;

/// One drive, its mode and its deadlines.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setup {
    pub(super) node: NodeId,
    pub(super) mode: CyclicMode,
    pub(super) scale: Scale,
    pub(super) rated_torque: f64,
    pub(super) plausible_velocity: f64,
    pub(super) period: Duration,
    pub(super) search_speed: f64,
    /// Bit 15 of the statusword reports the reference. The meaning of this bit is vendor-specific.
    tells_reference: bool,
    pub(super) tolerated_missing: u32,
    pub(super) heartbeat_lost_after: Duration,
    pub(super) transition_timeout: Duration,
}

impl Setup {
    pub(super) fn of(group: &GroupConfig, axis: &AxisConfig) -> Self {
        Self {
            node: axis.node,
            mode: axis.mode,
            scale: axis.scale,
            rated_torque: axis.rated_torque,
            plausible_velocity: axis.plausible_velocity,
            period: group.period,
            search_speed: axis.homing.search_speed,
            tells_reference: axis.identity.vendor == MAXON,
            tolerated_missing: group.tolerated_missing,
            heartbeat_lost_after: group.heartbeat_lost_after(),
            transition_timeout: group.transition_timeout,
        }
    }

    /// The statusword without bit 15, unless the drive is maxon's.
    pub(super) fn homing_word(&self, word: Statusword) -> Statusword {
        let told = self.tells_reference && word.epos_referenced();
        word.with(Statusword::EPOS_REFERENCED, told)
    }
}
