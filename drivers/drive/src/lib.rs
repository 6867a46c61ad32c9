//! The contract between the servo and the drives behind one port, and one file per device family.
//!
//! Read [`DriveGroup`] first. Positions are of the **motor shaft**, in rad (m for a linear motor):
//! the drive trains of `controller` turn joints into motors, and [`Scale`] turns motor positions
//! into what the device counts in, at one place.

pub mod axis_controller;
pub mod cia402;
mod command;
mod fault;
mod group;
mod scale;
mod state;
mod warning;

pub use command::{AxisCommand, Finite, Setpoint};
pub use fault::{BringUpError, Fault, Refusal};
pub use group::{DriveGroup, GroupCounters};
pub use scale::{Increments, Scale};
pub(crate) use scale::{Milliamperes, Permille};
pub use state::{AxisState, Homing, Power, Switches};
pub use warning::{Warning, Warnings};
