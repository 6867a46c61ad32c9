//! Signals that end or suspend a run, during motion and while an operation blocks.

use std::fs;
use std::io::{self, Write};
use std::thread;

use kit::mrroc::{Directory, Running, shorten};
use kit::{PERIOD, by_the_clock};

use crate::cli_run::{interrupted, stopped, stops_in_motion};

/// Signals that end or suspend a process by default. Not included: INT and TERM, which `cli_run` sends, and the signals
/// that `mrroc/src/signals.rs` ignores.
const ENDING: [&str; 18] = [
    "HUP", "QUIT", "TRAP", "ABRT", "USR2", "ALRM", "16", "XCPU", "VTALRM", "PROF", "29", "PWR", "SYS", "TSTP", "34",
    "35", "63", "64",
];

#[test]
fn every_signal_that_would_end_or_suspend_a_run_brakes_the_arm() {
    thread::scope(|scope| {
        for signal in ENDING {
            scope.spawn(move || by_the_clock(0.25, PERIOD, || stops_in_motion(signal)));
        }
    });
}

/// The kernel sends SIGTTOU to a background process that writes to a terminal under `stty tostop`, and SIGTTIN to a
/// background process that reads.
#[test]
fn a_run_in_the_background_is_not_suspended_by_its_terminal() {
    by_the_clock(0.25, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6", shorten);
        let record = directory.path("axes.csv");
        let run = Running::start([
            "run".as_ref(),
            cell.as_os_str(),
            "--json".as_ref(),
            "--record".as_ref(),
            record.as_os_str(),
        ]);
        let lines = |text: &str| text.lines().count();
        run.wait_for(&record, |text| lines(text) > 200);
        for signal in ["TTOU", "TTIN", "PIPE", "XFSZ"] {
            run.signal(signal);
        }
        let before = lines(&fs::read_to_string(&record).unwrap());
        run.wait_for(&record, |text| lines(text) > before + 2000);
        run.signal("INT");
        stopped(&run.output());
    });
}

#[test]
fn ctrl_z_while_homing_ends_the_run() {
    by_the_clock(0.25, PERIOD, || {
        let (run, record) = interrupted("TSTP", |_| {}, "Homing", 200);
        stopped(&run);
        assert!(record.lines().last().unwrap().contains(",Off,"));
    });
}

/// Three requests to end, all different, because two equal signals could merge.
const THREE: [&str; 3] = ["INT", "TERM", "HUP"];

#[test]
fn the_third_request_ends_an_emulated_run_whose_report_nobody_reads() {
    by_the_clock(0.25, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6", |cell| {
            shorten(cell);
            cell.robot[0].program.truncate(1);
        });
        let record = directory.path("axes.csv");
        let (pipe, mut full) = io::pipe().unwrap();
        // Capacity of a pipe (pipe(7)).
        full.write_all(&[b'x'; 65536]).unwrap();
        let run = Running::with_stdout(
            full,
            ["run".as_ref(), cell.as_os_str(), "--json".as_ref(), "--record".as_ref(), record.as_os_str()],
        );
        run.wait_until_stalled(&record, |text| {
            let last = text.lines().last();
            text.contains(",Moving,") && last.is_some_and(|last| last.contains(",Off,"))
        });
        THREE.into_iter().for_each(|signal| run.signal(signal));
        assert_eq!(run.status().code(), Some(1));
        drop(pipe);
    });
}
