//! Refusals for serial lines: one line that names the problem, its place and its cause; exit status 2; nothing is
//! enabled.

use std::fs;

use kit::mrroc::{Directory, mrroc, text};
use kit::refusals::refused;

/// A name, a text in the cell, the replacement of the text, and the required parts of the refusal.
type Case = (&'static str, &'static str, &'static str, &'static [&'static str]);

/// Cells with internal errors, and cells that do not match their drives.
const CELLS: &[Case] = &[
    (
        "current by the older protocol",
        "protocol = \"nfv2\"",
        "protocol = \"hi-moxa\"",
        &["robot[0].axis[0].controller.control: ", "use pwm"],
    ),
    (
        "a negative limit of the loop",
        "limit = 2.1",
        "limit = -2.1",
        &["loop.law.cascade.limit: is -2.1, must be between 0.002626 and 2.625"],
    ),
    (
        "a limit that no current reaches",
        "limit = 2.1",
        "limit = 2.7",
        &["loop.law.cascade.limit: is 2.7", "max_current * torque_constant at the most"],
    ),
    (
        "more than the full pulse width",
        "limit = 0.745",
        "limit = 1.1",
        &["axis[4].controller.loop.law.cascade.limit: is 1.1"],
    ),
    (
        "a drive's homing",
        "homing = { order",
        "homing = { method = 37, order",
        &["axis[0].homing.method: ", "homed by the host"],
    ),
    ("two axes on one line", "/dev/ttyMI9", "/dev/ttyMI8", &["axis[1].controller: line \"/dev/ttyMI8\" is used twice"]),
    (
        "a slow line",
        "protocol = \"nfv2\"",
        "protocol = \"nfv2\"\nbaud = 115200",
        &["serial[0].baud: ", "3246 µs of each 2000 µs"],
    ),
    (
        "a CAN drive",
        "controller = { line",
        "drive = { vendor = 1, counts_per_revolution = 4000, rated_torque = 0.4 }\ncontroller = { line",
        &["axis[0].drive: ", "not on a serial line"],
    ),
    (
        "nobody there",
        "node = 2",
        "node = 2\nemulator = { absent = true }",
        &["bus arm, axis upper-arm: ", "no answer", "cabinet is on", "cable", "baud rate"],
    ),
    (
        "another protocol",
        "node = 2",
        "node = 2\nemulator = { protocol = \"hi-moxa\" }",
        &["bus arm, axis upper-arm: ", "speaks HiMoxa, the cell says Nfv2"],
    ),
    (
        "another axis",
        "node = 2",
        "node = 2\nemulator = { address = 3 }",
        &["bus arm, axis upper-arm: ", "answers as address 3, the cell says 2"],
    ),
];

#[test]
fn a_wrong_serial_cell_or_drive_is_refused_and_nothing_is_enabled() {
    let directory = Directory::new();
    for &(name, good, bad, needles) in CELLS {
        let text = text("irb6-serial");
        assert!(text.contains(good), "{name}");
        let cell = directory.write("wrong.toml", &text.replacen(good, bad, 1));
        let record = directory.path("axes.csv");
        let run = mrroc([
            "run".as_ref(),
            cell.as_os_str(),
            "--bench=lockstep".as_ref(),
            "--force".as_ref(),
            "--record".as_ref(),
            record.as_os_str(),
        ]);
        refused(&run, needles);
        // No cycle ran, so the record contains at most its heading.
        let record = fs::read_to_string(&record).unwrap_or_default();
        assert!(record.lines().count() <= 1, "{name}: {record}");
    }
}

#[test]
fn an_adapter_with_a_latency_of_eight_periods_is_named() {
    for name in kit::mrroc::SERIAL_CELLS {
        let directory = Directory::new();
        let cell = directory.cell(name, |cell| cell.serial[0].emulated_latency_ms = Some(16));
        let run = mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref()]);
        refused(&run, &["emulated_latency_ms", "latency timer"]);
    }
}
