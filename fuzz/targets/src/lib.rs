//! Bodies of the fuzz targets. Each takes arbitrary bytes and panics where an invariant is broken.
//!
//! `cargo fuzz run NAME` in `fuzz` searches for such bytes. The test `corpus` of this crate plays the corpus and seeded
//! variations of it. An input is a text or a stream as a device sends it, or the description of a sequence of steps
//! ([`arbitrary`]). Sequences are bounded, so each call ends after a bounded number of steps.
//!
//! The invariants: no panic, no endless wait, only finite numbers, bounded queues, and what can be read back is equal.
#![allow(clippy::unwrap_used, reason = "a broken assumption of a target is a finding")]

mod bus;
mod camera;
mod clients;
mod devices;
mod drivers;
mod frames;
mod layouts;
mod lines;
mod recordings;
mod texts;

pub use bus::can_bus;
pub use camera::camera;
pub use clients::{epos_service, lss_master, sdo_client};
pub use devices::can_devices;
pub use drivers::{axis_controllers, serial_sensors};
pub use layouts::layouts;
pub use lines::slcan;
pub use recordings::recording;
pub use texts::{cell, eds, scenario, text_lines, urdf};

/// A target: its name and its body.
pub type Target = (&'static str, fn(&[u8]));

/// All targets, in the order of their names.
pub const TARGETS: [Target; 16] = [
    ("axis_controllers", axis_controllers),
    ("camera", camera),
    ("can_bus", can_bus),
    ("can_devices", can_devices),
    ("cell", cell),
    ("eds", eds),
    ("epos_service", epos_service),
    ("layouts", layouts),
    ("lss_master", lss_master),
    ("recording", recording),
    ("scenario", scenario),
    ("sdo_client", sdo_client),
    ("serial_sensors", serial_sensors),
    ("slcan", slcan),
    ("text_lines", text_lines),
    ("urdf", urdf),
];
