//! The other side of the wire: it shares frame layouts with the drivers and nothing else.
//!
//! A [`Device`] is what hangs on a bus; the virtual bus carries frames between devices and the host
//! with true arbitration and bit times, and a plant is the physics behind a device.

mod amplifier;
mod device;
pub mod plant;
pub mod uml;

pub use amplifier::AmplifierConfig;
pub use device::Device;
pub use plant::{Axis, AxisConfig, Demand, Feedback, Irp6Axis, PlantConfig, Trip};
