//! `mrroc identify`: the shapes of the loops of every family, and what it refuses.

use std::fs;
use std::path::Path;

use controller::cell::DriveControl;
use hil::Irp6Axis;

use crate::cli_refusals::refused;
use crate::host_closed::closed_by_host;
use crate::mrroc::{Directory, Output, example, mrroc};

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

#[test]
fn what_cannot_be_measured_is_refused_before_anything_moves() {
    let cases: [(&[&str], &[&str]); 9] = [
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
    ];
    for (arguments, needles) in cases {
        refused(&identify(&example("irb6"), arguments), needles);
    }
}
