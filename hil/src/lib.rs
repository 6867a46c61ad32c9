//! Emulated hardware at the far end of buses and lines. The only code shared with the drivers is the frame layouts.
//!
//! A [`Device`] is a node of a bus. The [virtual bus](bus) carries frames between devices and the host with true
//! arbitration and bit times. A [`LineDevice`] is the device at the end of a [serial line](mod@line), which carries
//! bytes with true byte times. A [`World`] contains all buses and lines of a cell. A [plant] is the physics behind a
//! device. A [scene] contains the bodies and surfaces around the robots. Four devices are attached to a bus: the axis
//! controller [`Epos4`], the input and output module [`DigitalIo`], the sensor [`CanForceSensor`], and the adapter
//! [`SlcanDevice`]. The adapter connects a host without a CAN card to a bus. The sensors at a line are
//! [`SerialForceSensor`], [`UltrasonicMatrix`], and devices of other crates ([`LineEmulator`]). A [`Camera`] has
//! neither bus nor line: it gives the bytes of a network connection. Read [`Device`] and [`World`] first.

mod amplifier;
pub mod axis_controller;
pub mod bus;
pub mod camera;
pub mod cia401;
mod device;
mod emulator;
pub mod epos4;
pub mod epos_serial;
pub mod force_sensor;
pub mod line;
mod machine;
mod node;
mod outbox;
pub mod plant;
pub mod pty;
pub mod qemu;
pub mod scene;
mod slcan;
pub mod ultrasonic;
pub mod uml;
mod world;

pub use amplifier::AmplifierConfig;
pub use axis_controller::{AxisController, AxisControllerConfig, Cabinet};
pub use bus::{FrameFault, Frames, HostFault};
pub use camera::Camera;
pub use cia401::{
    DigitalIo, DigitalIoConfig, DigitalIoError, InputEdge, InputProbe, LightGate, OutputProbe, OutputState,
};
pub use device::{Device, DeviceFault, LineDevice};
pub use emulator::{Answer, EmulatedOnLine, LineEmulator, Surroundings};
pub use epos_serial::{EposSerial, EposSerialConfig};
pub use epos4::{DriveContact, Epos4, Epos4Config, HomingDeviation};
pub use force_sensor::{
    CanForceSensor, CanForceSensorConfig, CountWidth, ForceSensorError, Resolution, SerialForceSensor,
    SerialForceSensorConfig, TemperatureCourse, TransducerConfig,
};
pub use line::{LineFaults, LineStatistics, Stuck, WireFaults};
pub use node::BOOT_DELAY;
pub use plant::{
    AngleProbe, AxisConfig, Demand, Feedback, Irp6Axis, Mechanism, MechanismConfig, Mount, PlantAxis, PlantConfig,
    PlantFault, Trip,
};
pub use pty::{Pty, PtyError};
pub use scene::{Scene, View, WrenchProbe};
pub use slcan::{SlcanCounts, SlcanDevice};
pub use ultrasonic::{EchoProbe, SceneEchoes, UltrasonicConfig, UltrasonicError, UltrasonicMatrix};
pub use world::{BusId, DeviceId, DriveId, FaultInEffect, Helpers, LineId, World, WorldFault};
