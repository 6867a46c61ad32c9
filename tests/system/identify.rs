//! `mrroc identify`: frequency responses of the loops of every drive family, and refusals.

use std::f64::consts::TAU;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;
use std::{fs, iter};

use ::mrroc::cell::DriveControl;
use hil::plant::SUB_STEP;
use hil::{AxisConfig, Demand, Irp6Axis};
use nalgebra::Complex;
use serde_json::Value;

use crate::bench::turn;
use crate::cli_refusals::refused;
use crate::host_closed::closed_by_host;
use crate::mrroc::{self, Directory, Output, Running, example, mrroc, shorten};
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
    let (velocity, torque) = (by_host(0, DriveControl::Velocity), by_host(1, DriveControl::Torque));
    // Crossover, Hz, and phase margin, degrees: values of the table in `servo::identify`.
    let cases = [
        (example("irb6-serial"), "irb6/column", 16.4, 48.0),
        (example("irb6-serial"), "irb6/wrist-roll", 15.8, 48.5),
        (velocity, "irb6/column", 8.5, 82.0),
        (torque, "irb6/column", 11.0, 47.0),
        (example("irp6-track"), "track", 45.7, 37.8),
        (example("polycrank"), "q6", 45.3, 41.9),
    ];
    for (cell, axis, crossover, margin) in cases {
        shaped(&cell, &["--axis", axis], (crossover, margin), (0.1, 5.0));
    }
}

/// Asserts crossover, Hz, within a relative tolerance, and phase margin within a tolerance in degrees.
fn shaped(cell: &Path, axis: &[&str], (crossover, margin): (f64, f64), within: (f64, f64)) {
    for excitation in ["multisine", "chirp"] {
        let arguments = [axis, &["--excitation", excitation, "--json"]].concat();
        let run = identify(cell, &arguments);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let report = run.json();
        let number = |key: &str| report[key].as_f64().unwrap_or_else(|| panic!("{key}: {run:?}"));
        let found = (number("crossover_hz"), number("phase_margin_deg"));
        println!("{axis:?} {}, {excitation}: {found:?}", report["closed_by"]);
        assert!((found.0 / crossover - 1.0).abs() < within.0, "{axis:?}: {found:?}");
        assert!((found.1 - margin).abs() < within.1, "{axis:?}: {found:?}");
        assert!(number("coherence") > 0.95, "{run:?}");
    }
}

#[test]
fn a_loop_of_the_drive_is_seen_from_outside_as_it_is_inside() {
    let inside = seen_inside(Irp6Axis::Flange);
    println!("inside: {inside:?}");
    // A high velocity and a small excitation make the influence of dry friction negligible. Dry friction adds damping
    // when a motor reverses.
    let axis = ["--axis=irp6/flange", "--velocity=20", "--amplitude=0.05"];
    shaped(&example("irp6"), &axis, inside, (0.04, 3.0));
}

/// Crossover, Hz, and phase margin, degrees, of the loops of a drive that runs at 20 rad/s. They are computed from the
/// torques of every sub-step, which no bus carries, with one sine at a time at multiples of 5 Hz.
fn seen_inside(kind: Irp6Axis) -> (f64, f64) {
    const STEPS: u32 = 30_000;
    let config = AxisConfig::irp6(kind);
    let velocity = 20.0 * f64::from(config.counts_per_revolution) / TAU;
    let open = |frequency: f64| {
        let mut axis = hil::PlantAxis::new(&config, 1);
        let (mut added, mut sums) = (0.0, [Complex::new(0.0, 0.0); 2]);
        for step in 0..STEPS {
            let time = f64::from(step) * SUB_STEP;
            // The drive adopts the value in every cycle of its outer loops.
            if step % 10 == 0 {
                added = 0.05 * (TAU * frequency * time).sin();
                axis.set_torque_offset(added);
            }
            axis.advance(1, Demand::Position { counts: velocity * time, velocity });
            if step >= STEPS / 3 {
                let turn = Complex::new(0.0, -TAU * frequency * time).exp();
                sums[0] += turn * added;
                sums[1] += turn * axis.feedback().torque;
            }
        }
        sums[0] / sums[1] - 1.0
    };
    let points = (4..16).map(|number| {
        let frequency = 5.0 * f64::from(number);
        (frequency, open(frequency))
    });
    let points: Vec<_> = points.collect();
    let (below, above) = points
        .iter()
        .zip(&points[1..])
        .find(|(below, above)| below.1.norm() >= 1.0 && above.1.norm() < 1.0)
        .expect("it crosses over there");
    let share = below.1.norm().ln() / (below.1.norm() / above.1.norm()).ln();
    let between = |low: f64, high: f64| low + share * (high - low);
    // The phase margin is the angle of minus the open loop relative to the positive real axis.
    let margin = |point: &Complex<f64>| (-point).arg().to_degrees();
    (between(below.0, above.0), between(margin(&below.1), margin(&above.1)))
}

#[test]
fn a_command_is_followed_from_command_to_sample() {
    let at = ["--axis", "column", "--at", "command", "--json"];
    let run = identify(&example("irb6"), &at);
    let report = run.json();
    assert_eq!(report["open_loop"], false);
    assert_eq!(report["crossover_hz"], Value::Null);
    // Positions are rounded to counts. With this small excitation, a single point has an error of up to 15 %.
    let points = report["points"].as_array().unwrap();
    let low = points.iter().filter(|point| point["frequency_hz"].as_f64().unwrap() < 8.0);
    let low: Vec<_> = low.map(|point| point["magnitude"].as_f64().unwrap()).collect();
    let mean = low.iter().sum::<f64>() / low.len() as f64;
    assert!(low.len() >= 5 && (mean - 1.0).abs() < 0.1, "{mean}: {run:?}");
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
    assert!(csv.starts_with("frequency_hz,magnitude,phase_deg,coherence\n") && csv.lines().count() > 20);
    let verdict = stdout.lines().nth(1).unwrap().split(['(', ':', ';']).nth(1).unwrap().trim();
    assert!(verdict.starts_with("crossover ") && svg.contains(verdict), "{verdict}: {svg}");
    assert!(!svg.contains("NaN") && svg.ends_with("</svg>\n"));
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
fn what_cannot_be_measured_is_refused_before_anything_moves() {
    let cases: [(&[&str], &[&str]); 11] = [
        (&["--axis", "nobody"], &["no axis is called \"nobody\"", "irb6/column"]),
        (&["--axis", "column", "--amplitude", "0.2"], &["--amplitude 0.2", "at most 0.1050"]),
        (&["--axis", "column", "--amplitude", "NaN"], &["--amplitude NaN"]),
        (&["--axis", "column", "--at=command", "--amplitude", "0.4"], &["rad/s² is beyond the limit of 1500"]),
        (&["--axis", "column", "--velocity", "251"], &["--velocity 251", "250"]),
        (&["--axis", "irb6/lower-arm", "--velocity", "100"], &["has room for", "lower --velocity"]),
        (&["--axis", "column", "--drive-period", "2001"], &["--drive-period 2001", "at most the 2000 µs"]),
        (&["--axis", "column", "--from", "1"], &["the lowest frequency is 2 Hz"]),
        (&["--axis", "column", "--periods", "1"], &["two at least"]),
        (&["--axis", "column", "--bench", "card"], &["--moves-hardware"]),
        (&["--axis", "column", "--can", "vcan0"], &["--can and --serial need --bench vcan"]),
    ];
    for (arguments, needles) in cases {
        refused(&identify(&example("irb6"), arguments), needles);
    }
}

/// The disk may be full after the axis has moved.
#[test]
fn a_measurement_that_cannot_be_written_or_printed_is_no_refusal() {
    let directory = Directory::new();
    let out = directory.path("out");
    fs::create_dir(&out).unwrap();
    symlink("/dev/full", out.join("bode.csv")).unwrap();
    let to = out.to_str().unwrap();
    let run = identify(&example("irb6"), &["--axis", "column", "--out", to]);
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    assert!(run.stdout.contains("crossover"), "{run:?}");
    let said = "mrroc: bode.csv cannot be written: No space left";
    assert!(run.stderr.starts_with(said), "{run:?}");

    let unprinted = Command::new(mrroc::binary())
        .arg("identify")
        .arg(example("irb6"))
        .args(["--axis", "column"])
        .stdout(fs::File::options().write(true).open("/dev/full").unwrap())
        .output()
        .unwrap();
    assert_eq!(unprinted.status.code(), Some(1), "{unprinted:?}");
}

#[test]
fn a_place_that_cannot_be_written_to_is_refused_before_anything_moves() {
    let directory = Directory::new();
    let file = directory.write("file", "");
    let taken = directory.path("taken");
    fs::create_dir_all(taken.join("bode.csv")).unwrap();
    for place in [file.join("below"), file, taken.clone(), "/proc/mrroc".into()] {
        let out = place.to_str().unwrap();
        let run = identify(&example("irb6"), &["--axis=column", "--out", out, "--bench=vcan"]);
        // The interface for the vcan bench is missing here. The command is refused before the bench is opened.
        refused(&run, &["--out", out]);
    }
    assert!(!taken.join("bode.svg").exists());
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
