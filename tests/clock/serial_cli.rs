//! `mrroc run` on serial lines as seen by a user: on pseudo-terminals, and with an emulator in another process. The
//! emulator keeps running between runs.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::time::Duration;

use ::mrroc::cell::Cell;
use kit::mrroc::{Directory, Output, Running, SERIAL_CELLS, mrroc, shorten};
use kit::serial::{TRACKING, completed};
use kit::{PERIOD, by_the_clock, processors};
use serde_json::Value;

/// Tolerance of the position of a motor without power, which its friction holds: six counts, rad.
const STILL: f64 = 0.01;

#[test]
fn serial_cells_run_by_the_wall_clock_on_pseudo_terminals() {
    for name in SERIAL_CELLS {
        by_the_clock(0.4, PERIOD, || {
            let directory = Directory::new();
            let cell = directory.cell(name, shorten);
            let run = mrroc(["run".as_ref(), cell.as_os_str(), "--json".as_ref()]);
            let report = completed(&run, name, TRACKING);
            assert_eq!(report["bench"], "emulated");
            assert_eq!(report["cycle"]["bus_us"]["max"], 0.0, "{report}");
        });
    }
}

/// A shorter program and long time limits, because the answers of another process are later on a loaded machine.
pub(crate) fn patient(cell: &mut Cell) {
    shorten(cell);
    cell.serial[0].tolerated_missing = 10;
    cell.serial[0].answer_timeout_ms = 500;
    cell.max_missed_in_row = 100;
}

/// Starts `mrroc emulate --serial` and waits until all its ttys exist.
pub(crate) fn emulate(cell: &Path, ttys: &Path) -> Running {
    processors::precede();
    let emulator = Running::start(["emulate".as_ref(), cell.as_os_str(), "--serial".as_ref(), ttys.as_os_str()]);
    emulated(emulator, ttys)
}

/// Waits until all ttys of an emulator exist. The last tty must belong to this process, not to an earlier one.
pub(crate) fn emulated(emulator: Running, ttys: &Path) -> Running {
    let last = ttys.join("wrist-roll");
    for _ in 0..3000 {
        if emulator.has_open(&last) {
            return emulator;
        }
        can::clock::sleep_until(can::clock::now() + Duration::from_millis(10));
    }
    emulator.signal("TERM");
    panic!("the emulator never came up: {:?}", emulator.output());
}

pub(crate) fn run_on(cell: &Path, ttys: &Path, record: &Path) -> Running {
    Running::start(run_arguments(cell, ttys, record))
}

pub(crate) fn run_arguments<'a>(cell: &'a Path, ttys: &'a Path, record: &'a Path) -> [&'a OsStr; 8] {
    [
        "run".as_ref(),
        cell.as_os_str(),
        "--bench=card".as_ref(),
        "--serial".as_ref(),
        ttys.as_os_str(),
        "--json".as_ref(),
        "--record".as_ref(),
        record.as_os_str(),
    ]
}

/// The output of a run on the ttys of another process. `follow` follows the run.
pub(crate) fn output_on(
    cell: &Path,
    ttys: &Path,
    record: &Path,
    follow: impl Fn(&Running) -> Result<(), String>,
) -> Output {
    let _ = fs::remove_file(record);
    let run = run_on(cell, ttys, record);
    assert_eq!(follow(&run), Ok(()), "the run ended early");
    run.output()
}

/// `mrroc stop` finds the controller by its locks.
#[test]
fn a_running_controller_is_stopped_by_another_process() {
    by_the_clock(0.45, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6-serial", patient);
        let ttys = directory.path("ttys");
        let stop = || mrroc(["stop".as_ref(), cell.as_os_str(), "--serial".as_ref(), ttys.as_os_str()]);
        let _emulator = emulate(&cell, &ttys);
        let alone = stop();
        assert_eq!(alone.status.code(), Some(2), "{alone:?}");
        let line = ttys.join("column").display().to_string();
        let told = ["no process of this computer controls ", &line, "give the --can and --serial of the run"];
        assert!(told.iter().all(|part| alone.stderr.contains(part)), "{alone:?}");

        let record = directory.path("record.csv");
        let moving = |text: &str| text.matches(",wrist-roll,Moving,").count() > 50;
        let run = output_on(&cell, &ttys, &record, |run| {
            run.ended_before(&record, moving)?;
            let stopped = stop();
            assert_eq!(stopped.status.code(), Some(0), "{stopped:?}");
            assert!(stopped.stdout.contains(&format!("process {}: ended", run.id())), "{stopped:?}");
            Ok(())
        });
        assert_eq!((run.status.code(), &run.json()["outcome"]), (Some(1), &"stopped".into()), "{run:?}");
        assert_eq!(rows(&record).last().unwrap().0, "Off");
    });
}

/// Rows of the wrist roll in a record: phase and measured position, rad.
fn rows(record: &Path) -> Vec<(String, f64)> {
    let text = fs::read_to_string(record).unwrap();
    let rows = text.lines().filter(|line| line.contains(",wrist-roll,"));
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        (fields[3].to_owned(), fields[6].parse().unwrap())
    };
    rows.map(row).collect()
}

/// A run is ended by Ctrl-C, and further runs follow.
#[test]
fn an_emulator_in_another_process_outlives_runs() {
    by_the_clock(0.45, PERIOD, || {
        // Without a checksum, answers that a loaded machine delivers together count as damaged.
        let name = "irb6-serial";
        let directory = Directory::new();
        let cell = directory.cell(name, patient);
        let ttys = directory.path("ttys");
        let _emulator = emulate(&cell, &ttys);

        let record = directory.path("first.csv");
        let moving = |text: &str| text.matches(",wrist-roll,Moving,").count() > 50;
        let run = output_on(&cell, &ttys, &record, |run| {
            run.ended_before(&record, moving)?;
            run.signal("INT");
            Ok(())
        });
        assert_eq!(run.status.code(), Some(1), "{run:?}");
        let report = run.json();
        assert_eq!(report["outcome"], "stopped", "{report}");
        assert_eq!(report["faults"], Value::Array(Vec::new()), "{report}");
        let first = rows(&record);
        assert!(first.iter().any(|(phase, _)| phase == "Homing"));
        let (phase, left_at) = first.last().unwrap();
        assert_eq!(phase, "Off");

        // The drives kept their counters and references.
        let record = directory.path("second.csv");
        let report = output_on(&cell, &ttys, &record, |_| Ok(())).json();
        assert_eq!((&report["outcome"], &report["faults"]), (&"completed".into(), &serde_json::json!([])), "{report}");
        for axis in report["axes"].as_array().unwrap() {
            assert_eq!(axis["homing_offset_counts"], Value::Null, "{axis}");
        }
        let second = rows(&record);
        assert!(second.iter().all(|(phase, _)| phase != "Homing"), "{name}");
        let way = (second[0].1 - left_at).abs();
        assert!(way < STILL, "{name}: found {way:.3} rad from where it was left");
    });
}
