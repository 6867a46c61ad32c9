//! The example of a network camera: its cell, and its runs.

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::RunOutcome;
use ::mrroc::report::RunReport;

use crate::mrroc::Directory;

#[path = "../../examples/look.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod look;

/// A change of a cell.
pub type Change = fn(&mut Cell);

/// The cell of the example after a change.
pub fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    CellFile::read(Directory::new().cell("irb6-camera", change)).unwrap()
}

pub fn run(bench: BenchKind, change: impl FnOnce(&mut Cell)) -> RunReport {
    ::mrroc::run(&cell(change), bench, look::look).unwrap()
}

/// Asserts that the box was found at (`x`, `z`), m, within 1 mm: a third of a pixel at the distance of its face.
pub fn assert_found(report: &RunReport, x: f64, z: f64) {
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    let error = [report.figures["box_x_m"] - x, report.figures["box_z_m"] - z];
    println!("{:.3?} mm, {:.4} rad", error.map(|part| 1e3 * part), report.figures["box_turn_rad"]);
    assert!(error[0].hypot(error[1]) < 1e-3, "{error:?} m");
    assert!(report.figures["box_turn_rad"].abs() < 0.01);
}

/// Cameras that are refused before motion, and a part of the refusal.
pub const REFUSED: [(Change, &str); 5] = [
    (|cell| cell.camera[0].emulator.absent = true, "no connection, waited"),
    (|cell| cell.camera[0].emulator.silent_from_s = Some(0.0), "no picture for"),
    (|cell| cell.camera[0].emulator.garbled = true, "no valid picture for"),
    (|cell| cell.camera[0].emulator.width = Some(80), "the camera has 80 × 120 pixels, declared were 160 × 120"),
    (
        |cell| cell.camera[0].emulator.period_ms = Some(50),
        "the camera sends a picture every 50.0ms, declared was 100.0ms",
    ),
];

/// The refusal of the cell after a change.
pub fn refusal(bench: BenchKind, change: Change) -> String {
    let refused = refusal_of(&cell(change), bench);
    assert!(refused.starts_with("camera eye, address 127.0.0.1:"), "{refused}");
    refused
}

/// The refusal of a cell by the example.
pub fn refusal_of(file: &CellFile, bench: BenchKind) -> String {
    ::mrroc::run(file, bench, look::look).unwrap_err().to_string()
}
