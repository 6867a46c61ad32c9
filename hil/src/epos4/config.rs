//! Configuration of one emulated EPOS4.

use std::time::Duration;

use can::Instant;
use canopen::NodeId;

use crate::plant::{AxisConfig, Mount};

/// What distinguishes one unit from another.
#[derive(Clone, Debug)]
pub struct Epos4Config {
    /// Its address; `None` for a unit that is to be given one by LSS, and says nothing before.
    pub node: Option<NodeId>,
    /// Object 0x1018:1; maxon is 0x0000_00FB.
    pub vendor: u32,
    /// Object 0x1018:2: hardware version << 16.
    pub product: u32,
    /// Object 0x1018:3.
    pub revision: u32,
    /// Object 0x1018:4.
    pub serial: u32,
    /// When it is switched on: no later than the first instant it is told of.
    pub power_on: Instant,
    /// From power-on or reset to the boot-up frame.
    pub boot_delay: Duration,
    /// From an SDO request to its answer.
    pub answer_delay: Duration,
    /// Bits 10 and 12 in the cyclic modes.
    pub cyclic_status: CyclicStatus,
    /// What happens when SYNC stays away.
    pub sync_loss: SyncLoss,
    /// Object 0x3000:05, quadrature counts per revolution; those of its encoder where `None`.
    pub main_sensor_resolution: Option<u32>,
    /// Object 0x6076, N·m, which its nominal current (0x3001:01) is reckoned from; that of the amplifier's
    /// greatest current where `None`.
    pub rated_torque: Option<f64>,
    /// Bits that stand in every statusword; EPOS2 has bit 8 in all its states.
    pub vendor_bits: u16,
    /// Decides noise and ripple.
    pub seed: u64,
    /// Motor, load, sensors and inner loops.
    pub axis: AxisConfig,
    /// Where its axis is mounted; `None` for a motor with a load of its own.
    pub mount: Option<Mount>,
}

impl Epos4Config {
    /// A Module 50/5 with firmware 0x0170 on this axis, quick to boot and to answer.
    pub fn new(node: NodeId, axis: AxisConfig) -> Self {
        Self {
            node: Some(node),
            vendor: 0x0000_00FB,
            product: 0x6150_0000,
            revision: 0x0170_0000,
            serial: 0x1000_0000 + u32::from(node.raw()),
            power_on: Instant::ZERO,
            boot_delay: Duration::from_millis(50),
            answer_delay: Duration::from_micros(300),
            cyclic_status: CyclicStatus::FollowsCommand,
            sync_loss: SyncLoss::Hold,
            main_sensor_resolution: None,
            rated_torque: None,
            vendor_bits: 0,
            seed: u64::from(node.raw()),
            axis,
            mount: None,
        }
    }
}

/// What the statusword shows in CSP, CSV and CST; EPOS4's documents do not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CyclicStatus {
    /// Bit 12 while set-points are followed, as CiA 402 has it.
    #[default]
    FollowsCommand,
    /// Neither bit 10 nor bit 12.
    Silent,
}

/// What a drive that follows cyclic set-points does when SYNC stays away.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SyncLoss {
    /// Position stays at the last set-point, velocity and torque go on.
    #[default]
    Hold,
    /// After this many interpolation periods (0x60C2) without SYNC, error 0x8250.
    Fault {
        /// Periods, at least 1.
        periods: u32,
    },
}
