//! Parts of the system tests that both executables share: the commands of `mrroc` as child processes, benches, cells
//! and rigs. Tests in virtual time are in `system/`, tests by the clock in `clock/`.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]
#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]
#![expect(missing_docs, reason = "the tests are the only users")]

pub mod adapter;
pub mod allocations;
pub mod bench;
pub mod camera;
pub mod cell;
pub mod closed_output;
pub mod disturbance;
pub mod doctor;
pub mod draw;
pub mod full_disk;
pub mod held_bar;
pub mod meetings;
pub mod motion;
pub mod mrroc;
pub mod processors;
pub mod reaction;
pub mod recordings;
pub mod refusals;
pub mod serial;
pub mod slow;
pub mod start_stop;
pub mod steps;
pub mod teach;
pub mod touch_cell;
pub mod wire;

pub use disturbance::{PERIOD, by_the_clock};
