//! A payload that an emulated robot takes over during a run.

use std::fs;

use controller::cell::{EmulatedPayload, Instruction, JointGenerator, Joints};

use crate::cli_refusals::refused;
use crate::mrroc::{Directory, mrroc, shorten};

/// Time, s, phase and torque, N·m, of the upper arm of the IRp-6 on its track while only the flange moves.
fn holding(payload: Option<EmulatedPayload>) -> Vec<(f64, String, f64)> {
    let directory = Directory::new();
    let pose = |flange| vec![0.2, 0.0, -1.57, 0.0, 0.0, 1.57, flange];
    let cell = directory.cell("irp6-track", |cell| {
        shorten(cell);
        let joints = |flange, duration| {
            Instruction::Joints(Joints {
                poses: vec![pose(flange)],
                generator: JointGenerator::JerkLimited,
                velocity: 1.0,
                acceleration: 1.0,
                duration: Some(duration),
            })
        };
        cell.robot[0].program = vec![joints(0.0, 6.0), joints(0.5, 6.0)];
        cell.robot[0].emulated_payload = payload.into_iter().collect();
    });
    let record = directory.path("payload.csv");
    let run = mrroc([
        "run".as_ref(),
        cell.as_os_str(),
        "--bench=lockstep".as_ref(),
        "--record".as_ref(),
        record.as_os_str(),
    ]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let record = fs::read_to_string(record).unwrap();
    let mut lines = record.lines();
    let columns: Vec<_> = lines.next().unwrap().split(',').collect();
    let column = |name| columns.iter().position(|it| *it == name).unwrap();
    let (time, axis, phase) = (column("time_s"), column("axis"), column("phase"));
    let torque = column("torque_nm");
    let rows = lines.map(|line| line.split(',').collect::<Vec<_>>());
    rows.filter(|row| row[axis] == "upper-arm")
        .map(|row| {
            let number = |at: usize| row[at].parse::<f64>().unwrap();
            (number(time), row[phase].to_owned(), number(torque))
        })
        .collect()
}

/// The mean torque from `from` to `to`, s.
fn mean(rows: &[(f64, String, f64)], from: f64, to: f64) -> f64 {
    let within = rows.iter().filter(|row| (from..to).contains(&row.0));
    let torques: Vec<_> = within.map(|row| row.2).collect();
    torques.iter().sum::<f64>() / torques.len() as f64
}

#[test]
fn an_arm_holds_a_payload_from_when_it_takes_it_over() {
    let empty = holding(None);
    let (end, _, _) = empty.last().unwrap();
    let at_s = end - 3.0;
    let loaded = holding(Some(EmulatedPayload {
        at_s,
        mass: 10.0,
        centre: [0.0; 3],
    }));
    let before = mean(&loaded, at_s - 1.0, at_s);
    assert_eq!(before, mean(&empty, at_s - 1.0, at_s));
    let risen = mean(&loaded, at_s + 1.0, at_s + 2.5).abs() - before.abs();
    // 10 kg at 0.67 m behind 175 turns, give or take the dry friction of the motor either way.
    let weight = 10.0 * 9.81 * 0.67 / 175.1;
    assert!((risen - weight).abs() < 0.24, "{before} + {risen} N·m");
}

#[test]
fn payloads_that_nobody_can_carry_are_refused_with_the_line() {
    let payload = |at_s, mass| EmulatedPayload {
        at_s,
        mass,
        centre: [0.0; 3],
    };
    let cases = [
        (
            "irp6-track",
            payload(-1.0, 1.0),
            "robot[0].emulated_payload[0].at_s",
        ),
        (
            "irp6-track",
            payload(1.0, -1.0),
            "robot[0].emulated_payload[0].mass",
        ),
    ];
    for (example, payload, key) in cases {
        let directory = Directory::new();
        let cell = directory.cell(example, |cell| cell.robot[0].emulated_payload.push(payload));
        refused(&mrroc(["check".as_ref(), cell.as_os_str()]), &[key]);
    }
    let directory = Directory::new();
    let cell = directory.cell("lab", |cell| {
        let robot = cell.robot.iter_mut().find(|robot| robot.name == "conveyor");
        robot.unwrap().emulated_payload.push(payload(1.0, 1.0));
    });
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    refused(&check, &["conveyor, whose emulation carries nothing"]);
}
