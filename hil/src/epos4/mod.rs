//! An EPOS4-class axis controller: CiA 301 and CiA 402 as a maxon EPOS4 speaks them on CAN.
//!
//! [`Epos4`] is a [`Device`] with a [`PlantAxis`] and its physics. Its communication is that of all emulated nodes. The
//! drive has power states with their option codes and the modes PP, PV, HM, CSP, CSV and CST. The object dictionary is
//! one table.
//!
//! Facts come from EPOS4's electronic data sheet and communication guide. CiA 301 and CiA 402 fill the gaps of these
//! documents, and the emulator chooses the rest. The comments of its data sheet ([`Epos4::eds`], `mrroc eds`) list
//! the choices. Further choices:
//!
//! * In the cyclic modes, bit 12 of the statusword is set while set-points are followed, as in CiA 402.
//! * When SYNCs are missing, the position stays at the last set-point. Velocity and torque continue.
//! * An error of communication ends when the missing frame is received again.
//! * Within a SYNC, TPDOs are sampled before RPDOs take effect.
//!
//! A bit rate configured by LSS is accepted without effect. Left out: storage to a file.
//!
//! The drive runs at 1 kHz. It is advanced lazily, when a frame or a time-out needs its state. A device whose host
//! sends SYNC therefore needs no computing time between SYNCs. A drive of a robot in a scene advances with the scene.

mod application;
mod config;
mod drive;
mod eds;
mod errors;
mod homing;
mod power;
mod profile;
mod service;
mod table;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use can::{Frame, Instant};

use crate::node::objects::Objects;
use crate::node::table::Slot;
use crate::node::{Identity, Node, NodeConfig};
use crate::plant::AngleProbe;
use crate::{Device, DeviceFault, PlantAxis};
pub use config::{DriveContact, Epos4Config, HomingDeviation};
use drive::Drive;
use table::{TABLE, slot};

/// Values of one unit that replace the table's defaults.
fn identity(config: &Epos4Config) -> [(Slot, u32); 8] {
    let amps = config.axis.amplifier.max_current;
    let torque_constant = config.axis.plant.torque_constant();
    let milliamps = |amps: f64| (amps * 1e3).round() as u32;
    let rated = config.rated_torque.unwrap_or(amps * torque_constant);
    // Nominal current in whole milliamperes. The torque constant compensates for the rounding error, which matters
    // for small motors.
    let nominal = milliamps(rated / torque_constant).max(1);
    let torque_constant = (rated / f64::from(nominal) * 1e9).round() as u32;
    let counts = config.axis.counts_per_revolution;
    [
        (slot!(VENDOR_ID), config.vendor),
        (slot!(PRODUCT_CODE), config.product),
        (slot!(REVISION), config.revision),
        (slot!(SERIAL_NUMBER), config.serial),
        (slot!(EPOS4_MAIN_SENSOR_RESOLUTION), config.main_sensor_resolution.unwrap_or(counts)),
        (slot!(EPOS4_NOMINAL_CURRENT), nominal),
        (slot!(EPOS4_NOMINAL_CURRENT).plus(1), milliamps(amps)),
        (slot!(EPOS4_TORQUE_CONSTANT), torque_constant),
    ]
}

/// An emulated axis controller.
pub struct Epos4 {
    node: Node<Drive>,
}

impl Epos4 {
    /// A device switched on at [`Epos4Config::power_on`].
    #[expect(clippy::needless_pass_by_value, reason = "a device owns its configuration, as the other devices do")]
    pub fn new(config: Epos4Config) -> Self {
        let node = NodeConfig {
            id: config.node,
            identity: Identity {
                vendor: config.vendor,
                product: config.product,
                revision: config.revision,
                serial: config.serial,
            },
            power_on: config.power_on,
            boot_delay: config.boot_delay,
            answer_delay: config.answer_delay,
            lss_delay: config.lss_delay,
        };
        let objects = Objects::new(Cow::Borrowed(TABLE.as_slice()), config.node, &identity(&config));
        Self { node: Node::new(node, objects, Drive::new(&config)) }
    }

    /// A probe of the motor shaft, for example for a [`LightGate`](crate::LightGate).
    pub fn probe(&mut self) -> AngleProbe {
        self.node.application.axis.probe()
    }

    /// The simulated axis, including state that no drive can measure.
    pub fn axis(&self) -> &PlantAxis {
        &self.node.application.axis
    }
}

impl Device for Epos4 {
    fn hears(&self, frame: &Frame) -> bool {
        self.node.hears(frame)
    }

    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.node.handle(frame, now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.node.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.node.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.node.handle_timeout(now);
    }

    fn advance_mechanics(&mut self, now: Instant) -> bool {
        self.node.advance_mechanics(now)
    }

    fn set_fault(&mut self, fault: DeviceFault, on: bool, now: Instant) -> bool {
        match fault {
            DeviceFault::Reset if on => self.node.restart(now),
            DeviceFault::Reset => {}
            DeviceFault::PowerOff => self.node.set_power(!on, now),
            DeviceFault::Unplugged
            | DeviceFault::AnswersFrozen
            | DeviceFault::AnswersOld
            | DeviceFault::AnswersReversed
            | DeviceFault::AnswersGarbled => return false,
        }
        true
    }

    fn plant(&self) -> Option<&PlantAxis> {
        Some(self.axis())
    }

    fn plant_mut(&mut self) -> Option<&mut PlantAxis> {
        Some(&mut self.node.application.axis)
    }
}
