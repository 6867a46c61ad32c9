//! Programs that start at the position after homing: some counts away from the home position.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use ::mrroc::cell::{Cell, Instruction, JointGenerator, Joints, LineInstruction, Parameters};
use controller::robot::Irb6Parameters;
use kit::mrroc::{Directory, mrroc, shorten, text};

use super::verdict::{Verdict, judge_all};
use kit::draw::Draw;

/// Number of programs of one straight line each.
const PROGRAMS: u64 = 90;

/// A cell whose only instruction is a line to `position`. The axes are switched on up to 15 rad away from home.
fn one_line(example: &str, draw: &mut Draw, position: [f64; 3]) -> String {
    let mut cell = Cell::parse(&text(example)).expect("the example cells are sound");
    shorten(&mut cell);
    cell.seed = draw.number() >> 32;
    let robot = &mut cell.robot[0];
    for axis in &mut robot.axis {
        let start = axis.emulator.start.expect("a shortened cell has starts");
        axis.emulator.start = Some(start + draw.within(-12.5, 17.5));
    }
    robot.program = vec![Instruction::Line(LineInstruction {
        position,
        quaternion: None,
        velocity: draw.within(0.1, 0.3),
        acceleration: 0.5,
        constant_speed: false,
    })];
    toml::to_string(&cell).expect("a cell is TOML")
}

/// Random position of the wrist of an IRb-6 or IRp-6 in its vertical plane at home: reach and height of the pitch axis
/// relative to the shoulder, m.
fn in_the_plane(draw: &mut Draw) -> (f64, f64) {
    let (lower, upper) = (draw.within(-1.9, -1.3), draw.within(-0.3, 0.3));
    let reach = 0.455 * lower.cos() + 0.67 * upper.cos();
    (reach, -0.455 * lower.sin() - 0.67 * upper.sin())
}

/// Number of cells of `0..count` that run to their end. Asserts that none of the other cells starts a motion.
#[track_caller]
fn completed(count: u64, of: impl Fn(u64) -> String + Sync) -> u64 {
    let verdicts = judge_all(count, of);
    let ready = verdicts.iter().filter(|verdict| **verdict == Verdict::Ready);
    ready.count() as u64
}

#[test]
fn an_irb6_leaves_its_home_by_every_line_that_is_called_ready() {
    let cell = |number| {
        let mut draw = Draw::of(1, number);
        // The tool is horizontal at home. A line in the plane of the arm keeps it horizontal.
        let (reach, height) = in_the_plane(&mut draw);
        one_line("irb6", &mut draw, [reach + 0.095, 0.0, 0.7 + height])
    };
    let completed = completed(PROGRAMS, cell);
    assert!(completed > 84, "{completed} of {PROGRAMS} are called ready");
}

#[test]
fn an_irp6_leaves_its_singular_home_by_every_line_that_is_called_ready() {
    let cell = |number| {
        let mut draw = Draw::of(2, number);
        let (reach, height) = in_the_plane(&mut draw);
        // Outside the plane of the arm, the wrist would have to turn over at once. One line in four leads there.
        let beside = if draw.one_in(4) { draw.within(-0.2, 0.2) } else { 0.0 };
        one_line("irp6", &mut draw, [reach + 0.19, beside, height])
    };
    let count = PROGRAMS / 3;
    let completed = completed(count, cell);
    let about = count / 2..count * 7 / 8;
    assert!(about.contains(&completed), "{completed} of {count} are called ready");
}

/// Motor positions at the end of homing in a record, rad, with the names of their axes.
fn homed(record: &str) -> Vec<(String, f64)> {
    let mut homed = Vec::new();
    let mut homing = BTreeSet::new();
    for row in record.lines().skip(1) {
        let fields: Vec<&str> = row.split(',').collect();
        let (axis, phase, commanded) = (fields[2], fields[3], fields[5]);
        if phase == "Homing" {
            homing.insert(axis.to_owned());
        } else if phase == "Standing" && homing.remove(axis) {
            homed.push((axis.to_owned(), commanded.parse().expect("a position")));
        }
    }
    homed
}

#[test]
fn homing_leaves_every_axis_of_the_example_cells_within_its_tolerance() {
    for name in ["irb6", "irp6", "irb6-serial", "irb6-hi-moxa", "irp6-track", "rnt", "polycrank", "lab"] {
        let directory = Directory::new();
        let mut tolerances = BTreeMap::new();
        let path = directory.cell(name, |cell| {
            shorten(cell);
            cell.seed = 11;
            for (index, robot) in cell.robot.iter().enumerate() {
                let arm = robot.arm().expect("the example cells are sound");
                let home = cell.home(index, &arm);
                for (number, axis) in robot.axis.iter().enumerate() {
                    let place = (home.motors[number], home.tolerance[number]);
                    tolerances.insert(format!("{}.{}", robot.name, axis.name), place);
                }
            }
        });
        let record = directory.path("record.csv");
        let [path, record_path] = [&path, &record].map(|path| path.as_os_str());
        let run = mrroc(["run".as_ref(), path, "--bench=lockstep".as_ref(), "--record".as_ref(), record_path]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let record = fs::read_to_string(&record).expect("the record is there");
        let homed = homed(&record);
        assert_eq!(homed.len(), tolerances.len(), "{name}");
        for (axis, at) in homed {
            let named = |key: &&String| key.ends_with(&axis);
            let key = tolerances.keys().find(named).expect("an axis of the cell");
            let (home, tolerance) = tolerances[key];
            let distance = (at - home).abs();
            assert!(distance <= tolerance, "{name}, {axis}: {distance} rad, not {tolerance}");
            // An excessive tolerance would refuse programs without need.
            assert!(tolerance < 0.7, "{name}, {axis}: {tolerance} rad");
        }
    }
}

#[test]
fn an_arm_goes_to_the_end_of_each_motor_range_and_touches_no_limit_switch() {
    // The axes of each cell, in both directions. The legs of the RNT are left out, because no leg reaches an end of its
    // range alone.
    for (name, axes) in [("irb6", 0..5), ("rnt", 3..6), ("irp6-track", 0..7), ("irb6-serial", 0..5)] {
        let cell = |number: u64| {
            let mut cell = Cell::parse(&text(name)).expect("the example cells are sound");
            shorten(&mut cell);
            let robot = &mut cell.robot[0];
            let arm = robot.arm().expect("the example cells are sound");
            let axis = axes.start + number as usize / 2;
            let limits = arm.robot().motor_limits()[axis];
            let home = arm.robot().home().padded();
            let mut motors = home;
            motors[axis] = if number.is_multiple_of(2) { limits.low } else { limits.high };
            // The remaining distance of homing could move another motor beyond its limit by the coupling of the axes.
            let poses = [home, motors].map(|motors| arm.joints(&motors).expect("a posture"));
            robot.program = vec![Instruction::Joints(Joints {
                poses: poses.map(|pose| pose[..arm.axes()].to_vec()).to_vec(),
                generator: JointGenerator::JerkLimited,
                velocity: 1.0,
                acceleration: 1.0,
                duration: None,
            })];
            toml::to_string(&cell).expect("a cell is TOML")
        };
        let verdicts = judge_all(2 * axes.len() as u64, cell);
        // Ends of motor ranges at which the joint is beyond its own limit.
        let refused = verdicts.iter().filter(|verdict| **verdict != Verdict::Ready);
        for verdict in refused.clone() {
            let Verdict::Refused(why) = verdict else {
                continue;
            };
            assert!(why.contains(": joint at "), "{name}: {why}");
        }
        assert!(refused.count() < verdicts.len() / 2, "{name}: {verdicts:?}");
    }
}

/// An IRb-6 whose column has its limit at its home position, on the side of `sign`. Its program is one instruction.
fn at_the_end(sign: f64, first: Instruction, draw: &mut Draw) -> String {
    let mut cell = Cell::parse(&text("irb6")).expect("the example cells are sound");
    shorten(&mut cell);
    cell.seed = draw.number() >> 32;
    let robot = &mut cell.robot[0];
    let mut parameters = Irb6Parameters::irb6();
    let column = &mut parameters.arm.column;
    if sign < 0.0 {
        column.joint_limits.low = column.joint_at_home;
        column.motor_limits.high = column.motor_at_home;
    } else {
        column.joint_limits.high = column.joint_at_home;
        column.motor_limits.low = column.motor_at_home;
    }
    robot.parameters = Some(Parameters::Irb6(parameters));
    robot.program = vec![first];
    toml::to_string(&cell).expect("a cell is TOML")
}

#[test]
fn an_arm_that_is_homed_at_the_end_of_its_range_leaves_it_by_every_motion() {
    let cell = |number: u64| {
        let mut draw = Draw::of(3, number);
        let sign = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
        // The column stays at its limit, or moves away from it.
        let column = if draw.one_in(2) { 0.0 } else { -sign * draw.within(0.0, 0.3) };
        let line = Instruction::Line(LineInstruction {
            position: [0.7, 0.0, 1.1],
            quaternion: None,
            velocity: 0.2,
            acceleration: 0.5,
            constant_speed: false,
        });
        let joints = |generator| {
            Instruction::Joints(Joints {
                poses: vec![vec![column, -1.6, 0.1, 0.2, 0.1]],
                generator,
                velocity: 0.5,
                acceleration: 0.5,
                duration: None,
            })
        };
        let first = match number % 3 {
            0 => line,
            1 => joints(JointGenerator::Newsmooth),
            _ => joints(JointGenerator::JerkLimited),
        };
        at_the_end(sign, first, &mut draw)
    };
    let verdicts = judge_all(24, cell);
    assert!(verdicts.iter().all(|verdict| *verdict == Verdict::Ready), "{verdicts:#?}");
}
