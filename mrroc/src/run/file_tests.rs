//! Files of a run that fail while it is under way: the robots go on to their end, and each file is reported.

use std::io::Read;
use std::process::Command;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use serde_json::Value;

use super::*;
use crate::outputs::Replacement;
use crate::recording::damage_tests::{near_home, short_cell};
use crate::tasks::CarriedTask;

/// The report of a run in lockstep with the file `name`, whose reader ends after `length` bytes.
fn report(name: &str, length: usize) -> Value {
    let directory = tempfile::tempdir().unwrap();
    let file = short_cell(directory.path(), true);
    let pipe = directory.path().join(name);
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    // Opened for both, the pipe has a reader before the run opens it.
    let mut reader = std::fs::File::options().read(true).write(true).open(&pipe).unwrap();
    let (read, reading) = mpsc::channel();
    thread::spawn(move || read.send(reader.read_exact(&mut vec![0; length])));
    let mut options = RunOptions { replacement: Replacement { force: true }, ..RunOptions::on(BenchKind::Lockstep) };
    let option = match name {
        "trace.log" => &mut options.trace,
        "steps.csv" => &mut options.steps,
        _ => &mut options.record,
    };
    *option = Some(pipe);
    let program = CarriedTask::Programs.program();
    let report = run(&file, &options, &Requests::default(), &program, &mut |_| {}).unwrap();
    let said = || format!("{name} has less than {length} bytes: {:?}, {:?}", report.outcome, report.faults);
    reading.recv_timeout(Duration::from_secs(60)).unwrap_or_else(|_| panic!("{}", said())).unwrap();
    serde_json::to_value(report).unwrap()
}

#[test]
fn a_file_that_cannot_be_written_does_not_stop_the_robot_and_is_reported() {
    let cases = [
        ("record.csv", 20_000, "rows"),
        ("trace.log", 20_000, "frames"),
        ("steps.csv", 100, "events"),
        ("record.mcap", 200_000, "messages"),
    ];
    for (name, length, entries) in cases {
        let report = report(name, length);
        assert_eq!(report["outcome"], "completed", "{name}: {}", report["faults"]);
        assert_eq!(report["faults"], Value::Array(Vec::new()), "{name}");
        let files = report["incomplete_files"].as_array().unwrap();
        assert_eq!(files.len(), 1, "{name}: {files:?}");
        let file = &files[0];
        assert!(file["path"].as_str().unwrap().ends_with(name), "{file}");
        assert_eq!(file["entries"], entries, "{file}");
        assert!(file["lost"].as_u64().unwrap() > 10 && file["first_loss_s"].as_f64().unwrap() > 0.5, "{file}");
        assert!(file["error"].as_str().unwrap().contains("Broken pipe"), "{file}");
        assert!(file["check"].as_str().unwrap().contains("repeat the run"), "{file}");
    }
}

/// The report of a run in lockstep of a robot with a workpiece, whose file `name` has a reader that ends before the run.
fn report_of_scene(name: &str) -> Value {
    let directory = tempfile::tempdir().unwrap();
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6-milling.toml");
    let mut cell = crate::cell::Cell::parse(&std::fs::read_to_string(path).unwrap()).unwrap();
    near_home(&mut cell.robot[0]);
    cell.robot[0].program.clear();
    let path = directory.path().join("cell.toml");
    std::fs::write(&path, toml::to_string(&cell).unwrap()).unwrap();
    let file = CellFile::read(&path).unwrap();
    let pipe = directory.path().join(name);
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mut reader = Some(std::fs::File::options().read(true).write(true).open(&pipe).unwrap());
    let mut options = RunOptions { replacement: Replacement { force: true }, ..RunOptions::on(BenchKind::Lockstep) };
    match name {
        "truth.csv" => options.truth = Some(pipe),
        _ => options.carved = Some(directory.path().to_owned()),
    }
    let program = CarriedTask::Home.program();
    let report = run(&file, &options, &Requests::default(), &program, &mut |_| drop(reader.take())).unwrap();
    serde_json::to_value(report).unwrap()
}

#[test]
fn truth_and_pictures_that_cannot_be_written_end_no_run_as_a_fault() {
    for (name, option, entries) in [("truth.csv", "--truth", "rows"), ("board.pgm", "--carved", "picture")] {
        let report = report_of_scene(name);
        assert_eq!(report["outcome"], "completed", "{name}: {}", report["faults"]);
        assert_eq!(report["faults"], Value::Array(Vec::new()), "{name}");
        let files = report["incomplete_files"].as_array().unwrap();
        assert_eq!(files.len(), 1, "{name}: {files:?}");
        let file = &files[0];
        assert!(file["path"].as_str().unwrap().ends_with(name), "{file}");
        assert_eq!((&file["option"], &file["entries"]), (&option.into(), &entries.into()), "{file}");
        assert!(file["lost"].as_u64().unwrap() > 0, "{file}");
        assert!(file["error"].as_str().unwrap().contains("Broken pipe"), "{file}");
    }
}
