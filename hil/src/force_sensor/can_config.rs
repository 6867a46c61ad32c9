//! Configuration of a force/torque sensor on a CAN bus.

use std::time::Duration;

use can::Instant;
use canopen::NodeId;

use super::TransducerConfig;
use crate::node::BOOT_DELAY;

/// Configuration of one sensor on a CAN bus.
#[derive(Clone, Debug)]
pub struct CanForceSensorConfig {
    /// Node-ID of the unit. With `None`, the unit sends nothing until LSS assigns a node-ID.
    pub node: Option<NodeId>,
    /// Object 0x1018:1; 0 is no registered vendor.
    pub vendor: u32,
    /// Object 0x1018:2.
    pub product: u32,
    /// Object 0x1018:3.
    pub revision: u32,
    /// Object 0x1018:4.
    pub serial: u32,
    /// Time of power-on: no later than the first instant passed to the device.
    pub power_on: Instant,
    /// Delay from power-on or reset to the boot-up frame.
    pub boot_delay: Duration,
    /// Delay from an SDO request to its answer.
    pub answer_delay: Duration,
    /// Errors and range of the transducer.
    pub transducer: TransducerConfig,
    /// Objects that the TPDOs carry after a reset. A host can map other objects.
    pub width: CountWidth,
    /// Scale of the 16-bit counts (object 0x2000).
    pub resolution_16: Resolution,
    /// Scale of the 32-bit counts (object 0x2001).
    pub resolution_32: Resolution,
    /// Time between two samples that SDO answers and event-driven TPDOs carry. Each SYNC takes an additional sample.
    pub sample_period: Duration,
}

/// Width of the counts in the TPDOs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CountWidth {
    /// Three counts of 16 bits per TPDO: forces in TPDO 1, torques in TPDO 2.
    Bits16,
    /// Two counts of 32 bits per TPDO, in TPDOs 1 to 3: a CAN frame has eight bytes.
    Bits32,
}

/// Scale of counts. Object 0x2004 of the sensor has these values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// Force of one count, µN.
    pub force_micronewtons: u32,
    /// Torque of one count, µN·m.
    pub torque_micronewton_metres: u32,
}

impl Resolution {
    /// Force of one count, N.
    pub fn force(self) -> f64 {
        f64::from(self.force_micronewtons) * 1e-6
    }

    /// Torque of one count, N·m.
    pub fn torque(self) -> f64 {
        f64::from(self.torque_micronewton_metres) * 1e-6
    }
}

impl CanForceSensorConfig {
    /// A sensor with 16-bit counts of 0.02 N and 0.001 N·m, and 32-bit counts of 0.001 N and 0.00001 N·m. The sample
    /// period is 1 ms, the boot delay 50 ms, and the answer delay 300 µs.
    pub fn new(node: NodeId, transducer: TransducerConfig) -> Self {
        Self {
            node: Some(node),
            vendor: 0,
            product: 0x0000_0F76,
            revision: 0x0001_0000,
            serial: 0x3000_0000 + u32::from(node.raw()),
            power_on: Instant::ZERO,
            boot_delay: BOOT_DELAY,
            answer_delay: Duration::from_micros(300),
            transducer,
            width: CountWidth::Bits16,
            resolution_16: Resolution { force_micronewtons: 20_000, torque_micronewton_metres: 1000 },
            resolution_32: Resolution { force_micronewtons: 1000, torque_micronewton_metres: 10 },
            sample_period: Duration::from_millis(1),
        }
    }
}
