//! The other side of the wire: it shares frame layouts with the drivers and nothing else.
//!
//! A [`Device`] is what hangs on a bus; the [virtual bus](bus) carries frames between devices and
//! the host with true arbitration and bit times. A [`LineDevice`] is what hangs on a [serial
//! line](mod@line), which carries bytes in their true times. A [`World`] is all buses and lines of a
//! cell, and a [plant] is the physics behind a device. Of devices on a bus there are the axis
//! controller [`Epos4`] and the adapter [`SlcanDevice`], by which a host without a CAN card reaches
//! one. Read [`Device`] and [`World`] first.

mod amplifier;
pub mod axis_controller;
pub mod bus;
mod device;
pub mod epos4;
pub mod epos_serial;
pub mod line;
mod line_device;
mod machine;
mod outbox;
pub mod plant;
pub mod pty;
pub mod qemu;
mod slcan;
pub mod uml;
mod world;

pub use amplifier::AmplifierConfig;
pub use axis_controller::{
    AxisControllerConfig, Cabinet, HiMoxaAxisController, Nfv2AxisController,
};
pub use bus::BusStatistics;
pub use device::Device;
pub use epos_serial::{Epos2Serial, Epos4Serial, EposSerialConfig};
pub use epos4::{Epos4, Epos4Config};
pub use line::{LineFaults, LineStatistics, Stuck, WireFaults};
pub use line_device::LineDevice;
pub use outbox::Heard;
pub use plant::{
    Axis, AxisConfig, Demand, Feedback, Irp6Axis, Irp6TrackAxis, Mechanism, MechanismConfig, Mount,
    PlantConfig, Trip,
};
pub use pty::{Pty, PtyError};
pub use slcan::{Acknowledge, SlcanConfig, SlcanCounts, SlcanDevice};
pub use world::{BusId, DeviceId, LineId, World};
