//! Recordings of runs by the clock.

use std::fs;
use std::path::Path;

use ::mrroc::recording::{ReplayOptions, replay};
use kit::mrroc::{Directory, Running, mrroc};
use kit::recordings::{recorded, replayed, replays_whole, written};
use kit::{PERIOD, by_the_clock};

use crate::vcan::wait_until;

#[test]
fn a_run_by_the_clock_with_a_fault_replays_from_its_flight_file() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        // The emulated drive follows with a small error, which is a fault for the drive.
        let cell = written(&directory, "irb6", |cell| {
            cell.robot[0].axis[2].following_error = 0.02;
            cell.flight_recorder_s = 60;
        });
        let [recording, flights] = ["run.mcap", "flights"].map(|name| directory.path(name));
        fs::create_dir(&flights).unwrap();
        let mut arguments = recorded(&cell, "emulated", &recording).to_vec();
        arguments.extend(["--flight".into(), flights.to_str().unwrap().into()]);
        let run = mrroc(&arguments);
        assert_eq!(run.status.code(), Some(1), "{run:?}");
        let flight = flights.join("flight-irb6-1.mcap");
        assert_eq!(run.stderr, format!("mrroc: the last 60s are in {}\n", flight.display()));
        assert_eq!(fs::read_dir(&flights).unwrap().count(), 2, "the recording and its candump log");
        replays_whole(&run, &recording);
        let replay = replayed(&flight);
        assert!(replay.is_equal() && replay.cycles > 10, "{replay}");
        let [log, flight_log] = [&recording, &flight].map(|path| fs::read(path.with_extension("log")).unwrap());
        assert!(log.starts_with(&flight_log) && flight_log.len() > 10_000);
    });
}

#[test]
fn the_last_seconds_are_written_on_request_and_are_no_whole_run() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        let cell = written(&directory, "irb6", |cell| cell.flight_recorder_s = 1);
        let flight = directory.path("flight-irb6-1.mcap");
        // A hostile link of the name: it is neither followed nor replaced.
        std::os::unix::fs::symlink("victim", &flight).unwrap();
        let axes = directory.path("axes.csv");
        let [cell, axes] = [&cell, &axes].map(|path| path.to_str().unwrap());
        let here = directory.path("").to_str().unwrap().to_owned();
        let run = Running::start(["run", cell, "--json", "--record", axes, "--flight", &here]);
        run.wait_for(Path::new(axes), |text| text.contains(",Homing,"));
        run.signal("USR1");
        let log = directory.path("flight-irb6-2.log");
        wait_until("the file is there", || fs::read(&log).is_ok_and(|log| !log.is_empty()));
        run.signal("INT");
        let run = run.output();
        assert!(run.stderr.contains("flight-irb6-2.mcap"), "{run:?}");
        assert!(!directory.path("victim").exists());
        let refused = replay(&directory.path("flight-irb6-2.mcap"), &ReplayOptions::default()).unwrap_err().to_string();
        assert!(refused.contains("only the last seconds"), "{refused}");
    });
}

#[test]
fn a_killed_run_leaves_a_recording_up_to_the_last_second() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        let cell = written(&directory, "irb6", |_| {});
        let recording = directory.path("run.mcap");
        let run = Running::start(recorded(&cell, "emulated", &recording));
        let log = recording.with_extension("log");
        let last = || {
            let text = fs::read_to_string(&log).unwrap_or_default();
            text.lines().rev().nth(1)?.strip_prefix('(')?.split(')').next()?.parse::<f64>().ok()
        };
        let first = last().unwrap_or(0.0);
        wait_until("several seconds are on the disk", || last().is_some_and(|last| last > first + 3.0));
        let written = last().unwrap();
        run.signal("KILL");
        assert!(!run.status().success());
        let replay = replayed(&recording);
        assert!(replay.is_equal() && replay.cut.is_some(), "{replay}");
        // The metadata are not compressed.
        let bytes = fs::read(&recording).unwrap();
        let has = |text: &str| bytes.windows(text.len()).any(|it| it == text.as_bytes());
        assert!(has("x-mrroc") && has("utc_of_zero"), "the UTC of the zero");
        // The candump log is written as soon as some frames have come, and the recording twice per second.
        assert!(replay.end_s >= written - 1.0, "{replay:?}: {written} s are in the log");
    });
}
