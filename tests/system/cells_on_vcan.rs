//! Emulators and controller as two processes, for each example cell. A cell has one virtual interface for each of its
//! buses. The whole laboratory has five interfaces and five pseudo-terminals.
//!
//! Required with `HIL_CAN` set: root privileges, to add virtual interfaces.

use std::ffi::OsString;
use std::process::Command;
use std::time::Duration;

use ::mrroc::cell::{Cell, Control, Law};
use serde_json::json;

use crate::bench::{on_vcan_within, patient_turn};
use crate::mrroc::{self, Directory, Output, Running, text};
use crate::vcan::{shorten, started, wait_until};

/// Number of runs of a cell on an overloaded machine, and the time limit of all runs.
const ATTEMPTS: usize = 8;
pub(crate) const LONGEST: Duration = Duration::from_secs(600);

/// File with every axis in every cycle of the last run.
pub(crate) const RECORD: &str = "states.csv";

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

/// Gains for loops of the host with a period `times` longer than 2 ms, by the rule of the shipped gains:
/// `loops/cascades.rs`.
fn slow_down(cell: &mut Cell, times: f64) {
    for axis in cell.robot.iter_mut().flat_map(|robot| &mut robot.axis) {
        let by_duty = axis.controller.as_ref().is_some_and(|controller| controller.control == Control::Pwm);
        let of_line = axis.controller.as_mut().map(|it| &mut it.r#loop);
        let of_drive = axis.drive.as_mut().and_then(|it| it.r#loop.as_mut());
        match of_line.or(of_drive).map(|it| &mut it.law) {
            None => {}
            Some(Law::Cascade(law)) => {
                law.position_gain /= times;
                law.velocity_gain /= times;
                // With pulse-width output, this parameter cancels the motor's pole and does not change.
                law.integral_rate /= if by_duty { 1.0 } else { times };
            }
            Some(Law::Proportional(law)) => law.position_gain /= times,
            Some(Law::Incremental(law)) => panic!("no rule for {law:?}"),
        }
    }
}

/// Example cell `name` with a longer period for the test machine, modified by `change`.
fn slower(name: &str, change: impl FnOnce(&mut Cell)) -> Cell {
    let mut cell = Cell::parse(&text(name)).unwrap();
    shorten(&mut cell);
    change(&mut cell);
    let times = f64::from(cell.period_us) / 2000.0;
    slow_down(&mut cell, times);
    cell
}

/// Mean gravity torque of the IRb-6's arm at its motors, N·m.
const WEIGHTS: [(&str, f64); 2] = [("upper-arm", -0.395), ("wrist-pitch", 0.037)];

/// The laboratory with a period that the test machine can keep. Both processes together use some 5 ms of its processor
/// in each cycle.
///
/// With a tenth of the gains, a loop of the IRb-6 has a hundredth of its stiffness. The weight alone would turn the
/// motor of the upper arm by 26 rad before the integral part holds it. This is most of the distance that a search may
/// take. The weight is therefore fed forward.
pub(crate) fn slower_laboratory(cell: &mut Cell) {
    cell.period_us = 20_000;
    cell.macrostep = 2;
    cell.serial[0].tolerated_missing = 10;
    cell.serial[0].answer_timeout_ms = 1000;
    for axis in &mut cell.robot[0].axis {
        let weight = WEIGHTS.iter().find(|(name, _)| *name == axis.name);
        if let (Some((_, weight)), Some(controller)) = (weight, &mut axis.controller) {
            controller.r#loop.feed_forward.constant = *weight;
        }
    }
}

/// Runs example cell `name`, modified by `change`, as two processes. Asserts that the run completes without faults and
/// with all axes homed. The record is in `directory`.
pub(crate) fn completes(name: &str, directory: &Directory, change: impl FnOnce(&mut Cell)) {
    let cell = slower(name, change);
    directory.write("cell.toml", &toml::to_string(&cell).unwrap());
    let interfaces = Interfaces::of(&cell);
    let mut output = run(directory, &cell, &interfaces);
    for _ in 1..ATTEMPTS {
        if !overloaded(&output) {
            break;
        }
        println!("{name}: again, the machine was overloaded");
        output = run(directory, &cell, &interfaces);
    }
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

/// Whether a run stopped because processor time was missing, which is permitted on an overloaded machine.
///
/// According to the report of the run, at least one cycle in a hundred ended more than a period after its deadline, or
/// answers were missing. A cycle does not wait, and the emulators answer every cycle, so the processor was taken from
/// one of them. A defect that causes either fails every attempt.
pub(crate) fn overloaded(output: &Output) -> bool {
    if output.status.code() != Some(1) {
        return false;
    }
    let report = output.json();
    println!("{}", report["faults"]);
    let cycle = &report["cycle"];
    let [wake, step] = ["wake_us", "step_us"].map(|of| cycle[of]["p99"].as_f64().unwrap_or(0.0));
    let late = wake + step > cycle["period_us"].as_f64().unwrap();
    let buses = report["buses"].as_array().unwrap().iter();
    let missed: u64 = buses.filter_map(|bus| bus["missed_answers"].as_u64()).sum();
    late || missed > 0
}

/// Checks the properties that a run on vcan cannot separate from delays of the test machine.
#[test]
fn the_slower_laboratory_follows_its_set_points_in_virtual_time() {
    let directory = Directory::new();
    let mut cell = slower("lab", slower_laboratory);
    for axis in &mut cell.robot[0].axis {
        axis.following_error = 10.0;
    }
    let file = directory.write("cell.toml", &toml::to_string(&cell).unwrap());
    let arguments = ["--bench=lockstep", "--json"].map(OsString::from);
    let run = mrroc::mrroc(["run".into(), file.into()].into_iter().chain(arguments));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert_eq!(run.json()["faults"], json!([]), "{run:?}");
}

#[test]
fn every_other_cell_on_can_completes() {
    let _turn = patient_turn();
    let test = "cells_on_vcan::every_other_cell_on_can_completes";
    on_vcan_within(LONGEST, test, |_| {
        for name in ["irp6", "irp6-track", "rnt", "polycrank", "irb6-touch"] {
            completes(name, &Directory::new(), |cell| {
                cell.robot[0].program.truncate(1);
            });
        }
    });
}
