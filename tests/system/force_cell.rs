//! A cell with a force/torque sensor at the wrist: from the cell file to the task, in lockstep.

use std::fs;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{Outcome, RunOutcome};
use ::mrroc::report::RunReport;
use ::mrroc::tasks;

use crate::mrroc::{Directory, example};

#[path = "../../examples/push_until.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod push_until;

/// The example cell after a change.
fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    let directory = Directory::new();
    CellFile::read(directory.cell("irb6-wrist", change)).unwrap()
}

/// Runs the example in lockstep.
fn push(change: impl FnOnce(&mut Cell)) -> RunReport {
    ::mrroc::run(&cell(change), BenchKind::Lockstep, push_until::push).unwrap()
}

fn figure(report: &RunReport, name: &str) -> f64 {
    report.figures[name]
}

#[test]
fn the_contact_force_is_stiffness_times_indentation() {
    for stiffness in [5e3, 2e4] {
        let report = push(|cell| cell.scene.as_mut().unwrap().plane[0].stiffness = stiffness);
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
        let indentation = 0.78 - figure(&report, "tool_height_m");
        let force = figure(&report, "force_n");
        // Half a count of the sensor is 9 µm at 5,000 N/m, and a count of a motor up to 9 µm of the tool.
        let error = (force / stiffness - indentation).abs();
        assert!(error < 2e-5, "{force} N at {indentation} m and {stiffness} N/m");
        // In motion, the damper of the table and the inertia of the tool add up to 3 N to the reading. Up to the stop, the
        // tool moves on for three macrosteps of 0.2 mm.
        let range = 17.0..20.0 + 6e-4 * stiffness;
        assert!(range.contains(&force), "{force} N at {stiffness} N/m");
        println!("{stiffness} N/m: {force:.2} N, peak {:.2} N", figure(&report, "peak_force_n"));
    }
}

#[test]
fn an_offset_of_the_sensor_is_zeroed_and_the_weight_of_the_tool_compensated_in_another_orientation() {
    async fn turn(cell: &mut tasks::Cell) -> Outcome {
        let mut irb6 = cell.robot("irb6")?;
        let wrist = cell.force_sensor("wrist")?;
        irb6.enable().await?;
        irb6.home().await?;
        wrist.zero().await?;
        for (name, joints) in [("up_n", [0.0, -1.571, 0.0, -0.6, 0.0]), ("down_n", [0.3, -1.571, 0.0, 1.2, 1.0])] {
            irb6.execute(irb6.motions().joints(0.3, &[joints])?).await?;
            cell.sleep(std::time::Duration::from_millis(500)).await;
            cell.figure(name, wrist.in_tool()?.force.norm());
        }
        irb6.disable().await
    }
    let file = cell(|cell| cell.force_sensor[0].emulator.offset = [3.0, -5.0, 8.0, 0.1, 0.2, -0.3]);
    let report = ::mrroc::run(&file, BenchKind::Lockstep, turn).unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    // Three counts of 0.087 N. The tool weighs 10.8 N.
    for name in ["up_n", "down_n"] {
        assert!(figure(&report, name) < 0.26, "{name}: {}", figure(&report, name));
    }
}

#[test]
fn silence_of_the_sensor_stops_the_approach_with_a_report_that_names_the_sensor() {
    let report = push(|cell| {
        // Without the table, the approach takes 6 s.
        cell.scene = None;
        cell.force_sensor[0].emulator.silent_from_s = Some(SILENT_FROM);
    });
    assert_eq!(report.outcome, RunOutcome::Faulted);
    let faults: Vec<_> = report.faults.iter().map(|fault| fault.what.as_str()).collect();
    assert!(faults.iter().any(|what| what.contains("force sensor: no sample for")), "{faults:?}");
    assert!(faults.iter().any(|what| what.starts_with("force sensor wrist: no sample for")), "{faults:?}");
    assert!(!faults.iter().any(|what| what.contains("still has power")), "{faults:?}");
}

/// Time within the approach of the example, s since the emulated devices were switched on.
const SILENT_FROM: f64 = 17.0;

#[test]
fn an_absent_sensor_is_refused_before_motion() {
    let file = cell(|cell| cell.force_sensor[0].emulator.absent = true);
    let error = ::mrroc::run(&file, BenchKind::Lockstep, push_until::push).unwrap_err().to_string();
    assert!(error.starts_with("force sensor wrist, line /dev/serial/by-id/usb-wrist: no answer"), "{error}");
}

#[test]
fn a_task_that_names_another_sensor_is_refused_before_motion() {
    let file = CellFile::read(example("irb6")).unwrap();
    let error = ::mrroc::run(&file, BenchKind::Lockstep, push_until::push).unwrap_err().to_string();
    assert!(error.contains("the cell has no force sensor \"wrist\": add it as [[force_sensor]]"), "{error}");
}

#[test]
fn wrong_keys_are_refused_with_file_line_and_key() {
    let directory = Directory::new();
    let text = fs::read_to_string(example("irb6-wrist")).unwrap();
    let line = text[..text.find("force_range").unwrap()].matches('\n').count() + 1;
    let path = directory.write("cell.toml", &text.replacen("force_range", "forces", 1));
    let error = CellFile::read(&path).err().unwrap().to_string();
    let expected = format!("{}:{line}: force_sensor[0].forces: is an unknown key", path.display());
    assert!(error.starts_with(&expected), "{error}");
}
