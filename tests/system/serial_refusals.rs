//! Refusals for serial lines: one line that names the problem, its place and its cause; exit status 2; nothing is
//! enabled.

use std::fs;
use std::os::unix::fs::symlink;

use hil::Pty;
use serial::{Settings, Tty};

use crate::bench::turn;
use crate::cli_refusals::refused;
use crate::mrroc::{Directory, mrroc, text};

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
    let _turn = turn();
    for name in crate::mrroc::SERIAL_CELLS {
        let directory = Directory::new();
        let cell = directory.cell(name, |cell| cell.serial[0].emulated_latency_ms = Some(16));
        let run = mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref()]);
        assert_ne!(run.status.code(), Some(0), "{run:?}");
        let said = format!("{}{}", run.stdout, run.stderr);
        assert!(said.contains("latency timer"), "{said}");
    }
}

#[test]
fn a_line_that_cannot_be_used_is_refused_by_its_axis() {
    let directory = Directory::new();
    let cell = directory.write("cell.toml", &text("irb6-serial"));
    let axes = ["column", "lower-arm", "upper-arm", "wrist-pitch", "wrist-roll"];
    let ptys: Vec<Pty> = axes.iter().map(|_| Pty::open().unwrap()).collect();
    let ttys = directory.path("ttys");
    fs::create_dir(&ttys).unwrap();
    for (axis, pty) in axes.iter().zip(&ptys) {
        symlink(pty.path(), ttys.join(axis)).unwrap();
    }
    let run =
        |bench: &str| mrroc(["run".as_ref(), cell.as_os_str(), bench.as_ref(), "--serial".as_ref(), ttys.as_os_str()]);
    // No emulator serves the other ends.
    refused(&run("--bench=card"), &["bus arm, axis column: ", "no answer", "baud rate"]);
    // Root may open a tty that another process uses exclusively.
    let held = Tty::open(ttys.join("column"), Settings::AXIS_CONTROLLER).unwrap();
    let busy = run("--bench=card");
    if !busy.stderr.contains("no answer") {
        refused(&busy, &["axis column: ", "in use by another process"]);
    }
    drop(held);
    fs::remove_file(ttys.join("lower-arm")).unwrap();
    refused(&run("--bench=card"), &["axis lower-arm: ", "no such device"]);
    fs::write(ttys.join("lower-arm"), "no tty").unwrap();
    refused(&run("--bench=card"), &["axis lower-arm: ", "not a tty"]);
    // On a bench of pseudo-terminals, a real tty is refused before it is opened.
    refused(&run("--bench=vcan"), &["lower-arm may be hardware", "--bench card"]);
}
