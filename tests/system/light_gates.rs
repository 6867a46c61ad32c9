//! A conveyor with light gates at a CiA 401 node: measured speed and place against the emulated world, in lockstep.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use ::mrroc::bench::emulation::Emulation;
use ::mrroc::cell::{Cell, CellFile};
use can::Instant;
use kit::mrroc::{Directory, Running, example_program};
use kit::refusals::refused;
use kit::steps;
use serde_json::Value;

/// Place of the front of the object along the conveyor, m from its centre, at a time, s, in the emulated world of a cell.
fn front(file: &CellFile, at: f64) -> f64 {
    let (mut emulation, _ends) = Emulation::of(file);
    emulation.advance(Instant::ZERO + Duration::from_secs_f64(at));
    let scene = file.cell.scene.as_ref().unwrap();
    let (conveyor, object) = (&scene.conveyor[0], &scene.object[0]);
    let centre = emulation.object(0).unwrap().pose.translation;
    centre.x - conveyor.position[0] + conveyor.speed.signum() * object.size[0] / 2.0
}

/// The report of the example in lockstep, with the cell file.
fn watch(change: impl FnOnce(&mut Cell)) -> (CellFile, Value) {
    let directory = Directory::new();
    let path = directory.cell("irb6-conveyor", change);
    let report = steps::run("conveyor", &path).2;
    (CellFile::read(&path).unwrap(), report)
}

fn figure(report: &Value, name: &str) -> f64 {
    report["figures"][name].as_f64().unwrap()
}

/// Changes a key of the gates in the table of the task.
fn set(cell: &mut Cell, key: &str, value: impl Into<toml::Value>) {
    cell.task["track"].as_table_mut().unwrap().insert(key.into(), value.into());
}

#[test]
fn speed_and_place_of_an_object_are_measured_on_a_bus_loaded_to_80_percent() {
    for (seed, speed, length) in [(1, 0.05, 0.08), (2, 0.12, 0.08), (3, 0.3, 0.2)] {
        let (file, report) = watch(|cell| {
            cell.seed = seed;
            let scene = cell.scene.as_mut().unwrap();
            scene.conveyor[0].speed = speed;
            (scene.object[0].size[0], scene.object[0].along) = (length, -0.45);
        });
        let load = report["buses"][0]["load_percent"].as_f64().unwrap();
        assert!((80.0..95.0).contains(&load), "{load} %");
        let found = figure(&report, "speed_m_per_s");
        let speed_error = 100.0 * (found / speed - 1.0).abs();
        let place_error = 1e3 * (front(&file, figure(&report, "leaves_at_s")) - figure(&report, "place_m")).abs();
        let [speed_bound, place_bound] = ["speed_bound_percent", "place_bound_mm"].map(|name| figure(&report, name));
        println!(
            "{speed} m/s: load {load:.1} %, speed {speed_error:.4} % of at most {speed_bound:.4} %, place \
             {place_error:.3} mm of at most {place_bound:.3} mm"
        );
        assert!(speed_error < 1.0 && place_error < 1.0, "{speed_error} %, {place_error} mm");
        // The bounds that the controller gives hold.
        assert!(speed_error < speed_bound && place_error < place_bound, "{speed_error} %, {place_error} mm");
        assert!((figure(&report, "length_m") - length).abs() < 1e-3, "{report}");
        assert_eq!(report["faults"], serde_json::json!([]));
    }
}

#[test]
fn an_object_on_a_belt_that_runs_backwards_has_a_negative_speed() {
    let (file, report) = watch(|cell| {
        let scene = cell.scene.as_mut().unwrap();
        scene.conveyor[0].speed = -0.12;
        scene.object[0].along = 0.5;
        set(cell, "direction", "either");
        cell.task.insert("end".into(), (-0.6).into());
    });
    assert!((figure(&report, "speed_m_per_s") + 0.12).abs() < 0.0012, "{report}");
    let error = front(&file, figure(&report, "leaves_at_s")) - figure(&report, "place_m");
    assert!(error.abs() < 1e-3, "{error} m");
}

/// What the example reports on standard error for a changed cell.
fn fails(change: impl FnOnce(&mut Cell)) -> String {
    let directory = Directory::new();
    let path = directory.cell("irb6-conveyor", change);
    run(&path)
}

fn run(path: &Path) -> String {
    let output = Command::new(example_program("conveyor")).arg(path).args(["--bench", "lockstep"]).output().unwrap();
    assert!(!output.status.success(), "{output:?}");
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn a_gate_without_an_edge_is_named() {
    for (gate, expected) in [
        (0, "light gates: gate 0 has no edge of an object that reached gate 1: check the beam of gate 0"),
        (1, "light gates: no object at gate 1 for 8.0"),
    ] {
        let text = fails(|cell| {
            cell.scene.as_mut().unwrap().gate.remove(gate);
            set(cell, "min_speed", 0.05);
        });
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn wrong_gates_of_a_task_are_refused_before_motion() {
    let directory = Directory::new();
    let table: [(&str, toml::Value, &str); 3] = [
        ("min_speed", 0.7.into(), "light gates: speeds from 0.7 to 0.5 m/s: the lowest must be"),
        ("gate", toml::Value::Array(vec![]), "light gates: no gates, must be at least 2"),
        ("min_speed", "slow".into(), "task.track.min_speed"),
    ];
    for (key, value, expected) in table {
        let path = directory.cell("irb6-conveyor", |cell| set(cell, key, value));
        let run = Running::program(&example_program("conveyor"), [path.as_os_str(), "--bench=lockstep".as_ref()]);
        refused(&run.output(), &[expected]);
    }
}
