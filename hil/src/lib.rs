//! The other side of the wire: it shares frame layouts with the drivers and nothing else.
//!
//! A [`Device`] is what hangs on a bus; the [virtual bus](bus) carries frames between devices and
//! the host with true arbitration and bit times, a [`World`] is all the buses of a cell, and a
//! [plant] is the physics behind a device. Of devices there are the axis controller [`Epos4`] and the
//! adapter [`SlcanDevice`], by which a host without a CAN card reaches a bus. Read [`Device`] and
//! [`World`] first.

mod amplifier;
pub mod bus;
mod device;
pub mod epos4;
pub mod plant;
pub mod pty;
mod slcan;
pub mod uml;
mod world;

pub use amplifier::AmplifierConfig;
pub use bus::BusStatistics;
pub use device::Device;
pub use epos4::{Epos4, Epos4Config};
pub use plant::{Axis, AxisConfig, Demand, Feedback, Irp6Axis, PlantConfig, Trip};
pub use pty::{Pty, PtyError};
pub use slcan::{Acknowledge, SlcanConfig, SlcanCounts, SlcanDevice};
pub use world::{BusId, DeviceId, World};
