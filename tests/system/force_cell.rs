//! A cell with a force/torque sensor at the wrist: from the cell file to the task, in lockstep.

use std::fs;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile, EmulatedTemperature};
use ::mrroc::prelude::{Outcome, RunOutcome};
use ::mrroc::report::RunReport;
use ::mrroc::tasks;
use kit::mrroc::{Directory, example};

#[path = "../../examples/push_until.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
pub(crate) mod push_until;

/// The example cells: with the sensor on a serial line, and on the CAN bus of the drives.
const CELLS: [&str; 2] = ["irb6-wrist", "irb6-can-wrist"];

/// An example cell after a change.
fn cell(name: &str, change: impl FnOnce(&mut Cell)) -> CellFile {
    let directory = Directory::new();
    CellFile::read(directory.cell(name, change)).unwrap()
}

/// Runs the example in lockstep.
fn push(name: &str, change: impl FnOnce(&mut Cell)) -> RunReport {
    ::mrroc::run(&cell(name, change), BenchKind::Lockstep, push_until::push).unwrap()
}

fn figure(report: &RunReport, name: &str) -> f64 {
    report.figures[name]
}

#[test]
fn the_contact_force_is_stiffness_times_indentation() {
    for (name, stiffness) in [(CELLS[0], 5e3), (CELLS[0], 2e4), (CELLS[1], 5e3), (CELLS[1], 2e4)] {
        let report = push(name, |cell| cell.scene.as_mut().unwrap().plane[0].stiffness = stiffness);
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
        let indentation = 0.78 - figure(&report, "tool_height_m");
        let force = figure(&report, "force_n");
        // Half a count of the sensor is 9 µm at 5,000 N/m, and a count of a motor up to 9 µm of the tool.
        let error = (force / stiffness - indentation).abs();
        assert!(error < 2e-5, "{force} N at {indentation} m and {stiffness} N/m");
        // In motion, the damper of the table adds up to 3 N to the reading. Up to the stop, the
        // tool moves on for three macrosteps of 0.2 mm.
        let range = 17.0..20.0 + 6e-4 * stiffness;
        assert!(range.contains(&force), "{force} N at {stiffness} N/m");
        println!("{name}, {stiffness} N/m: {force:.2} N, peak {:.2} N", figure(&report, "peak_force_n"));
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
    // Three counts of the sensor on the serial line. The sensor on the bus keeps the same bound. The tool weighs 10.8 N.
    for kind in CELLS {
        let file = cell(kind, |cell| cell.force_sensor[0].emulator.offset = [3.0, -5.0, 8.0, 0.1, 0.2, -0.3]);
        let report = ::mrroc::run(&file, BenchKind::Lockstep, turn).unwrap();
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
        for name in ["up_n", "down_n"] {
            assert!(figure(&report, name) < 0.26, "{kind}, {name}: {}", figure(&report, name));
        }
    }
}

#[test]
fn a_sensor_that_warms_up_drifts_and_a_zeroing_removes_the_drift() {
    async fn wait(cell: &mut tasks::Cell) -> Outcome {
        let wrist = cell.force_sensor("wrist")?;
        cell.figure("cold_n", wrist.read()?.1.in_sensor()?.force.x);
        // Eight time constants.
        cell.sleep(std::time::Duration::from_secs(40)).await;
        cell.figure("warm_n", wrist.read()?.1.in_sensor()?.force.x);
        cell.figure("warm_nm", wrist.read()?.1.in_sensor()?.torque.z);
        wrist.zero().await?;
        let zeroed = wrist.read()?.1.in_sensor()?;
        cell.figure("zeroed_n", zeroed.force.norm() + zeroed.torque.norm());
        Ok(())
    }
    // Half a count of force and of torque.
    for (name, [force, torque]) in CELLS.into_iter().zip([[0.044, 0.0027], [0.011, 0.0006]]) {
        let file = cell(name, |cell| {
            let sensor = &mut cell.force_sensor[0];
            // A sensor without a tool reads before homing as well.
            sensor.tool.mass = 0.0;
            sensor.emulator.drift = [-0.25, 0.0, 0.0, 0.0, 0.0, 0.02];
            let course = EmulatedTemperature { start: 20.0, end: 60.0, time_constant_s: 5.0 };
            sensor.emulator.temperature = Some(course);
        });
        let report = ::mrroc::run(&file, BenchKind::Lockstep, wait).unwrap();
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
        // 40 K at -0.25 N/K and 0.02 N·m/K.
        assert!(figure(&report, "cold_n").abs() < 3.0, "{name}: {}", figure(&report, "cold_n"));
        assert!((figure(&report, "warm_n") + 10.0).abs() < force + 0.004, "{name}: {}", figure(&report, "warm_n"));
        assert!((figure(&report, "warm_nm") - 0.8).abs() < torque, "{name}: {}", figure(&report, "warm_nm"));
        assert!(figure(&report, "zeroed_n") < 1e-9, "{name}: {}", figure(&report, "zeroed_n"));
    }
}

#[test]
fn silence_of_the_sensor_stops_the_approach_with_a_report_that_names_the_sensor() {
    for name in CELLS {
        let report = push(name, |cell| {
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
}

/// Time within the approach of the example, s since the emulated devices were switched on.
const SILENT_FROM: f64 = 17.0;

#[test]
fn an_absent_sensor_is_refused_before_motion() {
    let places = ["force sensor wrist, line /dev/serial/by-id/usb-wrist: no answer", "bus arm, force sensor wrist: "];
    for (name, place) in CELLS.into_iter().zip(places) {
        let file = cell(name, |cell| cell.force_sensor[0].emulator.absent = true);
        let error = ::mrroc::run(&file, BenchKind::Lockstep, push_until::push).unwrap_err().to_string();
        assert!(error.starts_with(place), "{error}");
    }
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
