//! Network cameras: from the emulated world over the connection to the task, in lockstep and over TCP.

use std::iter;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::RunOutcome;
use ::mrroc::report::RunReport;

use crate::bench::patient_turn;
use crate::mrroc::{Directory, example};

#[path = "../../examples/look.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod look;

/// A change of a cell.
type Change = fn(&mut Cell);

/// The cell of the example after a change.
fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    CellFile::read(Directory::new().cell("irb6-camera", change)).unwrap()
}

fn run(bench: BenchKind, change: impl FnOnce(&mut Cell)) -> RunReport {
    ::mrroc::run(&cell(change), bench, look::look).unwrap()
}

fn faults(report: &RunReport) -> Vec<&str> {
    report.faults.iter().map(|fault| fault.what.as_str()).collect()
}

/// Asserts that the box was found at (`x`, `z`), m, within 1 mm: a third of a pixel at the distance of its face.
fn assert_found(report: &RunReport, x: f64, z: f64) {
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    let error = [report.figures["box_x_m"] - x, report.figures["box_z_m"] - z];
    println!("{:.3?} mm, {:.4} rad", error.map(|part| 1e3 * part), report.figures["box_turn_rad"]);
    assert!(error[0].hypot(error[1]) < 1e-3, "{error:?} m");
    assert!(report.figures["box_turn_rad"].abs() < 0.01);
}

#[test]
fn box_is_located_within_1_mm_from_a_picture_in_lockstep() {
    for (seed, x, z) in [(1, 0.713, 0.887), (2, 0.66, 0.93), (3, 0.741, 0.842)] {
        let report = run(BenchKind::Lockstep, |cell| {
            cell.seed = seed;
            let block = &mut cell.scene.as_mut().unwrap().block[0];
            (block.centre[0], block.centre[2]) = (x, z);
        });
        assert_found(&report, x, z);
    }
}

#[test]
fn pictures_in_lockstep_are_the_same_each_run() {
    let [first, second] = [(); 2].map(|()| run(BenchKind::Lockstep, |_| {}).figures);
    assert_eq!(first, second);
}

#[test]
fn box_is_located_within_1_mm_from_a_picture_over_tcp() {
    let _turn = patient_turn();
    // On a busy host, a picture may be late. A run that ended with a fault is repeated.
    let runs = iter::repeat_with(|| run(BenchKind::Emulated, |_| {})).take(8);
    let mut runs = runs.inspect(|run| run.faults.iter().for_each(|fault| println!("{}", fault.what)));
    let found = runs.find(|run| run.outcome == RunOutcome::Completed);
    assert_found(&found.expect("a host that can run the cell for a moment"), 0.713, 0.887);
}

#[test]
fn lost_box_ends_the_task_by_a_typed_error() {
    let away = run(BenchKind::Lockstep, |cell| cell.scene.as_mut().unwrap().block[0].centre[0] = 5.0);
    assert_eq!(away.outcome, RunOutcome::Faulted);
    assert!(faults(&away)[0].contains("camera eye: nothing bright is in the picture"), "{:?}", faults(&away));
    let half = run(BenchKind::Lockstep, |cell| cell.scene.as_mut().unwrap().block[0].centre[0] = 0.93);
    assert!(faults(&half)[0].contains("camera eye: the brightest area is at the edge"), "{:?}", faults(&half));
}

#[test]
fn silence_of_the_camera_ends_the_task_by_its_fault_with_the_age() {
    let report = run(BenchKind::Lockstep, |cell| cell.camera[0].emulator.silent_from_s = Some(5.0));
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(faults(&report)[0].contains("camera eye: no picture for "), "{:?}", faults(&report));
}

#[test]
fn absent_silent_garbled_and_other_cameras_are_refused_before_motion() {
    let cases: [(Change, &str); 5] = [
        (|cell| cell.camera[0].emulator.absent = true, "no connection, waited"),
        (|cell| cell.camera[0].emulator.silent_from_s = Some(0.0), "no picture for"),
        (|cell| cell.camera[0].emulator.garbled = true, "no valid picture for"),
        (|cell| cell.camera[0].emulator.width = Some(80), "the camera has 80 × 120 pixels, declared were 160 × 120"),
        (
            |cell| cell.camera[0].emulator.period_ms = Some(50),
            "the camera sends a picture every 50.0ms, declared was 100.0ms",
        ),
    ];
    let _turn = patient_turn();
    for bench in [BenchKind::Lockstep, BenchKind::Emulated] {
        for (change, expected) in cases {
            // A busy host delays pictures by the clock, and the camera is then refused for another reason.
            let tries = if bench == BenchKind::Lockstep { 1 } else { 8 };
            let refused = || ::mrroc::run(&cell(change), bench, look::look).unwrap_err().to_string();
            let mut refused = iter::repeat_with(refused).take(tries).inspect(|refused| {
                assert!(refused.starts_with("camera eye, address 127.0.0.1:"), "{refused}");
                println!("{}: {refused}", bench.name());
            });
            assert!(refused.any(|refused| refused.contains(expected)), "{}: {expected}", bench.name());
        }
    }
    let file = CellFile::read(example("irb6")).unwrap();
    let unknown = ::mrroc::run(&file, BenchKind::Lockstep, look::look).unwrap_err().to_string();
    assert!(unknown.contains("the cell has no camera \"eye\": add it as [[camera]]"), "{unknown}");
}
