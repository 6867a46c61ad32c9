//! A hardware watchdog of the host, behind the driver of its kernel: the watchdog is off after an orderly end of a run, and
//! expires after the controller was killed.

use std::time::Duration;

use ::mrroc::cell::Cell;
use hil::qemu::{Clock, MachineError, Options, run};
use kit::bench::{QEMU, kernel};
use kit::mrroc::{self, Directory, text};
use kit::processors;
use kit::slow;

/// The watchdog of the machine expires after 30 s.
const SCRIPT: &str = "
    chrt -f 70 \"$0\" emulate cell.toml --can vcan0 >/dev/null 2>&1 & sleep 1
    drive() { exec \"$0\" run cell.toml --bench vcan --can vcan0 >/dev/null 2>&1; }
    (drive); echo ended $?
    sleep 60; echo on
    drive & sleep 4; kill -9 $! && echo killed
    for second in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do sleep 1; done; echo on
    sleep 60; echo on";

#[test]
fn a_watchdog_of_the_host_expires_after_the_controller_was_killed_and_not_after_an_orderly_end() {
    let Some(kernel) = kernel("watchdog") else { return };
    let _share = processors::take(QEMU);
    let directory = Directory::new();
    let mut cell = Cell::parse(&text("irb6")).unwrap();
    slow::shorten(&mut cell);
    cell.watchdog = Some("/dev/watchdog".to_owned());
    directory.write("cell.toml", &toml::to_string(&cell).unwrap());
    let binary = mrroc::binary();
    let options = Options {
        directory: directory.path(""),
        visible: vec![mrroc::root().to_owned()],
        timeout: Duration::from_secs(600),
        ..Options::new(["sh".as_ref(), "-c".as_ref(), SCRIPT.as_ref(), binary.as_os_str()])
    };
    let mut output = Vec::new();
    let outcome = run(&kernel, Clock::Instructions, &options, &mut output);
    assert_eq!(outcome, Err(MachineError::Died.into()));
    assert_eq!(String::from_utf8_lossy(&output), "ended 0\non\nkilled\non\n");
}
