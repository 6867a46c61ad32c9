//! `mrroc identify` by the clock: on the ttys and the bus of another process, and stopped.

use std::iter;
use std::path::Path;

use kit::bench::turn;
use kit::mrroc::{Directory, Output, Running, mrroc, shorten};
use kit::refusals::refused;
use serde_json::Value;

use crate::serial_cli::emulate;
use crate::vcan::on_stage;

fn identify(cell: &Path, more: &[&str]) -> Output {
    let arguments = ["identify".as_ref(), cell.as_os_str()];
    mrroc(arguments.into_iter().chain(more.iter().map(AsRef::as_ref)))
}

/// Repeats `measure` on `bench` until its report is correct, up to eight times. On an overloaded machine, frames and
/// answers are late, and a measurement may end with a fault. A refused measurement fails the test at once, unless
/// answers took more than a period.
fn in_the_end(measure: impl Fn() -> Output, bench: &str, is_right: impl Fn(&Value) -> bool) {
    let right = |run: &Output| {
        if run.status.code() == Some(1) || run.stderr.contains("took more than a period") {
            println!("{bench}: {}", run.stderr);
            return false;
        }
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let report = run.json();
        println!("{bench}: {}, {}", report["crossover_hz"], report["phase_margin_deg"]);
        report["bench"] == bench && is_right(&report)
    };
    let mut runs = iter::repeat_with(measure).take(8);
    assert!(runs.any(|run| right(&run)), "never right on {bench}");
}

/// Whether the report approximately describes the loop of the example.
fn is_serial_column(report: &Value) -> bool {
    let [crossover, margin] = ["crossover_hz", "phase_margin_deg"].map(|key| report[key].as_f64());
    crossover.is_some_and(|it| (it / 16.6).ln().abs() < 0.25) && margin.is_some_and(|it| (it - 48.5).abs() < 15.0)
}

/// An emulator on pseudo-terminals is homed without further options. A device that may be hardware is neither homed nor
/// moved.
#[test]
fn a_loop_is_measured_over_the_ttys_of_another_process() {
    let _turn = turn();
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
    // Late answers may abort a start before the refusal. No start may lead to a measurement.
    let mut unhomed = iter::repeat_with(hardware).take(20);
    assert!(unhomed.any(|run| {
        assert_ne!(run.status.code(), Some(0), "{run:?}");
        run.stderr.contains("irb6/column: the robot is not homed")
    }));
    in_the_end(|| on("vcan", &[]), "vcan", is_serial_column);
    in_the_end(hardware, "card", is_serial_column);
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
        in_the_end(|| identify(&cell, &arguments), "vcan", follows);
    });
}

#[test]
fn a_measurement_that_is_stopped_ends_with_status_1_and_brakes() {
    let _turn = turn();
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
}
