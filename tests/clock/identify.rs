//! `mrroc identify` by the clock: on the ttys and the bus of another process, and stopped.

use std::path::Path;

use kit::mrroc::{Directory, Output, Running, mrroc, shorten};
use kit::refusals::refused;
use kit::{PERIOD, by_the_clock};
use serde_json::Value;

use crate::serial_cli::emulate;
use crate::vcan::on_stage;

fn identify(cell: &Path, more: &[&str]) -> Output {
    let arguments = ["identify".as_ref(), cell.as_os_str()];
    mrroc(arguments.into_iter().chain(more.iter().map(AsRef::as_ref)))
}

/// Asserts that a measurement on `bench` gives a right report.
fn measured(run: &Output, bench: &str, is_right: impl Fn(&Value) -> bool) {
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let report = run.json();
    println!("{bench}: {}, {}", report["crossover_hz"], report["phase_margin_deg"]);
    assert!(report["bench"] == bench && is_right(&report), "{report}");
}

/// Mean use of processors.
const PROCESSORS: f64 = 0.45;

/// Whether the report approximately describes the loop of the example.
fn is_serial_column(report: &Value) -> bool {
    let [crossover, margin] = ["crossover_hz", "phase_margin_deg"].map(|key| report[key].as_f64());
    crossover.is_some_and(|it| (it / 16.6).ln().abs() < 0.25) && margin.is_some_and(|it| (it - 48.5).abs() < 15.0)
}

/// An emulator on pseudo-terminals is homed without further options. A device that may be hardware is neither homed nor
/// moved.
#[test]
fn a_loop_is_measured_over_the_ttys_of_another_process() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-serial", |cell| {
        shorten(cell);
        // The answers of another process are later on a loaded machine.
        cell.serial[0].tolerated_missing = 10;
        cell.serial[0].answer_timeout_ms = 500;
        cell.max_missed_in_row = 100;
    });
    let ttys = directory.path("ttys");
    let _emulator = emulate(&cell, &ttys);
    let on = |bench, more: &[&str]| {
        let ttys = ttys.to_str().unwrap();
        let arguments = ["--axis", "column", "--json", "--bench", bench, "--serial", ttys];
        identify(&cell, &[&arguments, more].concat())
    };
    let hardware = || on("card", &["--moves-hardware"]);
    refused(&on("card", &[]), &["--moves-hardware"]);
    by_the_clock(PROCESSORS, PERIOD, || {
        let run = hardware();
        assert_ne!(run.status.code(), Some(0), "{run:?}");
        assert!(run.stderr.contains("irb6.column: the robot is not homed"), "{run:?}");
    });
    by_the_clock(PROCESSORS, PERIOD, || measured(&on("vcan", &[]), "vcan", is_serial_column));
    by_the_clock(PROCESSORS, PERIOD, || measured(&hardware(), "card", is_serial_column));
}

#[test]
fn an_axis_is_measured_over_vcan() {
    on_stage("identify::an_axis_is_measured_over_vcan", |stage| {
        let _emulators = stage.start_emulators();
        let cell = stage.directory.path("cell.toml");
        let on = ["--bench=vcan", "--can", stage.interface];
        // The period of the stage is too long for the loops of its drives. The drives follow a slow command.
        let what = ["--axis=column", "--at=command", "--to=16", "--json"];
        let arguments = [&on[..], &what].concat();
        let follows = |report: &Value| {
            let slow = report["points"].as_array().unwrap().iter().take(3);
            let mut magnitudes = slow.map(|point| point["magnitude"].as_f64().unwrap());
            magnitudes.all(|it| (it - 1.0).abs() < 0.2)
        };
        measured(&identify(&cell, &arguments), "vcan", follows);
    });
}

#[test]
fn a_measurement_that_is_stopped_ends_with_status_1_and_brakes() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6-serial", shorten);
        let out = directory.path("out");
        let words = ["identify", "--axis=column", "--bench=emulated", "--periods=40", "--out"];
        let words = words.iter().map(AsRef::as_ref);
        let run = Running::start(words.chain([out.as_os_str(), cell.as_os_str()]));
        run.wait_for(&out.join("bode.csv"), |_| true);
        const SIGQUIT: u32 = 3;
        // A signal before its handler ends the program, which has then moved nothing.
        let status = format!("/proc/{}/status", run.id());
        run.wait_for(status.as_ref(), |status| {
            let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
            caught.is_some_and(|caught| u64::from_str_radix(caught.trim(), 16).unwrap() & (1 << (SIGQUIT - 1)) != 0)
        });
        run.signal("QUIT");
        let run = run.output();
        assert_eq!(run.status.code(), Some(1), "{run:?}");
        assert!(run.stderr.contains("stopped before"), "{run:?}");
    });
}
