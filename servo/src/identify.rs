//! The frequency response of an axis from what a servo recorded of it, and the numbers that tell a good loop.
//!
//! An axis whose position loop the servo closes is excited at its plant: of what the law puts out and what the
//! drive then gets, the open loop is the ratio, with its sign turned. This holds whatever else acts on the axis
//! that does not repeat with the excitation, and does not disturb the law.
//!
//! Where the drive closes the loop, it is excited through the drive, if that takes a torque beside the position (object
//! 0x60B2, added to what its velocity loop asks for). Of the torque added and the whole one that it then shows (0x6077),
//! the loop as cut at the torque follows: all of the drive's loops at once, and with it the crossover of the fastest and
//! the margin of all. What the drive holds and when it samples is taken out, for which its own period has to be known; half
//! of that period, if it is not, is taken for delay of the loop. If the drive takes no torque, the command is excited,
//! and what is seen is the closed loop: how the sample follows the command that it shows the effect of,
//! [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before.
//!
//! A motor that turns round meanwhile is damped by dry friction, and has more margin than its loop: 12° more at a light
//! axis by a chirp of the greatest torque. A lower amplitude or a higher velocity shows it.
//!
//! An axis is measured while it moves one way at constant velocity ([`Run`]), since dry friction holds one
//! that stands. Sequences are periodic, and every two periods in a row are transformed under a Hann window: it parts
//! neighbouring lines, weighs every part of a sequence alike, and keeps out what drifts (Pintelon and Schoukens, System
//! Identification, 2012, chapter 2). How far these blocks agree is the coherence; since they overlap it flatters a little.
//!
//! # The loops of the families
//!
//! On the emulated benches with nominal motors, measured by `mrroc identify` at 10 rad/s of the motor and a period of
//! 2 ms; the first rows are of the column, and `tests/system/identify.rs` and `tests/system/loops` hold them.
//!
//! | family | loop | gains | crossover, Hz | margin |
//! |---|---|---|---|---|
//! | IRp-6's own by current, its axes | incremental law, servo at delay 1 | [`IRP6`](crate::regulator::IRP6) | 53.6, 22.9, 34.8, 21.9, 74.6, 7.3 | 47.7°, 78.1°, 77.5°, 82.3°, 8.4°, 52.9° |
//! | IRb-6, serial, by current | cascade, delay 2 | 25 / s, 100 J / s, 10 / s | 16.8 | 48.2° |
//! | IRb-6, serial, by pulse width (wrist roll) | cascade, delay 2 | the same per duty, integral at the motor's pole | 15.7 | 51.6° |
//! | CiA 402 by torque (CST), as for the RNT | cascade, delay 3 | two thirds of the serial ones | 11.2 | 47.5° |
//! | CiA 402 by velocity (CSV), as for the RNT | proportional, delay 3 | 50 / s | 8.4 | 82.3° |
//! | CiA 402 by position (CSP): the IRb-6's axes | the drive's: velocity loop at 45 Hz, position at a fifth | the drive's | 46.4, 48.6, 40.4, 48.9, 52.0 | 35.6°, 37.4°, 38.9°, 37.7°, 40.6° |
//!
//! From sample to effect two periods pass on CAN and one on a serial line; with half a period of hold and
//! half of the velocity's difference that is 6 ms and 4 ms at 2 ms. Hence the two thirds: delay times bandwidth, and
//! with it the margin, stay the same.
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
