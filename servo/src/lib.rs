//! The fixed-period cycle: `Servo::step(now)` = read → check → regulate → limit → write.
//!
//! A cell has one [`Servo`], which steps every effector on one tick grid; `thread` is the shell that
//! waits for deadlines, and nothing else here waits. The controller talks to it over an
//! [`EffectorLink`] a macrostep at a time.

mod link;
pub mod regulator;

pub use link::{EffectorLink, MAX_AXES, Macrostep, Order, Phase, Report, ServoFault, StopCause};
