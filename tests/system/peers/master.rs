//! python-canopen as the master of an emulated drive.

use std::path::Path;
use std::time::Duration;

use super::serial::attach;
use super::{Bus, python};
use crate::adapter::{Adapter, drive};
use crate::bench::on_vcan;
use crate::vcan::on_stage;

/// From a request to its answer, as real drives have it.
const ANSWER_DELAY: Duration = Duration::from_micros(300);

/// Every check of the suite holds on this bus.
fn suite(python: &Path, bus: &Bus) {
    let output = bus.script(python, "master.py").output().unwrap();
    let (said, complained) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{said}\n{complained}");
    println!("{said}");
}

#[test]
fn python_canopen_finds_an_emulated_drive_right_over_slcan() {
    let test = "peers::master::python_canopen_finds_an_emulated_drive_right_over_slcan";
    let Some(python) = python(test) else { return };
    Adapter::new(Some(drive(ANSWER_DELAY))).served(|tty| suite(&python, &Bus::slcan(tty)));
}

#[test]
fn python_canopen_finds_an_emulated_drive_right_over_the_kernels_slcan() {
    let test = "peers::master::python_canopen_finds_an_emulated_drive_right_over_the_kernels_slcan";
    let Some(python) = python(test) else { return };
    on_vcan(test, |_| {
        Adapter::new(Some(drive(ANSWER_DELAY))).served(|tty| {
            let slcan = attach(tty, "slcan0");
            suite(&python, &Bus::socketcan(slcan.interface));
        });
    });
}

#[test]
fn python_canopen_finds_an_emulated_drive_right_over_socketcan() {
    let test = "peers::master::python_canopen_finds_an_emulated_drive_right_over_socketcan";
    let Some(python) = python(test) else { return };
    on_stage(test, |stage| {
        let _emulators = stage.start_emulators();
        suite(&python, &Bus::socketcan(stage.interface));
    });
}
