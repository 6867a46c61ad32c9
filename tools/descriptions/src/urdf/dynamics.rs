//! Masses, velocities and efforts in the description of a robot.

use std::f64::consts::PI;
use std::fmt::Write as _;

use anyhow::{Context as _, ensure};
use controller::robot::{Joints, Limits, Link, Mass};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Vector3};

use super::{Cylinder, DRUM, LEAST, origin};
use crate::kinematics::Machine;

/// Intervals of a joint's range in which its motors are sampled.
const SAMPLES: usize = 64;

/// What a joint of the description can do.
pub(super) struct JointRating {
    /// Greatest torque, N·m, or force, N.
    pub(super) effort: f64,
    /// Greatest velocity, rad/s or m/s.
    pub(super) velocity: f64,
}

/// Velocity and effort of each joint of the description, from those of the motors.
///
/// A joint of the robot has the velocity at which its fastest motor reaches its limit in the worst place of its range,
/// and the effort that its motors have together in the worst place. A joint of the description has a position relative
/// to the previous link: its velocity is the sum of those of its joints, and its effort holds the efforts of all joints
/// that act across it.
pub(super) fn ratings(machine: &Machine, links: &[Link]) -> anyhow::Result<Vec<JointRating>> {
    let axes = links.len();
    ensure!(machine.motors.len() == axes, "{}: {} motors for {axes} links", machine.name, machine.motors.len());
    let of_joints = (0..axes).map(|joint| joint_rating(machine, joint)).collect::<anyhow::Result<Vec<_>>>()?;
    let efforts = DVector::from_iterator(axes, of_joints.iter().map(|rating| rating.effort));
    let velocities = DVector::from_iterator(axes, of_joints.iter().map(|rating| rating.velocity));
    let coupling = DMatrix::from_fn(axes, axes, |row, column| links[row].coupling[column]);
    let inverse = coupling.clone().try_inverse().context("the links do not determine the joints")?;
    // The power of both is the same: the efforts of the joints are the transposed coupling times those of the links.
    let efforts = inverse.abs().transpose() * efforts;
    let velocities = coupling.abs() * velocities;
    let both = efforts.iter().zip(&velocities);
    Ok(both.map(|(&effort, &velocity)| JointRating { effort, velocity }).collect())
}

fn joint_rating(machine: &Machine, joint: usize) -> anyhow::Result<JointRating> {
    let robot = &machine.robot;
    let home = robot.joints_from_motors(&robot.home()).context("the home position has no joints")?;
    let range = robot.joint_limits()[joint];
    // The drive train of a joint without end repeats with every turn.
    let range = if range.is_continuous() { Limits { low: home[joint] - PI, high: home[joint] + PI } } else { range };
    let step = (range.high - range.low) / SAMPLES as f64;
    let at = |sample: usize| {
        let mut joints: Joints = home;
        joints[joint] = range.low + step * sample as f64;
        robot.motors_from_joints(&joints).ok()
    };
    let mut rating = JointRating { effort: f64::INFINITY, velocity: f64::INFINITY };
    for sample in 0..SAMPLES {
        let (Some(low), Some(high)) = (at(sample), at(sample + 1)) else {
            continue;
        };
        let mut effort = 0.0;
        for (motor, of) in machine.motors.iter().enumerate() {
            let gain = ((high[motor] - low[motor]) / step).abs();
            effort += gain * of.torque;
            rating.velocity = rating.velocity.min(of.velocity / gain);
        }
        rating.effort = rating.effort.min(effort);
    }
    let is_sound = |value: f64| value.is_finite() && value > 0.0;
    ensure!(is_sound(rating.effort) && is_sound(rating.velocity), "{}: no motor turns joint {joint}", machine.name);
    Ok(rating)
}

/// Mass and inertia of a link: those of a solid cylinder about the centre of mass, as large as the longest part. A link
/// without parts is as large as a drum.
pub(super) fn inertial<'a>(mass: &Mass, parts: impl Iterator<Item = &'a Cylinder>) -> String {
    let largest = parts.max_by(|one, other| one.length.total_cmp(&other.length));
    let (turned, radius, length) = match largest {
        Some(part) => (part.link_from_cylinder.rotation.to_rotation_matrix().into_inner(), part.radius, part.length),
        None => (Matrix3::identity(), DRUM.0, DRUM.1),
    };
    let kilograms = mass.mass.max(LEAST);
    let across = kilograms * (3.0 * radius * radius + length * length) / 12.0;
    let along = kilograms * radius * radius / 2.0;
    let inertia = turned * Matrix3::from_diagonal(&Vector3::new(across, across, along)) * turned.transpose();
    // Rounded to what is written, so that no zero has a sign.
    let entry = |row, column| (inertia[(row, column)] * 1e9).round() / 1e9 + 0.0;
    let [x, y, z] = mass.centre;
    let mut text = String::new();
    let _ = writeln!(
        text,
        "    <inertial>\n      {}\n      <mass value=\"{kilograms}\"/>\n      \
             <inertia ixx=\"{:.9}\" ixy=\"{:.9}\" ixz=\"{:.9}\" iyy=\"{:.9}\" iyz=\"{:.9}\" izz=\"{:.9}\"/>\n    \
         </inertial>",
        origin(&Isometry3::translation(x, y, z)),
        entry(0, 0),
        entry(0, 1),
        entry(0, 2),
        entry(1, 1),
        entry(1, 2),
        entry(2, 2)
    );
    text
}
