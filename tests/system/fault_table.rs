//! The fault table of the laboratory: robots on both wires, in some phases.

use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::fault_table::{Detector, FaultOptions, FaultPhase, FaultTable, fault_table};
use ::mrroc::report::RunOutcome;
use ::mrroc::run::{Requests, RunOptions, run};
use ::mrroc::tasks::CarriedTask;

use crate::mrroc::{Directory, example, mrroc, root};

fn table(options: &FaultOptions) -> FaultTable {
    let lab = CellFile::read(example("lab")).unwrap();
    fault_table(&lab, options).unwrap()
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[test]
fn each_fault_ends_within_its_bound_or_is_tolerated() {
    let phase = vec![FaultPhase::Idle, FaultPhase::Cruising];
    let table = table(&FaultOptions { robot: names(&["irb6", "irp6-track"]), phase, ..FaultOptions::default() });
    assert!(table.played() >= 60, "{table}");
    let red: Vec<_> = table.red().map(|row| (row.fault, &row.robot, row.phase.name(), &row.reasons)).collect();
    assert!(red.is_empty(), "{red:?}");
    let stopped = table.rows.iter().filter(|row| !row.is_red() && row.result.is_some() && !row.is_tolerated());
    for row in stopped {
        let result = row.result.as_ref().unwrap();
        assert!(result.distance <= result.bound && result.still_after.is_some(), "{row:?}");
        assert!(result.detection < Some(Duration::from_millis(500)), "{row:?}");
    }
    let page = table.page(false);
    assert!(page.contains("| answers lost | irb6 | cruising | answers | 8 ms | 0 |"), "{page}");
    // A reset configures a drive that booted again, and the robot homes. An encoder that stood still may have lost counts.
    for fault in ["reset of a drive", "power cycle of a drive", "duplicate node-ID", "encoder frozen"] {
        let start = format!("| {fault} | irp6-track | cruising |");
        let row = page.lines().find(|line| line.starts_with(&start)).unwrap_or_default();
        assert!(row.ends_with("| reset, enable, home |"), "{fault}: {page}");
    }
}

#[test]
fn a_detector_that_is_off_turns_its_rows_red() {
    use Detector as D;
    use FaultPhase::{Braking, Contact, Cruising, Homing, Idle};
    for (off, fault, robot, phase) in [
        (D::Answers, "drive unplugged", "irp6-track", Cruising),
        (D::Answers, "answers lost", "irb6", Cruising),
        (D::Heartbeat, "heartbeat silent", "irp6-track", Cruising),
        (D::DriveStatus, "over-current", "irp6-track", Cruising),
        (D::DriveStatus, "over-current", "irb6", Cruising),
        (D::NodeState, "reset of a drive", "irb6", Cruising),
        (D::Plausibility, "encoder jumps by a turn", "irb6", Cruising),
        (D::Frozen, "answers stay the same", "irb6", Homing),
        (D::Frozen, "encoder frozen", "irb6", Homing),
        (D::Frozen, "encoder frozen", "irp6-track", Homing),
        (D::Frozen, "encoder frozen", "gripper", Braking),
        (D::Frozen, "encoder frozen", "conveyor", Cruising),
        (D::FollowingError, "collision", "irb6", Contact),
        (D::Brake, "brake does not hold", "polycrank", Idle),
        (D::LimitSwitches, "limit switch closed", "irb6", Cruising),
        (D::Port, "bus-off", "irp6-track", Cruising),
        (D::Port, "hang-up of a line", "irb6", Cruising),
        (D::Sending, "transmit queue full", "irp6-track", Cruising),
        (D::OtherController, "second master on the bus", "irp6-track", Cruising),
        (D::TimeOuts, "index missing", "irb6", Homing),
    ] {
        let on = FaultOptions {
            robot: names(&[robot]),
            fault: names(&[fault]),
            phase: vec![phase],
            once: true,
            ..FaultOptions::default()
        };
        let red = |table: &FaultTable| table.red().count();
        let with = table(&on);
        assert_eq!((with.played(), red(&with)), (1, 0), "{fault} on {robot}: {:?}", with.rows);
        let without = table(&FaultOptions { without: vec![off], ..on });
        assert_eq!(red(&without), 1, "{fault} on {robot} without {}: {:?}", off.name(), without.rows);
    }
}

#[test]
fn a_motor_that_no_following_error_stops_is_stopped_by_its_speed() {
    let options = |without: &[Detector]| FaultOptions {
        robot: names(&["irb6"]),
        fault: names(&["motor phases swapped"]),
        phase: vec![FaultPhase::Cruising],
        without: without.to_vec(),
        once: true,
        ..FaultOptions::default()
    };
    let found = |without: &[Detector]| table(&options(without)).rows[0].result.as_ref().unwrap().detector;
    assert_eq!(found(&[]), Some(Detector::FollowingError));
    assert_eq!(found(&[Detector::FollowingError]), Some(Detector::Runaway));
    assert_ne!(found(&[Detector::FollowingError, Detector::Runaway]), Some(Detector::Runaway));
}

const SCENARIO: &str = r#"
seed = 7

[[fault]]
when = "cruising"
kind = "over-current"
axis = "column"
duration = 0.5
"#;

#[test]
fn a_scenario_strikes_a_run_in_lockstep_in_the_same_cycle_each_time() {
    let directory = Directory::new();
    let scenario = directory.write("scenario.toml", SCENARIO);
    let file = CellFile::read(example("irb6")).unwrap();
    let options = RunOptions { scenario: Some(scenario), ..RunOptions::on(BenchKind::Lockstep) };
    let report = || run(&file, &options, &Requests::default(), &CarriedTask::default().program(), &mut |_| {}).unwrap();
    let [one, other] = [report(), report()];
    assert_eq!(one.outcome, RunOutcome::Faulted);
    assert!(one.faults[0].what.contains("over-current"), "{:?}", one.faults);
    // The report has the last cycles before the fault.
    let [one, other] = [one, other].map(|report| serde_json::to_string(&report.faults).unwrap());
    assert_eq!(one, other);
}

#[test]
fn the_example_scenario_is_tolerated() {
    let file = CellFile::read(example("irb6")).unwrap();
    let scenario = Some(root().join("cells/scenarios/irb6.toml"));
    let options = RunOptions { scenario, ..RunOptions::on(BenchKind::Lockstep) };
    let report = run(&file, &options, &Requests::default(), &CarriedTask::default().program(), &mut |_| {}).unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    let missed: u64 = report.buses.iter().map(|bus| bus.missed_answers).sum();
    assert!(missed >= 2, "{missed} missed answers");
}

#[test]
fn a_wrong_scenario_and_a_wrong_bench_are_refused_before_motion() {
    let directory = Directory::new();
    let scenario = directory.write("scenario.toml", &SCENARIO.replace("column", "colum"));
    let cell = example("irb6");
    let run = |bench: &str| {
        let arguments = ["run", cell.to_str().unwrap(), "--bench", bench, "--scenario", scenario.to_str().unwrap()];
        mrroc(arguments)
    };
    let refused = run("lockstep");
    assert_eq!(refused.status.code(), Some(2));
    assert!(refused.stderr.contains("scenario.toml:7: fault[0].axis: no axis is called"), "{refused:?}");
    let refused = run("vcan");
    assert_eq!(refused.status.code(), Some(2));
    assert!(refused.stderr.contains("--scenario needs --bench lockstep or emulated"), "{refused:?}");
}
