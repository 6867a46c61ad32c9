//! python-canopen as the master of an emulated drive.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use kit::bench::on_vcan;
use kit::by_the_clock;
use kit::mrroc::{Directory, Running};

use super::serial::attach;
use super::{Bus, judged, python};
use crate::vcan::{on_stage, wait_until};

/// Shortest delay that disturbs a script.
const SLOW: Duration = Duration::from_millis(20);

/// The drives of an arm behind an emulated adapter, and the symbolic link to its tty.
struct Emulated {
    link: PathBuf,
    _emulators: Running,
    _directory: Directory,
}

impl Emulated {
    fn start() -> Self {
        let directory = Directory::new();
        let cell = directory.cell("irb6", |_| {});
        let link = directory.path("adapter");
        let arguments = [OsStr::new("emulate"), cell.as_os_str()];
        let slcan = [OsStr::new("--slcan"), link.as_os_str()];
        let emulators = Running::start(arguments.into_iter().chain(slcan));
        wait_until("the link to the tty is there", || link.exists());
        Self { link, _emulators: emulators, _directory: directory }
    }
}

/// Runs the suite and asserts that every check passes on this bus.
fn suite(python: &Path, bus: &Bus) {
    judged(&mut bus.script(python, "master.py"));
}

#[test]
fn python_canopen_finds_an_emulated_drive_right_over_slcan() {
    let test = "peers::master::python_canopen_finds_an_emulated_drive_right_over_slcan";
    let Some(python) = python(test) else { return };
    by_the_clock(0.7, SLOW, || {
        let emulated = Emulated::start();
        suite(&python, &Bus::slcan(&emulated.link));
    });
}

#[test]
fn python_canopen_finds_an_emulated_drive_right_over_the_kernels_slcan() {
    let test = "peers::master::python_canopen_finds_an_emulated_drive_right_over_the_kernels_slcan";
    let Some(python) = python(test) else { return };
    on_vcan(test, |_| {
        let emulated = Emulated::start();
        let slcan = attach(&emulated.link, "slcan0");
        suite(&python, &Bus::socketcan(slcan.interface));
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
