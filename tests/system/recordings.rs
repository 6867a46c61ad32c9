//! Recordings of runs: their replay, their differences from another cell, and what a broken recording still has.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use ::mrroc::cell::Cell;
use ::mrroc::recording::{Replay, ReplayOptions, replay};
use serde_json::Value;

use crate::bench::turn;
use crate::mrroc::{Directory, Output, Running, mrroc, shorten, text};
use crate::random::draw::Draw;
use crate::vcan::wait_until;

/// A changed example cell as a file.
fn written(directory: &Directory, name: &str, change: impl FnOnce(&mut Cell)) -> PathBuf {
    let mut cell = Cell::parse(&text(name)).unwrap();
    shorten(&mut cell);
    change(&mut cell);
    let path = directory.path(&format!("{name}.toml"));
    fs::write(&path, toml::to_string(&cell).unwrap()).unwrap();
    path
}

/// Arguments of a run with a recording.
fn recorded(cell: &Path, bench: &str, recording: &Path) -> [String; 7] {
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    ["run".into(), text(cell), "--bench".into(), bench.into(), "--json".into(), "--record".into(), text(recording)]
}

fn replayed(recording: &Path) -> Replay {
    replay(recording, &ReplayOptions::default()).unwrap()
}

fn cycles(report: &Value) -> u64 {
    report["cycle"]["cycles"].as_u64().unwrap()
}

/// Asserts that a run replays bit for bit, from its first to its last cycle.
fn replays_whole(run: &Output, recording: &Path) -> Replay {
    let replay = replayed(recording);
    assert!(replay.is_equal(), "{replay}");
    assert_eq!((replay.cycles, &replay.cut), (cycles(&run.json()), &None), "{replay}");
    assert!(replay.equal > 2 * replay.cycles, "{replay}");
    replay
}

#[test]
fn recordings_of_all_kinds_of_cells_replay_bit_for_bit() {
    let directory = Directory::new();
    // Drives on CAN, inputs and outputs, a force sensor with a law, lines, ultrasound, and several robots.
    for name in ["irb6", "irb6-touch", "irb6-force", "irb6-serial", "irb6-sonar", "irb6-can-wrist", "lab"] {
        let cell = written(&directory, name, |_| {});
        let recording = directory.path(&format!("{name}.mcap"));
        let run = mrroc(recorded(&cell, "lockstep", &recording));
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        replays_whole(&run, &recording);
    }
}

#[test]
fn a_run_by_the_clock_with_a_fault_replays_from_its_flight_file() {
    let _turn = turn();
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
}

#[test]
fn the_last_seconds_are_written_on_request_and_are_no_whole_run() {
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
}

#[test]
fn a_changed_limit_is_found_in_its_first_cycle() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |_| {});
    let recording = directory.path("run.mcap");
    let run = mrroc(recorded(&cell, "lockstep", &recording));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let whole = replays_whole(&run, &recording);
    let limit = 20.0;
    let slower = written(&directory, "irb6", |cell| cell.robot[0].axis[0].max_velocity = limit);
    let options = ReplayOptions { cell: Some(slower.clone()) };
    let changed = replay(&recording, &options).unwrap();
    let place = changed.differs_in.unwrap_or_else(|| panic!("{changed}"));
    assert_eq!(place.cycle, Some(changed.cycles - 1), "{changed}");
    assert!(changed.cycles < whole.cycles);
    let of =
        |value: &str| changed.differences.iter().find(|it| it.value == value).unwrap_or_else(|| panic!("{changed:?}"));
    let phase = of("phase");
    assert_eq!((phase.recorded.as_str(), phase.replayed.as_str()), ("Moving", "Stopping"));
    let fault = of("output");
    assert!(fault.replayed.contains("the limit is 20.000 rad/s"), "{changed:?}");
    let command =
        mrroc(["replay".as_ref(), recording.as_os_str(), "--cell".as_ref(), slower.as_os_str(), "--diff".as_ref()]);
    assert_eq!(command.status.code(), Some(1), "{command:?}");
    assert!(command.stdout.contains("differs first in cycle") && command.stdout.contains("rad/s"), "{command:?}");
    let other = replay(&recording, &ReplayOptions { cell: Some(crate::mrroc::example("rnt")) }).unwrap_err();
    assert!(format!("{other:#}").contains("other robots, axes, buses or lines"), "{other:#}");
}

#[test]
fn a_recording_cut_at_any_length_has_all_whole_chunks() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |_| {});
    let recording = directory.path("run.mcap");
    let run = mrroc(recorded(&cell, "lockstep", &recording));
    let whole = replays_whole(&run, &recording);
    let bytes = fs::read(&recording).unwrap();
    let cut = directory.path("cut.mcap");
    let mut draw = Draw::of(15, 0);
    let mut most = 0;
    for _ in 0..20 {
        let length = draw.within(0.0, bytes.len() as f64) as usize;
        fs::write(&cut, &bytes[..length]).unwrap();
        match replay(&cut, &ReplayOptions::default()) {
            Ok(replay) => {
                assert!(replay.is_equal() && replay.cut.is_some(), "{length} bytes: {replay}");
                // A chunk has at most 1 MiB, and the file most of a second.
                let share = replay.cycles as f64 / whole.cycles as f64;
                let expected = length as f64 / bytes.len() as f64;
                assert!(share > expected - 0.25, "{length} bytes: {replay}");
                most = most.max(replay.cycles);
            }
            // The bring-up in lockstep is written at its end.
            Err(error) => assert!(length < bytes.len() / 4, "{length} bytes: {error:#}"),
        }
    }
    assert!(most > whole.cycles / 2);
    for place in [100, 5000, bytes.len() / 2] {
        let mut damaged = bytes.clone();
        damaged[place..place + 64].fill(0xA5);
        fs::write(&cut, &damaged).unwrap();
        // Damage is reported as damage, or nothing can be replayed. A difference is reported in neither case.
        if let Ok(replay) = replay(&cut, &ReplayOptions::default()) {
            assert!(replay.is_equal() && replay.damaged.is_some(), "byte {place}: {replay}");
        }
        let command = mrroc(["replay".as_ref(), cut.as_os_str()]);
        assert_eq!(command.status.code(), Some(2), "byte {place}: {command:?}");
    }
}

#[test]
fn a_killed_run_leaves_a_recording_up_to_the_last_second() {
    let _turn = turn();
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
    // The candump log is written as soon as some frames have come, and the recording twice per second.
    assert!(replay.end_s >= written - 1.0, "{replay:?}: {written} s are in the log");
}

#[test]
fn a_recording_that_fails_is_said_once_and_the_run_goes_on() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |_| {});
    let recording = directory.path("pipe.mcap");
    assert!(Command::new("mkfifo").arg(&recording).status().unwrap().success());
    // The reader ends after some chunks, which fails the next one as a full disk does.
    let pipe = recording.clone();
    let reader = thread::spawn(move || {
        let mut file = fs::File::open(pipe).unwrap();
        file.read_exact(&mut vec![0; 200_000]).unwrap();
    });
    let mut run = recorded(&cell, "lockstep", &recording).to_vec();
    run.push("--force".into());
    let run = loop {
        // The run is refused until the reader has opened the pipe.
        let run = mrroc(&run);
        if run.status.code() != Some(2) {
            break run;
        }
    };
    reader.join().unwrap();
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    let said = format!("mrroc: --record: {}: Broken pipe", recording.display());
    assert!(run.stderr.starts_with(&said), "{run:?}");
    assert_eq!(run.stderr.matches("the file ends here, and the run goes on").count(), 1, "{run:?}");
    let report = run.json();
    assert_eq!((&report["outcome"], &report["faults"]), (&"completed".into(), &Value::Array(Vec::new())), "{report}");
    let files = report["incomplete_files"].as_array().unwrap();
    assert_eq!(files.len(), 1, "{report}");
    assert_eq!((&files[0]["path"], &files[0]["entries"]), (&recording.to_str().into(), &"messages".into()), "{report}");
    let whole = mrroc(recorded(&cell, "lockstep", &directory.path("whole.mcap")));
    assert_eq!(cycles(&whole.json()), cycles(&report), "the run went on to its end");
}
