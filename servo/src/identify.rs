//! The frequency response of an axis from what a servo recorded of it, and the numbers that tell a good loop.
//!
//! An axis whose position loop the servo closes is excited at its plant: of what the law puts out and what the
//! drive then gets, the open loop is the ratio, with its sign turned. This holds whatever else acts on the axis
//! that does not repeat with the excitation, and does not disturb the law. Where the drive closes the loop, the command is excited, and
//! what is seen is the closed loop: how the sample follows the command that it shows the effect of,
//! [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before.
//!
//! An axis is measured while it moves one way at constant velocity ([`Run`]), since dry friction holds one
//! that stands. Sequences are periodic and every period is transformed by itself under a Hann window, which parts
//! lines two bins apart and keeps what drifts out of them (Pintelon and Schoukens, System Identification, 2012,
//! chapter 2); how far the periods agree is the coherence.
//!
//! Nothing here moves anything: [`Servo::excite`](crate::Servo::excite) does, by the [`Excitation`](crate::Excitation)
//! it is given.

mod response;
mod run;
mod sequence;
#[cfg(test)]
mod tests;

pub use response::{Margin, Point, Response, bandwidth, margin, respond};
pub use run::{Run, Trace};
pub use sequence::{chirp, lines, multisine};
