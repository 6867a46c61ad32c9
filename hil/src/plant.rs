//! Plants: the physics behind an emulated axis controller, from motor windings to limit switches.
//!
//! Read [`Axis`] first: one motor with its load, its sensors and the inner loops of its drive, moved on in sub-steps
//! of 100 µs. Below it stand two plants: [`Wut`], the toy that the robots' own software emulated its hardware with,
//! kept as the regression model, and [`MotorConfig`], a motor with windings, friction, gravity, end stops and
//! temperature. [`AxisConfig::irp6`] and its neighbours fill in the numbers of the lab's robots. A motor on its own
//! carries a constant inertia and a weight that depends on its own angle. The axes of one robot are mounted on a
//! [`Mechanism`], which couples their weights and carries payloads.
//!
//! Everything is SI and at the motor shaft. A run is a function of configuration, seed and demands,
//! the same bit for bit each time on one build. Left out: elastic gears, backlash, forces between axes
//! beside what a [`Mechanism`] has, PWM ripple and dead band.

mod axis;
mod encoder;
mod friction;
mod irp6;
mod lab;
mod mechanism;
mod motor;
mod noise;
mod switch;
mod thermal;
mod wut;

pub use axis::{Axis, AxisConfig, Demand, Feedback, PlantConfig, Trip};
pub use friction::FrictionConfig;
pub use irp6::Irp6Axis;
pub use lab::Irp6TrackAxis;
pub use mechanism::{Load, Mechanism, MechanismConfig, Mount};
pub use motor::{EndStops, Gravity, MotorConfig};
pub use noise::Noise;
pub use switch::Switch;
pub use thermal::ThermalConfig;
pub use wut::{Wut, WutConfig};

/// The integration step of every plant in an [`Axis`], s.
///
/// Against a reference of 10 µs an IRp-6 motor under its servo loop is off by 0.06 counts at this
/// step and by 1.4 counts at the 2 ms of the servo period.
pub const SUB_STEP: f64 = 1e-4;

#[cfg(test)]
mod tests;
