//! `mrroc run` by the clock, as seen by a user: signals, files and exit status.

use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use ::mrroc::cell::{Cell, Plant};
use kit::full_disk;
use kit::mrroc::{Directory, Output, Running, binary, example, mrroc, shorten, text};
use kit::{PERIOD, by_the_clock};
use serde_json::Value;

#[test]
fn the_wall_clock_bench_completes_without_a_fault() {
    by_the_clock(0.3, PERIOD, || {
        let run = mrroc(["run".as_ref(), example("irp6").as_os_str(), "--json".as_ref()]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let report = run.json();
        assert_eq!(report["outcome"], "completed");
        assert_eq!(report["bench"], "emulated");
        assert_eq!(report["faults"], Value::Array(Vec::new()));
        assert_eq!(report["lost_records"], 0);
        let factor = number(&report["realtime_factor"]);
        assert!((0.9..1.1).contains(&factor), "{report}");
        let seconds = number(&report["cycle"]["cycles"]) * 0.002;
        assert!(seconds < 60.0, "{seconds} s");
    });
}

#[test]
fn the_progress_bar_moves_while_a_robot_homes() {
    by_the_clock(0.3, Duration::from_millis(500), || {
        // A terminal.
        let command = format!("{} run {} --task=home", binary().display(), example("irb6").display());
        let run = Running::program(Path::new("script"), ["-qefc", &command, "/dev/null"]).output();
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let pictures = run.stdout.split(['\r', '\n']).filter(|picture| picture.contains("Homing"));
        let elapsed = |picture: &str| picture.split(" [").next()?.split_whitespace().next_back().map(str::to_owned);
        let mut times: Vec<_> = pictures.filter_map(elapsed).collect();
        times.dedup();
        assert!(times.len() >= 5, "{times:?}: {run:?}");
    });
}

#[test]
fn ctrl_c_in_motion_brakes_the_arm() {
    by_the_clock(0.25, PERIOD, || {
        stops_in_motion("INT");
    });
}

#[test]
fn sigterm_in_motion_brakes_the_arm() {
    by_the_clock(0.25, PERIOD, || {
        stops_in_motion("TERM");
    });
}

#[test]
fn ctrl_c_while_homing_ends_the_run_at_once() {
    by_the_clock(0.25, PERIOD, || {
        let (run, record) = interrupted("INT", |_| {}, "Homing", 200);
        stopped(&run);
        let last = record.lines().last().unwrap();
        assert!(last.contains(",Off,"), "{last}");
        let cycles = number(&run.json()["cycle"]["cycles"]);
        assert!(cycles < 2500.0, "{cycles} cycles for a stop after 200 of 5000");
    });
}

#[test]
fn a_file_on_a_full_disk_does_not_stop_the_arm_by_the_clock() {
    by_the_clock(0.25, PERIOD, || {
        full_disk::does_not_stop_the_arm("emulated");
    });
}

#[test]
fn a_stalled_trace_does_not_hold_up_a_stop() {
    by_the_clock(0.25, PERIOD, || {
        let directory = Directory::new();
        let [trace, record] = ["trace", "axes.csv"].map(|name| directory.path(name));
        let made = Command::new("mkfifo").arg(&trace).status();
        assert!(made.unwrap().success());
        // The pipe is open for writing and is never read.
        let pipe = fs::File::options().read(true).write(true).open(&trace);
        let run = Running::start([
            "run".as_ref(),
            example("irb6").as_os_str(),
            "--json".as_ref(),
            "--trace".as_ref(),
            trace.as_os_str(),
            "--record".as_ref(),
            record.as_os_str(),
        ]);
        // One thread writes both files. Once the pipe is full, the record stops growing.
        run.wait_until_stalled(&record, |text| text.contains(",Homing,"));
        run.signal("INT");
        let output = run.output();
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let report = output.json();
        assert_eq!(report["outcome"], "faulted", "{report}");
        let faults = report["faults"].as_array().unwrap();
        assert_eq!(faults.len(), 1, "{report}");
        assert_eq!(faults[0]["what"], "the trace or the record cannot be written in time");
        drop(pipe);
    });
}

pub(crate) fn stopped(run: &Output) {
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    let report = run.json();
    assert_eq!(report["outcome"], "stopped", "{report}");
    assert_eq!(report["faults"], Value::Array(Vec::new()));
    let causes = report["cycle"]["causes"].as_object().unwrap();
    let names: Vec<_> = causes.keys().collect();
    let expected = ["between cycles", "bus", "host", "late wake-up", "own step", "page fault", "preempted"];
    assert_eq!(names, expected);
    let count: f64 = causes.values().map(number).sum();
    let worst = report["cycle"]["worst"].as_array().unwrap();
    assert_eq!(worst.len(), (count as usize).min(8), "{report}");
    for late in worst {
        assert!(number(&causes[late["cause"].as_str().unwrap()]) > 0.0);
        assert!(number(&late["late_us"]) > 20.0, "{late}");
        assert!(number(&late["cycle"]) < number(&report["cycle"]["cycles"]));
    }
}

/// Runs the IRb-6 on the wall clock. Sends `signal` after axes were in `phase` for some cycles. Returns output and
/// record.
pub(crate) fn interrupted(
    signal: &str,
    change: impl FnOnce(&mut Cell),
    phase: &str,
    cycles: usize,
) -> (Output, String) {
    let directory = Directory::new();
    let cell = directory.cell("irb6", change);
    let record = directory.path("axes.csv");
    let run =
        Running::start(["run".as_ref(), cell.as_os_str(), "--json".as_ref(), "--record".as_ref(), record.as_os_str()]);
    let phase = format!(",wrist-roll,{phase},");
    run.wait_for(&record, |text| text.matches(&phase).count() > cycles);
    run.signal(signal);
    let output = run.output();
    (output, fs::read_to_string(&record).unwrap())
}

pub(crate) fn stops_in_motion(signal: &str) {
    let change = |cell: &mut Cell| {
        shorten(cell);
        // Without gravity and friction, the motor ends at the last set-point.
        let axes = cell.robot[0].axis.iter_mut();
        axes.for_each(|axis| axis.emulator.plant = Plant::Wut);
    };
    let (run, record) = interrupted(signal, change, "Moving", 150);
    stopped(&run);

    let period = 0.002;
    let limit = Cell::parse(&text("irb6")).unwrap().robot[0].axis[0].max_acceleration;
    let mut axes: HashMap<&str, Vec<Row>> = HashMap::new();
    assert!(record.lines().next().unwrap().ends_with(",dt_s"));
    for line in record.lines().skip(1) {
        // The time of an emulated cell is nominal.
        let dt = if line.starts_with("0,") { 0.0 } else { period };
        let (_, real) = line.rsplit_once(',').unwrap();
        assert_eq!(real.parse::<f64>().unwrap(), dt, "{line}");
        let row = Row::parse(line);
        axes.entry(row.axis).or_default().push(row);
    }
    let mut fastest = 0.0_f64;
    for (name, rows) in &axes {
        let braking = rows.iter().position(|row| row.phase == "Stopping").unwrap();
        let set_points: Vec<&Row> = rows[braking - 2..].iter().take_while(|row| row.phase != "Off").collect();
        let velocity = |pair: &[&Row]| (pair[1].commanded - pair[0].commanded) / period;
        let velocities: Vec<f64> = set_points.windows(2).map(velocity).collect();
        fastest = fastest.max(velocities[0].abs());
        for pair in velocities.windows(2) {
            let acceleration = (pair[1] - pair[0]).abs() / period;
            assert!(acceleration <= limit * 1.001, "{name}: {acceleration} rad/s²");
        }
        assert_eq!(*velocities.last().unwrap(), 0.0, "{name} was switched off in motion");
        let last = rows.last().unwrap();
        assert_eq!(last.phase, "Off", "{name}");
        assert!(last.velocity.abs() < 1.0, "{name} ends at {} rad/s", last.velocity);
    }
    assert!(fastest > 10.0, "nothing was in motion: {fastest} rad/s");
}

/// A line of a record.
struct Row<'a> {
    axis: &'a str,
    phase: &'a str,
    commanded: f64,
    velocity: f64,
}

impl<'a> Row<'a> {
    fn parse(line: &'a str) -> Self {
        let fields: Vec<&str> = line.split(',').collect();
        let [_, _, axis, phase, _, commanded, _, _, velocity, _, _, _] = fields[..] else {
            panic!("{line}");
        };
        Self { axis, phase, commanded: commanded.parse().unwrap(), velocity: velocity.parse().unwrap() }
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}
