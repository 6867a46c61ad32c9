//! Frequency response of an axis, computed from the records of a servo, and the crossover and margin of its loop.
//!
//! An axis whose position loop the servo closes is excited at the input of its plant. The open loop is the ratio of the
//! law's output to the drive's input, with its sign reversed. A disturbance does not change the ratio if it is not
//! periodic with the excitation and does not saturate the law.
//!
//! A loop that the drive closes is excited by a torque added to the torque of the drive's velocity loop (object
//! 0x60B2), where the drive has that object. The open loop, cut at the torque, follows from the added torque and the
//! whole torque of the drive (0x6077). This open loop contains all loops of the drive: its crossover is the crossover
//! of the fastest loop, and its margin is the margin of all loops together. Hold and sampling of the drive are
//! compensated, which requires the drive's own period. An unknown period counts as half a period of dead time. Without
//! 0x60B2, the command is excited, and the closed loop is measured. The closed loop is the response of the sample to
//! the command of [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before.
//!
//! Dry friction damps a motor that reverses during the excitation. The measured margin is then greater than the margin
//! of the loop: 12° greater for a light axis with a chirp of the greatest torque. Measure the true margin with a lower
//! amplitude or a higher velocity.
//!
//! An axis is measured while it moves at constant velocity ([`Run`]), since dry friction holds an axis at rest.
//! Sequences are periodic. Each pair of successive periods is a block, which is transformed under a Hann window. The
//! window separates neighbouring lines, gives every part of a sequence the same weight, and suppresses drift (Pintelon
//! and Schoukens, System Identification, 2012, chapter 2). The coherence is the agreement of the blocks. The blocks
//! overlap, so the coherence is slightly too high.
//!
//! # The loops of the families
//!
//! The values were measured by `mrroc identify` on the emulated benches with nominal motors, at a motor velocity of 10
//! rad/s and a period of 2 ms. Rows with one value are for the column, or for the axis named in the row.
//! `tests/system/identify.rs` and `tests/system/loops` hold the figures.
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
//! From sample to effect, two periods pass on CAN and one period on a serial line. The hold adds half a period, and
//! the velocity difference another half. At a period of 2 ms, the total delay is 6 ms on CAN and 4 ms on a serial
//! line. The gains on CAN are therefore two thirds of the serial ones: the product of delay and bandwidth, and with it
//! the margin, stays the same.
//!
//! This module only evaluates records. [`Servo::excite`](crate::Servo::excite) excites the axis by an
//! [`Excitation`](crate::Excitation).

mod response;
mod run;
mod sequence;
#[cfg(test)]
mod tests;

pub use response::{Margin, Point, Response, bandwidth, margin, respond};
pub use run::{Run, Trace};
pub use sequence::{chirp, lines, multisine};
