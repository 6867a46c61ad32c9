//! Checks of the instructions of a program that do not depend on the arm.

use super::{Checked, name, refused, some, within};
use crate::cell::error::Problem;
use crate::cell::{Instruction, JointGenerator, Joints, LineInstruction, Path, Range, Robot};

/// Greatest number of instructions of a program, and of poses of an instruction.
const MOST: usize = 10_000;

/// Fraction of the greatest velocity and acceleration.
const SHARE: Range = Range::new(1e-3, 1.0, "of the greatest");

/// Greatest coordinate of a joint or a tool, rad or m.
const FARTHEST: Range = Range::new(-1e6, 1e6, "rad or m");

pub(super) fn check(path: &Path, robot: &Robot) -> Checked {
    let found = robot.program.len();
    if found > 0 {
        some(path, found, MOST, "instructions")?;
    }
    for (number, instruction) in robot.program.iter().enumerate() {
        let path = path.then(number);
        match instruction {
            Instruction::Joints(joints) => check_joints(&path.then("joints"), joints, robot)?,
            Instruction::Line(line) => check_line(&path.then("line"), line)?,
            Instruction::Meet(meeting) => name(&path.then("meet"), meeting)?,
        }
    }
    Ok(())
}

fn check_joints(path: &Path, joints: &Joints, robot: &Robot) -> Checked {
    let poses = path.then("poses");
    some(&poses, joints.poses.len(), MOST, "poses")?;
    for (index, pose) in joints.poses.iter().enumerate() {
        let (found, expected) = (pose.len(), robot.axis.len());
        if found != expected {
            let what = "joint values";
            let problem = Problem::Count {
                found,
                expected,
                what,
            };
            return Err((poses.then(index), problem));
        }
        for (joint, value) in pose.iter().enumerate() {
            within(&poses.then(index).then(joint), *value, FARTHEST)?;
        }
    }
    within(&path.then("velocity"), joints.velocity, SHARE)?;
    within(&path.then("acceleration"), joints.acceleration, SHARE)?;
    let Some(duration) = joints.duration else {
        return Ok(());
    };
    let path = path.then("duration");
    if joints.generator != JointGenerator::JerkLimited {
        let why = "is for jerk-limited motions: use generator = \"jerk-limited\"";
        return refused(path, why);
    }
    within(&path, duration, Range::new(1e-3, 86_400.0, "s"))
}

fn check_line(path: &Path, line: &LineInstruction) -> Checked {
    for (number, part) in line.position.into_iter().enumerate() {
        within(&path.then("position").then(number), part, FARTHEST)?;
    }
    let velocity = Range::new(1e-4, 100.0, "m/s");
    within(&path.then("velocity"), line.velocity, velocity)?;
    let acceleration = Range::new(1e-4, 1000.0, "m/s²");
    within(&path.then("acceleration"), line.acceleration, acceleration)?;
    let Some(quaternion) = line.quaternion else {
        return Ok(());
    };
    let norm = quaternion
        .iter()
        .map(|part| part * part)
        .sum::<f64>()
        .sqrt();
    if (norm - 1.0).abs() > 1e-3 {
        let (value, expected) = (norm, "of length 1, as every orientation");
        let path = path.then("quaternion");
        return Err((path, Problem::NoneOf { value, expected }));
    }
    Ok(())
}
