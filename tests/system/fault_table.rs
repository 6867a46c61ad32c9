//! The fault table of the laboratory: robots on both wires, in some phases.

use std::fs;
use std::time::Duration;

use ::faults::{Detector, FaultOptions, FaultPhase, FaultTable, fault_table};
use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::report::{RunOutcome, RunReport};
use ::mrroc::run::{Requests, RunOptions, run};
use ::mrroc::tasks::CarriedTask;
use kit::mrroc::{Directory, example, mrroc, root};

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
        // The share of missed deadlines is judged over 1000 deadlines.
        let slow = row.fault == "each third deadline missed";
        let most = Duration::from_millis(if slow { 4000 } else { 500 });
        assert!(result.detection < Some(most), "{row:?}");
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
fn faults_of_host_generator_and_contact_are_found_in_each_phase_by_their_causes() {
    use Detector as D;
    const BOTH: &[&str] = &["irb6", "gripper"];
    for (fault, robots, phases, detector, cause) in [
        ("interface removed", &["gripper"][..], 7, D::Port, "interface was removed"),
        ("too many deadlines missed", BOTH, 7, D::Deadlines, "4 cycles in a row missed their deadline"),
        ("each third deadline missed", BOTH, 2, D::Deadlines, "cycles missed their deadlines"),
        ("emergency stop", BOTH, 7, D::EmergencyStop, "emergency stop by input 0 of node"),
        ("set-point not a number", BOTH, 5, D::SetPoints, "set-point is not a finite number"),
        ("set-point beyond a position limit", BOTH, 5, D::SetPoints, "is beyond its limit"),
        ("set-point beyond the greatest velocity", BOTH, 5, D::SetPoints, "needs a motor velocity of"),
        ("set-point beyond the greatest acceleration", BOTH, 5, D::SetPoints, "needs a motor acceleration of"),
        ("no macrostep in time", BOTH, 5, D::SetPoints, "no macrostep in time after number"),
    ] {
        let options =
            FaultOptions { robot: names(robots), fault: names(&[fault]), once: true, ..FaultOptions::default() };
        let table = table(&options);
        let played: Vec<_> = table.rows.iter().filter_map(|row| Some((row, row.result.as_ref()?))).collect();
        assert_eq!((played.len(), table.red().count()), (phases * robots.len(), 0), "{}", table.page(false));
        for (row, result) in played {
            assert_eq!(result.detector, Some(detector), "{row:?}");
            assert!(result.cause.as_ref().is_some_and(|it| it.contains(cause)), "{row:?}");
            // A removed interface does not come back.
            assert_eq!(result.recovery == "restart", detector == D::Port, "{row:?}");
        }
    }
    let fault = names(&["tolerated number of deadlines missed"]);
    let tolerated = table(&FaultOptions { robot: names(BOTH), fault, once: true, ..FaultOptions::default() });
    assert_eq!((tolerated.played(), tolerated.red().count()), (14, 0), "{}", tolerated.page(false));
}

#[test]
fn a_detector_that_is_off_turns_its_rows_red() {
    use Detector as D;
    use FaultPhase::{Braking, Contact, Cruising, Homing, Idle};
    let check = |always: &[Detector], off: Detector, fault, robot, phase| {
        let on = FaultOptions {
            robot: names(&[robot]),
            fault: names(&[fault]),
            phase: vec![phase],
            without: always.to_vec(),
            once: true,
            ..FaultOptions::default()
        };
        let red = |table: &FaultTable| table.red().count();
        let with = table(&on);
        assert_eq!((with.played(), red(&with)), (1, 0), "{fault} on {robot}: {:?}", with.rows);
        let without = [always, &[off]].concat();
        let without = table(&FaultOptions { without, ..on });
        assert_eq!(red(&without), 1, "{fault} on {robot} without {}: {:?}", off.name(), without.rows);
    };
    for (off, fault, robot, phase) in [
        (D::Answers, "drive unplugged", "irp6-track", Cruising),
        (D::Answers, "answers lost", "irb6", Cruising),
        (D::Answers, "answers 2 ms late, serial", "irb6", Cruising),
        (D::Answers, "answers of all drives 4 ms late, serial", "irb6", Idle),
        (D::Answers, "answers of two axes swapped", "irb6", Cruising),
        (D::Answers, "host frames held for 200 ms", "irp6-track", Cruising),
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
        (D::Port, "interface removed", "irp6-track", Cruising),
        (D::Deadlines, "too many deadlines missed", "irp6-track", Cruising),
        (D::Deadlines, "too many deadlines missed", "irb6", Homing),
        (D::Deadlines, "each third deadline missed", "gripper", Idle),
        (D::EmergencyStop, "emergency stop", "irp6-track", Cruising),
        (D::EmergencyStop, "emergency stop", "irb6", Cruising),
    ] {
        check(&[], off, fault, robot, phase);
    }
    // The following error acts earlier than the greatest velocity.
    check(&[D::FollowingError], D::Runaway, "encoder inverted", "irb6", Cruising);
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

/// The report of the carried task on an example cell, in lockstep with this scenario.
fn played(cell: &str, scenario: &str) -> RunReport {
    let directory = Directory::new();
    let scenario = Some(directory.write("scenario.toml", scenario));
    let file = CellFile::read(example(cell)).unwrap();
    let options = RunOptions { scenario, ..RunOptions::on(BenchKind::Lockstep) };
    run(&file, &options, &Requests::default(), &CarriedTask::default().program(), &mut |_| {}).unwrap()
}

#[test]
fn one_lost_telegram_of_a_serial_line_is_tolerated() {
    let report = played("irb6-serial", "[[fault]]\nat = 6.0\nkind = \"lost\"\naxis = \"column\"\ncount = 1\n");
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    assert_eq!(report.buses[0].missed_answers, 1);
    assert!(report.idle_faults.is_empty(), "{:?}", report.idle_faults);
}

#[test]
fn a_fault_that_has_not_acted_is_a_warning_of_the_report() {
    let report = played("irb6", "[[fault]]\nat = 5000.0\nkind = \"lost\"\naxis = \"column\"\n");
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    let line = "scenario: fault[0] (lost, at 5000 s) has not acted";
    assert!(report.to_string().contains(&format!("warning: {line}\n")), "{report}");
    assert_eq!(serde_json::to_value(&report).unwrap()["idle_faults"], serde_json::json!([line]));
}

#[test]
fn the_scenario_of_the_page_plays_both_faults() {
    let page = fs::read_to_string(root().join("book/src/fault-table.md")).unwrap();
    let (_, scenario) = page.split_once("```text\n").unwrap();
    let (scenario, _) = scenario.split_once("```").unwrap();
    let report = played("irb6", scenario);
    assert!(report.idle_faults.is_empty(), "{:?}", report.idle_faults);
    let stopped = report.faults[0].time_s.unwrap();
    assert!(report.faults[0].what.contains("over-current") && stopped > 10.0, "{:?}", report.faults);
    assert_eq!(report.buses[0].missed_answers, 1);
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

#[test]
fn wrong_answers_of_the_older_telegrams_are_named_and_late_ones_are_found() {
    let file = CellFile::read(example("irb6-hi-moxa")).unwrap();
    let rows = |fault: &str, phase: FaultPhase| {
        let options =
            FaultOptions { fault: names(&[fault]), phase: vec![phase], once: true, ..FaultOptions::default() };
        let table = fault_table(&file, &options).unwrap();
        assert_eq!((table.played(), table.red().count()), (1, 0), "{fault}, {}: {}", phase.name(), table.page(false));
        table.rows[0].result.clone().unwrap()
    };
    for (fault, cause) in [
        ("every second answer old", "old answers again"),
        ("answers reversed in pairs", "answers in reversed order"),
        ("answers garbled", "whole answers with wrong contents"),
        ("answers of two axes swapped", "answers are those of line"),
        ("answers 2 ms late, serial", "1 period late"),
        ("answers of all drives 4 ms late, serial", "2 periods late"),
        ("answers of all drives 40 ms late, serial", "no answer to be believed"),
    ] {
        let found = rows(fault, FaultPhase::Cruising).cause;
        assert!(found.as_ref().is_some_and(|found| found.contains(cause)), "{fault}: {found:?}");
    }
    for phase in FaultPhase::ALL.into_iter().filter(|phase| !matches!(phase, FaultPhase::Team)) {
        for fault in ["answers garbled", "answers of all drives 4 ms late, serial", "answers 1 ms late, serial"] {
            rows(fault, phase);
        }
    }
}

/// At rest, the plausibility check finds the steps alone. The drive of the conveyor takes a seventh of a step back within
/// a period.
#[test]
fn a_jump_is_found_from_the_stated_step_on_at_rest_and_at_top_speed() {
    use Detector as D;
    let jumps = |cell: &str, robots: &[&str], at: &str, without: &[Detector]| {
        let multiples = ["half the smallest step", "the smallest step", "1.5 smallest steps", "ten smallest steps"];
        let options = FaultOptions {
            robot: names(robots),
            fault: multiples.map(|by| format!("encoder jumps by {by}, {at}")).to_vec(),
            phase: vec![if at == "at rest" { FaultPhase::Idle } else { FaultPhase::Cruising }],
            without: without.to_vec(),
            once: true,
            ..FaultOptions::default()
        };
        let table = fault_table(&CellFile::read(example(cell)).unwrap(), &options).unwrap();
        assert_eq!(table.played(), 4 * robots.len(), "{table}");
        table
    };
    for (cell, robots) in [("lab", &["irb6", "irp6-track", "conveyor"][..]), ("irb6-hi-moxa", &["irb6"])] {
        for at in ["at rest", "at top speed"] {
            let table = jumps(cell, robots, at, &[]);
            let page = table.page(false);
            assert_eq!(table.red().count(), 0, "{page}");
            // Twenty times 1500 rad/s² in 2 ms, and four increments of 4000 in a turn.
            assert!(page.contains("| irb6.column | 0.126 rad |"), "{page}");
            let blind = jumps(cell, robots, at, &[D::Plausibility, D::Frozen, D::FollowingError, D::DriveStatus]);
            let greater = blind.red().filter(|row| row.fault.contains("smallest steps")).count();
            assert_eq!(greater, 2 * robots.len(), "{}", blind.page(false));
        }
        let alone = jumps(cell, robots, "at rest", &[D::Frozen, D::FollowingError, D::DriveStatus]);
        assert_eq!(alone.red().count(), 0, "{}", alone.page(false));
    }
}
