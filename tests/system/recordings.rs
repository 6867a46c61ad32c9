//! Recordings of runs: their replay, their differences from another cell, and what a broken recording still has.

use std::io::Read;
use std::path::Path;
use std::process::{Command, Output};
use std::{fs, thread};

use ::mrroc::recording::{ReplayOptions, replay};
use kit::draw::Draw;
use kit::mrroc::{Directory, binary, mrroc};
use kit::recordings::{bomb, cycles, recorded, replays_whole, written};
use serde_json::Value;

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
    let other = replay(&recording, &ReplayOptions { cell: Some(kit::mrroc::example("rnt")) }).unwrap_err();
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

/// `mrroc replay` with at most `megabytes` of memory of its own.
fn replay_within(megabytes: u64, recording: &Path) -> Output {
    let limit = format!("--data={}", megabytes << 20);
    Command::new("prlimit").arg(limit).arg(binary()).arg("replay").arg(recording).output().unwrap()
}

#[test]
fn the_memory_of_a_replay_does_not_depend_on_the_length_of_the_file() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |_| {});
    let recording = directory.path("run.mcap");
    let run = mrroc(recorded(&cell, "lockstep", &recording));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let whole = replay_within(200, &recording);
    assert_eq!(whole.status.code(), Some(0), "{whole:?}");
    // Files that are mostly holes: nothing behind the start, and a whole recording that an end follows.
    for (name, start) in [("hole.mcap", &b"\x89MCAP0\r\n"[..]), ("tail.mcap", &fs::read(&recording).unwrap())] {
        let path = directory.path(name);
        fs::write(&path, start).unwrap();
        fs::File::options().write(true).open(&path).unwrap().set_len(400 << 20).unwrap();
        let replayed = replay_within(200, &path);
        let said = String::from_utf8_lossy(&[&replayed.stdout[..], &replayed.stderr[..]].concat()).into_owned();
        assert_eq!(replayed.status.code(), Some(2), "{name}: {said}");
        assert!(said.contains(if name == "hole.mcap" { "was cut" } else { "behind the end" }), "{name}: {said}");
    }
}

#[test]
fn a_chunk_that_decompresses_to_gigabytes_needs_no_memory() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |cell| cell.robot[0].program.clear());
    let recording = directory.path("run.mcap");
    let run = mrroc(recorded(&cell, "lockstep", &recording));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let bytes = fs::read(&recording).unwrap();
    let (size, path) = (4 << 30, directory.path("bomb.mcap"));
    for declared in [size, 8 << 20, 1 << 20, 0] {
        fs::write(&path, bomb(&bytes, size, declared)).unwrap();
        let replayed = replay_within(200, &path);
        let said = String::from_utf8_lossy(&[&replayed.stdout[..], &replayed.stderr[..]].concat()).into_owned();
        assert_eq!(replayed.status.code(), Some(2), "{declared} bytes declared: {said}");
        assert!(said.contains("damaged"), "{declared} bytes declared: {said}");
    }
}

#[test]
fn joined_recordings_are_no_equal_recording() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |cell| cell.robot[0].program.clear());
    let recording = directory.path("run.mcap");
    let run = mrroc(recorded(&cell, "lockstep", &recording));
    let whole = replays_whole(&run, &recording);
    let bytes = fs::read(&recording).unwrap();
    let joined = directory.path("joined.mcap");
    fs::write(&joined, bytes.repeat(2)).unwrap();
    let command = mrroc(["replay".as_ref(), joined.as_os_str()]);
    assert_eq!(command.status.code(), Some(2), "{command:?}");
    let said = format!("damaged at byte {} (another recording behind the end of this one)", bytes.len());
    assert!(command.stdout.contains(&said), "{command:?}");
    assert!(command.stdout.contains(&format!("{} cycles replayed", whole.cycles)), "{command:?}");
}

#[test]
fn each_kind_of_omission_has_an_exit_status_other_than_zero() {
    let directory = Directory::new();
    let cell = written(&directory, "irb6", |cell| cell.robot[0].program.clear());
    let recording = directory.path("run.mcap");
    let run = mrroc(recorded(&cell, "lockstep", &recording));
    replays_whole(&run, &recording);
    let bytes = fs::read(&recording).unwrap();
    let changed = directory.path("changed.mcap");
    let status = |bytes: &[u8]| {
        fs::write(&changed, bytes).unwrap();
        let command = mrroc(["replay".as_ref(), changed.as_os_str()]);
        (command.status.code(), command)
    };
    assert_eq!(status(&bytes).0, Some(0));
    let length = bytes.len();
    for end in [0, 8, 100, length / 3, length / 2, length - 10_000, length - 500, length - 30, length - 8, length - 1] {
        let (code, command) = status(&bytes[..end]);
        assert_eq!(code, Some(2), "the first {end} of {length} bytes: {command:?}");
    }
    for (from, to) in
        [(0, 8), (8, 40), (length / 3, length / 2), (length / 2, length / 2 + 1), (length - 300, length - 200)]
    {
        let (code, command) = status(&[&bytes[..from], &bytes[to..]].concat());
        assert_eq!(code, Some(2), "without the bytes {from} to {to} of {length}: {command:?}");
    }
    for tail in [&bytes[..], &[0], b"text"] {
        let (code, command) = status(&[&bytes, tail].concat());
        assert_eq!(code, Some(2), "{} bytes behind the end: {command:?}", tail.len());
    }
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
