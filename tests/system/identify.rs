//! `mrroc identify`: the shapes of the loops of every family, and what it refuses.

use std::fs;
use std::path::Path;

use controller::cell::{DriveControl, Law};
use hil::Irp6Axis;

use crate::cli_refusals::refused;
use crate::host_closed::closed_by_host;
use crate::mrroc::{Directory, Output, example, mrroc, shorten};
use crate::serial_cli::emulate;
use crate::vcan::on_stage;

fn identify(cell: &Path, more: &[&str]) -> Output {
    let arguments = ["identify".as_ref(), cell.as_os_str()];
    mrroc(arguments.into_iter().chain(more.iter().map(AsRef::as_ref)))
}

#[test]
fn the_loops_of_every_family_are_shaped_as_documented() {
    let directories = [Directory::new(), Directory::new()];
    let by_host = |number: usize, control| {
        directories[number].cell("irb6", |cell| {
            for (axis, kind) in cell.robot[0].axis.iter_mut().zip(Irp6Axis::ALL) {
                closed_by_host(axis, kind, control);
            }
        })
    };
    let (velocity, torque) = (
        by_host(0, DriveControl::Velocity),
        by_host(1, DriveControl::Torque),
    );
    // Crossover, Hz, and phase margin, degrees: the table of `servo::identify`.
    let cases = [
        (example("irb6-serial"), "irb6/column", 16.4, 48.0),
        (example("irb6-serial"), "irb6/wrist-roll", 15.8, 48.5),
        (velocity, "irb6/column", 8.5, 82.0),
        (torque, "irb6/column", 11.0, 47.0),
    ];
    for (cell, axis, crossover, margin) in cases {
        shaped(&cell, axis, crossover, margin);
    }
}

fn shaped(cell: &Path, axis: &str, crossover: f64, margin: f64) {
    for excitation in ["multisine", "chirp"] {
        let run = identify(
            cell,
            &["--axis", axis, "--excitation", excitation, "--json"],
        );
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let report = run.json();
        let number = |key: &str| {
            report[key]
                .as_f64()
                .unwrap_or_else(|| panic!("{key}: {run:?}"))
        };
        let found = (number("crossover_hz"), number("phase_margin_deg"));
        println!("{axis} {}, {excitation}: {found:?}", report["closed_by"]);
        assert!((found.0 / crossover - 1.0).abs() < 0.1, "{axis}: {found:?}");
        assert!((found.1 - margin).abs() < 5.0, "{axis}: {found:?}");
        assert!(number("coherence") > 0.95, "{run:?}");
    }
}

#[test]
fn a_loop_of_the_drive_is_seen_from_command_to_sample() {
    let run = identify(&example("irb6"), &["--axis", "column", "--json"]);
    let report = run.json();
    assert_eq!(report["open_loop"], false);
    assert_eq!(report["crossover_hz"], serde_json::Value::Null);
    let first = report["points"][0]["magnitude"].as_f64().unwrap();
    assert!((first - 1.0).abs() < 0.1, "{run:?}");
}

#[test]
fn the_files_hold_what_the_report_says_and_the_same_each_time() {
    let directory = Directory::new();
    let written = ["one", "two"].map(|name| {
        let out = directory.path(name);
        let to = out.to_str().unwrap();
        let run = identify(&example("irb6-serial"), &["--axis", "column", "--out", to]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
        (run.stdout, read("bode.csv"), read("bode.svg"))
    });
    assert_eq!(written[0], written[1]);
    let [(stdout, csv, svg), _] = written;
    assert!(
        csv.starts_with("frequency_hz,magnitude,phase_deg,coherence\n") && csv.lines().count() > 20
    );
    let verdict = stdout
        .lines()
        .nth(1)
        .unwrap()
        .split(['(', ':', ';'])
        .nth(1)
        .unwrap()
        .trim();
    assert!(
        verdict.starts_with("crossover ") && svg.contains(verdict),
        "{verdict}: {svg}"
    );
    assert!(!svg.contains("NaN") && svg.ends_with("</svg>\n"));
}

/// Where another process keeps frames and answers back a loop is slower than documented, and its figures are rough.
fn rough(run: &Output, bench: &str, crossover: f64, margin: f64) {
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let report = run.json();
    assert_eq!(report["bench"], bench, "{run:?}");
    let number = |key: &str| {
        report[key]
            .as_f64()
            .unwrap_or_else(|| panic!("{key}: {run:?}"))
    };
    let found = (number("crossover_hz"), number("phase_margin_deg"));
    println!("{bench}: {found:?}");
    assert!((found.0 / crossover).ln().abs() < 0.3, "{found:?}");
    assert!((found.1 - margin).abs() < 25.0, "{found:?}");
}

/// An emulator on pseudo-terminals is homed without being asked; what may be hardware is not, and is not moved.
#[test]
fn a_loop_is_measured_over_the_ttys_of_another_process() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-serial", |cell| {
        shorten(cell);
        // The answers of another process come later on a loaded machine.
        cell.serial[0].tolerated_missing = 10;
        cell.serial[0].answer_timeout_ms = 500;
        cell.max_missed_in_row = 100;
    });
    let ttys = directory.path("ttys");
    let _emulator = emulate(&cell, &ttys);
    let on = |bench, more: &[&str]| {
        let ttys = ttys.to_str().unwrap();
        let arguments = [
            "--axis", "column", "--json", "--bench", bench, "--serial", ttys,
        ];
        identify(&cell, &[&arguments, more].concat())
    };
    refused(&on("card", &[]), &["--moves-hardware"]);
    let hardware = ["--moves-hardware"];
    refused(&on("card", &hardware), &["irb6/column", "not homed"]);
    rough(&on("vcan", &[]), "vcan", 16.4, 48.0);
    rough(&on("card", &hardware), "card", 16.4, 48.0);
}

#[test]
fn a_loop_is_measured_over_vcan() {
    on_stage("identify::a_loop_is_measured_over_vcan", |stage| {
        stage.change(|cell| {
            for (axis, kind) in cell.robot[0].axis.iter_mut().zip(Irp6Axis::ALL) {
                closed_by_host(axis, kind, DriveControl::Velocity);
                let drive = axis.drive.as_mut().unwrap();
                let Some(Law::Proportional(law)) = drive.r#loop.as_mut().map(|it| &mut it.law)
                else {
                    panic!("a loop by velocity is proportional");
                };
                // At five times the period.
                law.position_gain = 18.0;
            }
        });
        let _emulators = stage.start_emulators();
        let cell = stage.directory.path("cell.toml");
        let arguments = [
            "--axis",
            "column",
            "--json",
            "--bench=vcan",
            "--can",
            stage.interface,
        ];
        let to = ["--to", "40"];
        rough(
            &identify(&cell, &[&arguments[..], &to].concat()),
            "vcan",
            2.9,
            55.0,
        );
    });
}

#[test]
fn what_cannot_be_measured_is_refused_before_anything_moves() {
    let cases: [(&[&str], &[&str]); 10] = [
        (
            &["--axis", "nobody"],
            &["no axis is called \"nobody\"", "irb6/column"],
        ),
        (
            &["--axis", "column", "--amplitude", "0.6"],
            &["--amplitude 0.6", "at most 0.5"],
        ),
        (
            &["--axis", "column", "--amplitude", "NaN"],
            &["--amplitude NaN"],
        ),
        (
            &["--axis", "column", "--amplitude", "0.4"],
            &["rad/s² is beyond the limit of 1500"],
        ),
        (
            &["--axis", "column", "--velocity", "251"],
            &["--velocity 251", "250"],
        ),
        (
            &["--axis", "irb6/lower-arm", "--velocity", "100"],
            &["has room for", "lower --velocity"],
        ),
        (
            &["--axis", "column", "--from", "1"],
            &["the lowest frequency is 2 Hz"],
        ),
        (&["--axis", "column", "--periods", "1"], &["two at least"]),
        (
            &["--axis", "column", "--bench", "card"],
            &["--moves-hardware"],
        ),
        (
            &["--axis", "column", "--can", "vcan0"],
            &["--can and --serial need --bench vcan"],
        ),
    ];
    for (arguments, needles) in cases {
        refused(&identify(&example("irb6"), arguments), needles);
    }
}
