//! `mrroc run` on pseudo-terminals whose other end is closed during motion: one line, or all lines at once.

use std::fs;
use std::os::fd::AsFd;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use ::mrroc::cell::Cell;
use can::{Instant, clock};
use hil::Pty;
use hil::pty::{self, Interest};
use kit::mrroc::{Directory, Running, SERIAL_CELLS};
use kit::{PERIOD, by_the_clock};
use serde_json::Value;
use serial::{Line, Settings, Tty};

use crate::serial_cli::{emulate, emulated, patient, run_arguments, run_on};

/// The axis whose line is lost.
const LOST: &str = "upper-arm";

/// Longest stop, in cycles of 2 ms: braking, and the wait for drives that may brake by themselves.
const LONGEST_STOP: usize = 175;

/// Longest time from the hang-up to the end of the run, in cycles of 2 ms: the stop, and the wait for drives that report no
/// power, of which one cannot be heard any more.
const LONGEST_END: usize = 1_000;

/// Mean use of processors.
const PROCESSORS: f64 = 0.45;

/// A cell with long time limits, and with loops that delays of a loaded host do not stop.
fn cell_of(cell: &mut Cell) {
    patient(cell);
    for axis in &mut cell.robot[0].axis {
        axis.following_error = 100.0;
    }
}

/// Relays bytes between a pseudo-terminal and the tty of an emulated axis controller, until it hangs up.
struct Relay {
    /// The thread ends when its copy is the only one.
    over: Option<Arc<AtomicBool>>,
    thread: Option<JoinHandle<()>>,
}

impl Relay {
    fn start(link: &Path, tty: &Path) -> Self {
        let mut host = Pty::linked(link).expect("a pseudo-terminal");
        let mut device = Tty::open(tty, Settings::AXIS_CONTROLLER).expect("the emulator's tty");
        let over = Arc::new(AtomicBool::new(false));
        let ended = over.clone();
        let thread = std::thread::spawn(move || {
            const LOOK: Duration = Duration::from_millis(20);
            let interest = Interest { read: true, write: false };
            let mut bytes = [0; 4096];
            while !ended.load(Ordering::Relaxed) {
                let ends = [(host.as_fd(), interest), (device.as_fd(), interest)];
                pty::wait(ends, clock::now() + LOOK).expect("the ends can be waited for");
                let count = host.read(&mut bytes).expect("the host's end");
                let _ = device.write(Instant::ZERO, &bytes[..count]);
                let count = device.read(Instant::ZERO, &mut bytes).unwrap_or(0);
                let _ = host.write(&bytes[..count]);
            }
            // The host's line closes with `host`; the line of the drive stays open.
            drop(host);
            while Arc::strong_count(&ended) > 1 {
                clock::sleep_until(clock::now() + LOOK);
            }
        });
        Self { over: Some(over), thread: Some(thread) }
    }

    fn hang_up(&self) {
        if let Some(over) = &self.over {
            over.store(true, Ordering::Relaxed);
        }
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.hang_up();
        drop(self.over.take());
        if let Some(thread) = self.thread.take() {
            // A failed relay has failed the test.
            let _ = thread.join();
        }
    }
}

/// Rows of an axis in a record: phase, command, commanded position.
fn rows(record: &Path, axis: &str) -> Vec<(String, String, f64)> {
    let text = fs::read_to_string(record).expect("the record is there");
    let rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let rows = rows.filter(|fields| fields[2] == axis);
    let row = |fields: Vec<&str>| {
        let commanded = fields[5].parse().expect("a number");
        (fields[3].to_owned(), fields[4].to_owned(), commanded)
    };
    rows.map(row).collect()
}

/// Runs a cell until it moves, then calls `hang_up`. Returns the report; the run writes the record.
fn run_until_hung_up(cell: &Path, ttys: &Path, record: &Path, hang_up: impl FnOnce()) -> Value {
    let stopped = |text: &str| text.contains(",Stopping,") || text.contains(",Faulted,");
    // An earlier run may have made the file.
    let _ = fs::remove_file(record);
    let run = run_on(cell, ttys, record);
    let moved = run.ended_before(record, |text| text.matches(",wrist-roll,Moving,").count() > 50 || stopped(text));
    let stopped = moved.is_err() || stopped(&fs::read_to_string(record).expect("the record"));
    hang_up();
    assert_eq!(moved, Ok(()), "the run ended before the line hung up");
    let run = run.output();
    assert!(!stopped, "the run stopped before the line hung up: {run:?}");
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    run.json()
}

/// Checks a run that ended by a lost line. The cause is the first fault, the stop ended in time, and the drive was
/// finally ordered to switch off. Returns the axis that the fault names.
fn ended_by_the_cause(report: &Value, record: &Path) -> String {
    assert_eq!(report["outcome"], "faulted", "{report}");
    let first = &report["faults"][0];
    let what = first["what"].as_str().expect("a text");
    assert!(what.contains("line is gone"), "{report}");
    let named = first["axis"].as_str().expect("an axis is named");
    assert!(!report["faults"].to_string().contains("Stopping"), "{report}");
    let rows = rows(record, named);
    let (_, last, _) = rows.last().expect("the record has rows");
    assert_eq!(last, "Off", "{named}");
    let stop: Vec<_> = rows.iter().filter(|row| row.0 == "Stopping").collect();
    assert!(stop.len() <= LONGEST_STOP, "{} cycles of stopping", stop.len());
    let end = rows.iter().skip_while(|row| row.0 != "Stopping").count();
    assert!(end <= LONGEST_END, "{end} cycles until the end of the run");
    let (_, _, believed) = stop[0];
    for (phase, command, commanded) in rows.iter().skip_while(|row| row.0 != "Stopping") {
        assert_eq!(commanded, believed, "{named}: {phase}, {command}");
    }
    named.to_owned()
}

#[test]
fn one_line_that_hangs_up_in_motion_is_the_cause_and_the_stop_ends_in_time() {
    for name in SERIAL_CELLS {
        let directory = Directory::new();
        let cell = directory.cell(name, cell_of);
        let ttys = directory.path("ttys");
        let relayed = directory.path("relayed");
        fs::create_dir(&relayed).expect("a directory of a new name");
        let _emulator = emulate(&cell, &ttys);
        for tty in fs::read_dir(&ttys).expect("the emulator's directory") {
            let tty = tty.expect("an entry").path();
            let axis = tty.file_name().expect("a link's name");
            if axis != LOST {
                symlink(&tty, relayed.join(axis)).expect("a link of a new name");
            }
        }
        let record = directory.path("record.csv");
        by_the_clock(PROCESSORS, PERIOD, || {
            let relay = Relay::start(&relayed.join(LOST), &ttys.join(LOST));
            let report = run_until_hung_up(&cell, &relayed, &record, || relay.hang_up());
            drop(relay);
            assert_eq!(ended_by_the_cause(&report, &record), LOST, "{report}");
        });
    }
}

#[test]
fn an_emulator_that_is_killed_in_motion_is_the_cause_and_the_stop_ends_in_time() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-serial", cell_of);
    let ttys = directory.path("ttys");
    let record = directory.path("record.csv");
    by_the_clock(PROCESSORS, PERIOD, || {
        // A killed emulator leaves links, and the emulator of another test may get the number of one of its terminals.
        let _ = fs::remove_dir_all(&ttys);
        let emulator = emulate(&cell, &ttys);
        let report = run_until_hung_up(&cell, &ttys, &record, || emulator.signal("KILL"));
        ended_by_the_cause(&report, &record);
    });
}

/// A killed run leaves its ttys to the emulator. A killed emulator leaves its links, whose terminals get new owners.
#[test]
fn an_unprivileged_user_goes_on_after_a_run_and_an_emulator_were_killed() {
    by_the_clock(0.45, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6-serial", cell_of);
        let ttys = directory.path("ttys");
        let emulate = || {
            let arguments = ["emulate".as_ref(), cell.as_os_str(), "--serial".as_ref(), ttys.as_os_str()];
            emulated(Running::unprivileged(&directory, arguments), &ttys)
        };
        // Runs until the drives are up, so that all lines are open.
        let run = |record: &Path| {
            let run = Running::unprivileged(&directory, run_arguments(&cell, &ttys, record));
            let up = run.ended_before(record, |text| text.contains(",wrist-roll,"));
            assert_eq!(up, Ok(()), "the drives do not come up");
            run
        };
        let emulator = emulate();
        let killed = run(&directory.path("killed.csv"));
        killed.signal("KILL");
        killed.output();
        let next = run(&directory.path("next.csv"));
        next.signal("INT");
        next.output();

        emulator.signal("KILL");
        emulator.output();
        let links = || fs::read_dir(&ttys).expect("the emulator's directory");
        let links = || links().map(|link| link.expect("an entry").path());
        // These terminals reuse the numbers of the killed emulator.
        let others: Vec<_> = (0..8).map(|_| Pty::open().expect("a terminal")).collect();
        assert!(links().any(|link| link.exists()), "{others:?}");
        let _emulator = emulate();
        let last = run(&directory.path("last.csv"));
        last.signal("INT");
        last.output();
    });
}
