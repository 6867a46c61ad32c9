//! Checks of the instructions of a program that do not depend on the arm.

use super::{Checked, count, name, refused, some, within};
use crate::cell::{Figure, Instruction, JointGenerator, Joints, LineInstruction, Path, Range, Robot};

/// Greatest number of instructions of a program, and of poses of an instruction.
const MOST: usize = 10_000;

/// Fraction of the greatest velocity and acceleration.
const SHARE: Range = Range::new(1e-3, 1.0, "of the greatest");

/// Greatest coordinate of a joint or a tool, rad or m.
const FARTHEST: Range = Range::new(-1e6, 1e6, "rad or m");

pub(super) fn check(robot_path: &Path, robot: &Robot) -> Checked {
    let (path, found) = (robot_path.then("program"), robot.program.len());
    if found > 0 {
        some(robot_path, "program", found, MOST, "instructions")?;
    }
    for (number, instruction) in robot.program.iter().enumerate() {
        let path = path.then(number);
        match instruction {
            Instruction::Joints(joints) => check_joints(&path.then("joints"), joints, robot)?,
            Instruction::Line(line) => check_line(&path.then("line"), line)?,
            Instruction::Meet(meeting) => name(&path, "meet", meeting)?,
        }
    }
    Ok(())
}

fn check_joints(path: &Path, joints: &Joints, robot: &Robot) -> Checked {
    let poses = path.then("poses");
    some(path, "poses", joints.poses.len(), MOST, "poses")?;
    for (index, pose) in joints.poses.iter().enumerate() {
        let path = poses.then(index);
        count(path.clone(), pose.len(), robot.axis.len(), "joint value")?;
        for (joint, value) in pose.iter().enumerate() {
            within(&path, joint, *value, FARTHEST)?;
        }
    }
    within(path, "velocity", joints.velocity, SHARE)?;
    within(path, "acceleration", joints.acceleration, SHARE)?;
    let Some(duration) = joints.duration else {
        return Ok(());
    };
    if joints.generator != JointGenerator::JerkLimited {
        return refused(path, "duration", "is for jerk-limited motions: use generator = \"jerk-limited\"");
    }
    within(path, "duration", duration, Range::new(1e-3, 7_200.0, "s"))
}

fn check_line(path: &Path, line: &LineInstruction) -> Checked {
    for (number, part) in line.position.into_iter().enumerate() {
        within(&path.then("position"), number, part, FARTHEST)?;
    }
    within(path, "velocity", line.velocity, Range::new(1e-4, 100.0, "m/s"))?;
    within(path, "acceleration", line.acceleration, Range::new(1e-4, 1000.0, "m/s²"))?;
    let Some(quaternion) = line.quaternion else {
        return Ok(());
    };
    let norm = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    if (norm - 1.0).abs() > 1e-3 {
        let why = format!("is {}, must be of length 1, as every orientation", Figure(norm));
        return refused(path, "quaternion", why);
    }
    Ok(())
}
