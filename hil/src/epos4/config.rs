//! Configuration of one emulated EPOS4.

use std::time::Duration;

use can::Instant;
use canopen::NodeId;

use crate::node::BOOT_DELAY;
use crate::plant::{AxisConfig, Mount};

/// Configuration of one unit.
#[derive(Clone, Debug)]
pub struct Epos4Config {
    /// Node-ID of the unit. `None`: LSS is to assign a node-ID, and the unit sends nothing before.
    pub node: Option<NodeId>,
    /// Object 0x1018:1; maxon is 0x0000_00FB.
    pub vendor: u32,
    /// Object 0x1018:2: hardware version << 16.
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
    /// Delay from an LSS request to its answer. A slave that handles LSS in a slow loop answers after tens of milliseconds.
    pub lss_delay: Duration,
    /// Object 0x3000:05, quadrature counts per revolution. `None`: the counts of the axis's encoder.
    pub main_sensor_resolution: Option<u32>,
    /// Object 0x6076, N·m, which gives the nominal current (0x3001:01). `None`: the torque at maximum current.
    pub rated_torque: Option<f64>,
    /// Bits set in every statusword. An EPOS2 sets bit 8 in all its states.
    pub vendor_bits: u16,
    /// Time at which the drive trips once with an over-current; never where absent. A drive whose motor has no power at
    /// this time trips when the motor gets power.
    pub trips_at: Option<Instant>,
    /// Deviations of the homing mode.
    pub homing: HomingDeviation,
    /// A contact at a digital input.
    pub contact: Option<DriveContact>,
    /// Seed of noise and ripple.
    pub seed: u64,
    /// Motor, load, sensors and inner loops.
    pub axis: AxisConfig,
    /// Mounting point of the axis. `None`: the motor carries a load of its own.
    pub mount: Option<Mount>,
}

/// How the homing mode of a drive (CiA 402-2 §11) deviates from that of the emulator.
///
/// CiA 402 demands of a drive that a rising start bit begins a search, and gives no time in which the statusword shows the
/// search.
#[derive(Clone, Copy, Debug, Default)]
pub struct HomingDeviation {
    /// The drive keeps the result of its last search until a restart, and shows the result in homing mode until this time
    /// after the start bit. `None`: the drive drops the result when it leaves homing mode or power.
    pub old_result: Option<Duration>,
    /// The start bit begins no search.
    pub never_searches: bool,
    /// Time from the first success in the statusword until the position shows the counter that the search set.
    pub counter_late: Duration,
}

/// A contact at a digital input of a drive, closed at first.
#[derive(Clone, Debug)]
pub struct DriveContact {
    /// Bit of object 0x60FD, set while the contact is closed.
    pub bit: u8,
    /// Times at which the contact changes, ascending.
    pub edges: Vec<Instant>,
}

impl DriveContact {
    /// The bits of object 0x60FD at `now`.
    pub(super) fn levels(&self, now: Instant) -> u32 {
        let changes = self.edges.iter().take_while(|&&edge| edge <= now).count();
        u32::from(changes % 2 == 0) << self.bit
    }
}

impl Epos4Config {
    /// A Module 50/5 with firmware 0x0170 on this axis, with short boot and answer delays.
    pub fn new(node: NodeId, axis: AxisConfig) -> Self {
        Self {
            node: Some(node),
            vendor: 0x0000_00FB,
            product: 0x6150_0000,
            revision: 0x0170_0000,
            serial: 0x1000_0000 + u32::from(node.raw()),
            power_on: Instant::ZERO,
            boot_delay: BOOT_DELAY,
            answer_delay: Duration::from_micros(300),
            lss_delay: Duration::ZERO,
            main_sensor_resolution: None,
            rated_torque: None,
            vendor_bits: 0,
            trips_at: None,
            homing: HomingDeviation::default(),
            contact: None,
            seed: u64::from(node.raw()),
            axis,
            mount: None,
        }
    }
}
