//! `mrroc run` as seen by a user: its output, its files and its exit status.

use std::fs;

use ::mrroc::cell::Cell;
use kit::full_disk;
use kit::mrroc::{CELLS, Directory, enables, example, mrroc, shorten, text, trace};
use serde_json::Value;

/// Largest following error in a lockstep run of an example cell, rad.
const TRACKING: f64 = 0.05;

/// Positions of emulated axes at power-on, above their home positions, rad.
const START: f64 = 20.0;

#[test]
fn lockstep_runs_are_the_same_bit_for_bit() {
    let directory = Directory::new();
    for cell in CELLS {
        let logs = ["a", "b"].map(|run| directory.path(&format!("{cell}-{run}.log")));
        for log in &logs {
            let run = mrroc([
                "run".as_ref(),
                example(cell).as_os_str(),
                "--bench=lockstep".as_ref(),
                "--trace".as_ref(),
                log.as_os_str(),
            ]);
            assert_eq!(run.status.code(), Some(0), "{run:?}");
            assert!(run.stdout.contains("completed"), "{run:?}");
            assert!(run.stdout.contains("times real time"), "{run:?}");
        }
        let [first, second] = logs.each_ref().map(|log| fs::read(log).unwrap());
        assert!(first == second, "{cell}: the traces differ");
        let trace = trace(&logs[0]);
        assert!(trace.len() > 10_000, "{cell}: {} frames", trace.len());
        assert!(enables(&trace) > 1000, "{cell} never moved");
        assert!(trace.is_sorted_by_key(|entry| entry.at), "{cell}");
    }
}

#[test]
fn json_is_one_object_with_every_figure() {
    for name in CELLS {
        let run = mrroc(["run".as_ref(), example(name).as_os_str(), "--bench=lockstep".as_ref(), "--json".as_ref()]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        assert_eq!(run.stdout.lines().count(), 1, "{run:?}");
        assert_eq!(run.stderr, "", "{name}");
        let report = run.json();
        assert_eq!(report["outcome"], "completed");
        assert_eq!(report["faults"], Value::Array(Vec::new()));
        assert!(number(&report["realtime_factor"]) > 1.0, "{report}");

        let cycle = &report["cycle"];
        assert_eq!(cycle["period_us"], 2000);
        assert_eq!(cycle["missed"], 0);
        assert!(number(&cycle["cycles"]) > 5000.0, "{report}");
        for times in ["wake_us", "step_us", "bus_us"] {
            let [p50, p99, p999, max] = ["p50", "p99", "p999", "max"].map(|key| number(&cycle[times][key]));
            assert!(p50 <= p99 && p99 <= p999 && p999 <= max, "{times}: {cycle}");
        }
        assert!(number(&cycle["bus_us"]["p50"]) > 100.0, "{cycle}");

        let buses = report["buses"].as_array().unwrap();
        assert_eq!(buses.len(), 1);
        assert_eq!(buses[0]["name"], "arm");
        assert!(number(&buses[0]["frames"]) > 10_000.0, "{report}");
        for percent in ["load_percent", "worst_case_percent"] {
            let percent = number(&buses[0][percent]);
            assert!(percent > 10.0 && percent < 100.0, "{report}");
        }
        check_axes(name, report["axes"].as_array().unwrap());
    }
}

fn check_axes(name: &str, reports: &[Value]) {
    let cell = Cell::parse(&text(name)).unwrap();
    let robot = &cell.robot[0];
    let home = robot.arm().unwrap().robot().home();
    assert_eq!(reports.len(), robot.axis.len());
    for ((axis, report), home) in robot.axis.iter().zip(reports).zip(home.iter()) {
        assert_eq!(report["name"], axis.name.as_str());
        let rms = number(&report["tracking_rms_rad"]);
        let peak = number(&report["tracking_peak_rad"]);
        assert!(0.0 < rms && rms < peak && peak < TRACKING, "{name}: {report}");
        let scale = f64::from(axis.counts_per_revolution()) / std::f64::consts::TAU;
        let expected = (home * scale).floor() - ((home + START) * scale).floor();
        let offset = number(&report["homing_offset_counts"]);
        assert!((offset - expected).abs() <= 1.0, "{name}: {report}, expected {expected}");
    }
}

#[test]
fn the_table_names_every_axis_and_the_outcome() {
    let run = mrroc(["run".as_ref(), example("irb6").as_os_str(), "--bench=lockstep".as_ref()]);
    for needle in ["column", "wrist-roll", "rms rad", "homing", "p99.9", "missed", "bus arm", "load"] {
        assert!(run.stdout.contains(needle), "{needle}: {}", run.stdout);
    }
    // Virtual time has no late wake-ups.
    assert!(!run.stdout.contains("wake-up"), "{}", run.stdout);
}

#[test]
fn the_task_home_homes_all_robots_and_moves_none() {
    let directory = Directory::new();
    let (cell, record) = (directory.cell("irb6", shorten), directory.path("home.csv"));
    let run = mrroc([
        "run".as_ref(),
        cell.as_os_str(),
        "--task=home".as_ref(),
        "--bench=lockstep".as_ref(),
        "--record".as_ref(),
        record.as_os_str(),
    ]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let record = fs::read_to_string(record).unwrap();
    assert!(record.contains(",Homing,") && !record.contains(",Moving,"));
    let run = mrroc(["run".as_ref(), cell.as_os_str(), "--task=dance".as_ref()]);
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    assert!(run.stderr.contains("programs, home"), "{run:?}");
}

#[test]
fn a_limit_of_file_size_does_not_stop_the_arm() {
    full_disk::limit_of_file_size_does_not_stop_the_arm();
}

#[test]
fn a_file_on_a_full_disk_does_not_stop_the_arm() {
    full_disk::does_not_stop_the_arm("lockstep");
    // A file that cannot be begun is refused before any motion.
    let (cell, words) = (example("irb6"), ["--bench=lockstep", "--record=/dev/full"]);
    let run = ["run".as_ref(), cell.as_os_str()];
    let refused = mrroc(run.into_iter().chain(words.map(AsRef::as_ref)));
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert!(refused.stderr.contains("--record: /dev/full: No space left"), "{refused:?}");
}

#[test]
fn a_fault_table_that_cannot_be_written_is_printed() {
    let cell = example("irb6");
    let table = |out: &[&str]| {
        let row = ["faults", cell.to_str().unwrap(), "--phase=idle", "--fault=over-current"];
        mrroc(row.into_iter().chain(out.iter().copied()))
    };
    let (printed, full) = (table(&[]), table(&["--out=/dev/full", "--force"]));
    assert_eq!(printed.status.code(), Some(0), "{printed:?}");
    assert_eq!((full.status.code(), full.stdout), (Some(1), printed.stdout));
    assert!(full.stderr.contains("--out: /dev/full: No space left on device"), "{}", full.stderr);
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}
