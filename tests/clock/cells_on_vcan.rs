//! Emulators and controller as two processes, for each example cell. A cell has one virtual interface for each of its
//! buses. The whole laboratory has five interfaces and five pseudo-terminals.
//!
//! Required with `HIL_CAN` set: root privileges, to add virtual interfaces.

use std::ffi::OsString;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use ::mrroc::cell::Cell;
use kit::bench::in_uml;
use kit::by_the_clock;
use kit::mrroc::{self, Directory, Output, Running};
use kit::processors::ALL;
use kit::slow::slower;
use serde_json::json;

use crate::vcan::{started, wait_until};

/// Time limit of all runs in the test machine.
pub(crate) const LONGEST: Duration = Duration::from_secs(600);

/// File with every axis in every cycle of the last run.
const RECORD: &str = "states.csv";

/// One interface for each bus of a cell, removed on drop.
pub(crate) struct Interfaces(Vec<(String, String)>);

impl Interfaces {
    pub(crate) fn of(cell: &Cell) -> Self {
        let buses = cell.bus.iter().enumerate();
        let named = buses.map(|(number, bus)| (bus.name.clone(), format!("mrroc{number}")));
        let interfaces = Self(named.collect());
        for (_, interface) in &interfaces.0 {
            ip(&["link", "add", "dev", interface, "type", "vcan"]);
            ip(&["link", "set", interface, "up"]);
        }
        interfaces
    }

    /// The interface of the bus called `bus`.
    pub(crate) fn interface(&self, bus: &str) -> &str {
        &self.0.iter().find(|(name, _)| name == bus).expect("a bus of the cell").1
    }

    /// Values of `--can`.
    pub(crate) fn options(&self) -> impl Iterator<Item = String> {
        let options = self.0.iter();
        options.map(|(bus, interface)| format!("--can={bus}={interface}"))
    }
}

impl Drop for Interfaces {
    fn drop(&mut self) {
        for (_, interface) in &self.0 {
            let delete = ["link", "delete", interface];
            // An interface that could not be added does not exist.
            let _ = Command::new("ip").args(delete).status();
        }
    }
}

fn ip(arguments: &[&str]) {
    let done = Command::new("ip").args(arguments).status();
    assert!(done.expect("ip runs").success(), "ip {arguments:?}");
}

/// Runs example cell `name`, modified by `change`, as two processes. Asserts that the run completes without faults and
/// with all axes homed. `judge_record` judges the record.
pub(crate) fn completes(name: &str, change: impl FnOnce(&mut Cell), judge_record: impl Fn(&Path)) {
    let directory = Directory::new();
    let cell = slower(name, change);
    directory.write("cell.toml", &toml::to_string(&cell).unwrap());
    let interfaces = Interfaces::of(&cell);
    by_the_clock(ALL, cell.period(), || {
        judge(name, &cell, &run(&directory, &cell, &interfaces));
        judge_record(&directory.path(RECORD));
    });
}

/// Asserts that a run completed.
fn judge(name: &str, cell: &Cell, output: &Output) {
    assert_eq!(output.status.code(), Some(0), "{name}: {output:?}");
    let report = output.json();
    assert_eq!(report["outcome"], "completed", "{name}: {report}");
    assert_eq!(report["faults"], json!([]), "{name}: {report}");
    assert_eq!(report["bench"], "vcan", "{name}: {report}");
    let groups: Vec<_> = cell.groups().map(|group| json!(group)).collect();
    let buses = report["buses"].as_array().unwrap().iter();
    let buses: Vec<_> = buses.map(|bus| bus["name"].clone()).collect();
    assert_eq!(buses, groups, "{name}: {report}");
    let axes = report["axes"].as_array().unwrap();
    let expected: usize = cell.robot.iter().map(|robot| robot.axis.len()).sum();
    assert_eq!(axes.len(), expected, "{name}: {report}");
    for axis in axes {
        assert!(axis["homing_offset_counts"].is_number(), "{name}: {axis}");
        let peak = axis["tracking_peak_rad"].as_f64().unwrap();
        assert!(peak > 0.0, "{name}: {axis}");
    }
    println!("{name}: {}", report["cycle"]);
}

/// Runs the cell in `directory` once.
fn run(directory: &Directory, cell: &Cell, interfaces: &Interfaces) -> Output {
    let ttys = directory.path("ttys");
    // A killed emulator leaves its links behind.
    let _ = std::fs::remove_dir_all(&ttys);
    let ends = |command: &str| {
        let mut arguments = vec![command.into(), directory.path("cell.toml").into()];
        arguments.extend(interfaces.options().map(OsString::from));
        if !cell.serial.is_empty() {
            arguments.extend(["--serial".into(), ttys.clone().into()]);
        }
        arguments
    };
    let _emulators = started(|| Running::start(ends("emulate")));
    let groups = cell.bus.len()..cell.groups().count();
    let lines: usize = groups.map(|group| cell.axes_on(group).count()).sum();
    wait_until("the ttys are there", || {
        let there = std::fs::read_dir(&ttys).into_iter().flatten().count();
        there == lines
    });
    let mut arguments = ends("run");
    arguments.extend(["--bench=vcan", "--json", "--force", "--record"].map(Into::into));
    arguments.push(directory.path(RECORD).into());
    mrroc::mrroc(arguments)
}

#[test]
fn every_other_cell_on_can_completes() {
    let test = "cells_on_vcan::every_other_cell_on_can_completes";
    in_uml(LONGEST, test, |_| {
        for name in ["irp6", "irp6-track", "rnt", "polycrank", "irb6-touch"] {
            completes(name, |cell| cell.robot[0].program.truncate(1), |_| {});
        }
    });
}
