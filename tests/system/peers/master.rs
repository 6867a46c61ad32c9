//! python-canopen as the master of an emulated drive.

use std::path::Path;

use super::{Bus, python};
use crate::vcan::on_stage;

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
fn python_canopen_finds_an_emulated_drive_right_over_socketcan() {
    let test = "peers::master::python_canopen_finds_an_emulated_drive_right_over_socketcan";
    let Some(python) = python(test) else { return };
    on_stage(test, |stage| {
        let _emulators = stage.start_emulators();
        suite(&python, &Bus::socketcan(stage.interface));
    });
}
