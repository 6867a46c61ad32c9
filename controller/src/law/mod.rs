//! Force laws in the servo cycle: position-force control in a task frame, admittance, and motions that end at a touch.
//!
//! [`PositionForce`] is the [`CycleLaw`](servo::CycleLaw) of an arm with a force/torque sensor. A [`ForceTask`] is what
//! the law does during a macrostep: one [`Direction`] per axis of the task frame, and the [`Guard`] that ends the motion
//! at a touch. A task is sent as the parameters of a macrostep ([`servo::Macrostep::law`]).
//!
//! # Law
//! With inertia M, reciprocal damping β, desired force F_d, desired velocity v_d, stiffness K of the admittance, measured
//! force F, displacement x from the path, and period T, each direction has in each cycle the velocity
//!
//! ```text
//! v ← ((β (F_d − F − K x) + v_d) T + β M v) / (T + β M + β K T²)
//! ```
//!
//! This is the law of the MRROC++ controllers (K = 0). The inertia in the formula is a virtual mass, which is limited by
//! a virtual damper 1 / β: M dv/dt + v / β = F_d − F − K x + v_d / β. `F` is the force or torque that the tool applies
//! to its environment, in the task frame.
//!
//! The displacement x is kept from one instruction to the next under the same task with K > 0 in any direction
//! ([`CycleLaw::keeps`](servo::CycleLaw::keeps)). Otherwise x is zero where a motion begins.
//!
//! A direction without compliance moves at v_d, whatever the force is. The planned path of the macrosteps adds its own
//! motion in all directions, so a path has no motion in a direction of contact.
//!
//! # Speed override and pause
//! At a rate r of motion time below 1, the velocity β F_d + v_d of the approach is at most r times its value while F is
//! less than a quarter of F_d + v_d / β, the force in which the approach ends. From half of this force on, the law is the
//! same at every rate, except that a pull along the approach does not speed up the approach. [`velocity_at_rate`] is
//! this rule, for laws of other crates too.
//!
//! # Stability
//! For contact with an environment of stiffness k, the damping ratio is 1 / (2 β √(M k)): 1 at 500 N/m with the default
//! compliance. Delays limit the stiffness. With a delay of one sample and a lag of the position loops of 4 ms, a step of
//! the force settles within 4 s up to 34 kN/m at a period of 2 ms, and oscillations grow from 39 kN/m on. The same law in
//! a generator, once per macrostep of 10 periods, settles within 4 s up to about 18 kN/m. The tests of this module compute
//! these figures. In a whole cell, a step of a generator takes effect one macrostep later than in these tests, and the
//! example `force_table` measures 34 kN/m in the cycle and 9 kN/m in a generator.

mod directions;
mod position_force;
mod rate;
mod rehearsed;
mod resolve;

#[cfg(test)]
mod tests;

pub use directions::{Compliance, Direction, ForceTask, Guard, TaskAxes};
pub use position_force::{ForceLimits, PositionForce, PositionForceConfig, PositionForceError};
pub use rate::velocity_at_rate;
pub use rehearsed::RehearsedLaw;
