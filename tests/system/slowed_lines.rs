//! Lines that joints slow, and the report of them.

use ::mrroc::cell::{Cell, Instruction, JointGenerator, Joints, LineInstruction};
use kit::mrroc::{Directory, mrroc, text};
use serde_json::Value;

/// Joint positions beside a singular wrist of the IRp-6, rad.
const BESIDE: [f64; 6] = [0.2, -1.57, 0.1, 0.2, 0.05, 0.3];

/// The report of a run of the IRp-6 with a line that begins beside a singular wrist.
fn run(directory: &Directory, velocity: f64, constant_speed: bool) -> Value {
    let arm = Cell::parse(&text("irp6")).unwrap().robot[0].arm().unwrap();
    let mut start = [0.0; servo::MAX_AXES];
    start[..6].copy_from_slice(&BESIDE);
    let [x, y, z] = arm.forward(&start).unwrap().translation.vector.into();
    let cell = directory.cell("irp6", |cell| {
        let line = LineInstruction {
            position: [x, y + 0.2, z + 0.1],
            quaternion: None,
            velocity,
            acceleration: 10.0 * velocity,
            constant_speed,
        };
        let there = Joints {
            poses: vec![BESIDE.to_vec()],
            generator: JointGenerator::Newsmooth,
            velocity: 0.5,
            acceleration: 0.5,
            duration: None,
        };
        cell.robot[0].program = vec![Instruction::Joints(there), Instruction::Line(line)];
    });
    let run = mrroc(["run".as_ref(), "--bench=lockstep".as_ref(), "--json".as_ref(), cell.as_os_str()]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    run.json()
}

#[test]
fn the_report_names_the_part_of_a_line_that_a_joint_slows_and_a_constant_speed_takes_longer() {
    let directory = Directory::new();
    let slowed = |velocity, constant_speed| {
        let report = run(&directory, velocity, constant_speed);
        report["slowed"].as_array().unwrap().clone()
    };
    assert!(slowed(0.001, false).is_empty());
    let [here, whole] = [false, true].map(|constant_speed| {
        let list = slowed(0.25, constant_speed);
        let [part] = &list[..] else { panic!("{list:?}") };
        let [from, to, times] = ["from", "to", "times"].map(|key| part[key].as_f64().unwrap());
        assert!((0.0..0.2).contains(&from) && from < to && to < 0.9 && times > 1.5, "{part}");
        assert!(["wrist-pitch", "flange"].contains(&part["axis"].as_str().unwrap()), "{part}");
        assert!(["velocity", "acceleration"].contains(&part["limit"].as_str().unwrap()), "{part}");
        part["time_s"].as_f64().unwrap()
    });
    assert!(whole > here + 0.2, "{here} s and {whole} s");
}
