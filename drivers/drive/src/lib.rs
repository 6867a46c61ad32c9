//! The contract between the servo and the drives behind one port, the owner of a CAN bus, and one module per device
//! family.
//!
//! Read [`DriveGroup`] first. All positions are positions of the **motor shaft**, rad (m for a linear motor). The
//! drive trains of `controller` convert joint positions to motor positions. [`Scale`] is the only place that converts
//! motor positions to the units of a device.

pub mod axis_controller;
pub mod bus;
pub mod camera;
pub mod cia401;
pub mod cia402;
mod command;
pub mod device;
mod fault;
mod group;
pub mod latest;
mod remedies;
mod scale;
mod state;
mod step_check;
pub mod ultrasonic;
mod warning;
mod word;
pub mod wrench;

pub use command::{AxisCommand, Finite, Setpoint};
pub use fault::{BringUpError, Fault, Refusal};
pub use group::{DriveGroup, EmergencyStop, GroupCounters};
pub use scale::{Increments, Scale};
pub(crate) use scale::{Milliamperes, Permille};
pub use state::{AxisState, Homing, Power, Switches};
pub use warning::{Warning, WarningCause, Warnings};
pub(crate) use word::Request;
pub use word::Word;
