//! Answers of `mrroc kinematics`: one JSON object, or readable text.

use std::collections::BTreeMap;
use std::fmt;

use controller::robot::{Joints, KinematicsError, Limits, Link, Singularity, Solutions, Space};
use controller::trajectory_file::TrajectoryFile;
use serde::Serialize;

use super::{Machine, singular};

/// Four turns, rad. A larger joint position beyond its limit was probably given in degrees (or mm).
const DEGREES: f64 = 8.0 * std::f64::consts::PI;

/// The answer to a question about a robot.
#[derive(Serialize)]
pub struct Answer {
    robot: String,
    #[serde(flatten)]
    values: Values,
    /// Notes on the values, for example an exceeded limit.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Values {
    /// Position and orientation of the flange.
    Forward {
        joints: Vec<f64>,
        /// Origin of the flange in the base frame, m.
        position: [f64; 3],
        /// Rotation matrix `base_from_flange`, row by row.
        rotation: [[f64; 3]; 3],
        /// The same rotation as a quaternion w, x, y, z.
        quaternion: [f64; 4],
        /// Motor positions, rad; for the RNT, the first three are leg lengths, m. Null if a joint, motor or leg is
        /// beyond its limit.
        motors: Option<Vec<f64>>,
        /// All motor positions, rad, of a robot whose `motors` contains leg lengths.
        #[serde(skip_serializing_if = "Option::is_none")]
        motor_angles: Option<Vec<f64>>,
        /// Position of each joint, rad or m, by its link's name in the URDF of the robot.
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        links: BTreeMap<String, f64>,
    },
    Inverse {
        /// Joint positions of each solution, rad or m, the nearest to `--near` first.
        solutions: Vec<Vec<f64>>,
    },
    Jacobian {
        /// Three rows for linear and three for angular velocity; one column per joint.
        jacobian: [Vec<f64>; 6],
        singularity: Singularity,
    },
    Converted {
        /// The text of the trajectory file.
        trajectory: String,
    },
    Limits {
        joints: Vec<Limits>,
        /// Motor ranges, rad; for the RNT, the first three are ranges of leg lengths, m.
        motors: Vec<Limits>,
        /// All motor ranges, rad, of a robot whose `motors` contains leg lengths.
        #[serde(skip_serializing_if = "Option::is_none")]
        motor_angles: Option<Vec<Limits>>,
    },
}

/// Positions of the motors at these joints, or notes why there are none.
fn motors(machine: &Machine, joints: &Joints) -> (Option<Vec<f64>>, Vec<String>) {
    let error = match machine.robot.motors_from_joints(joints) {
        Ok(motors) => return (Some(motors.to_vec()), Vec::new()),
        Err(error) => error,
    };
    let mut notes = vec![format!("no motors: {error}")];
    if let KinematicsError::BeyondLimit { space: Space::Joint, value, .. } = error
        && value.abs() > DEGREES
    {
        notes.push("positions of joints are in rad and m, not degrees and mm".into());
    }
    (None, notes)
}

impl Answer {
    fn of(machine: &Machine, values: Values) -> Self {
        Self { robot: machine.name.clone(), values, notes: machine.caution.map(str::to_owned).into_iter().collect() }
    }

    /// Pose of the flange at these joints.
    pub(super) fn forward(machine: &Machine, joints: &Joints) -> anyhow::Result<Self> {
        let pose = machine.robot.forward(joints)?;
        let rotation = pose.rotation.to_rotation_matrix();
        let (angles, notes) = motors(machine, joints);
        let lengths = machine.leg_lengths(joints)?;
        let motors = angles.clone().map(|mut motors| {
            if let Some(lengths) = lengths {
                motors[..3].copy_from_slice(&lengths);
            }
            motors
        });
        let links = machine.robot.links();
        let position = |link: &Link| {
            (
                format!("{}{}", machine.prefix, link.name),
                joints.iter().zip(link.coupling).map(|(joint, factor)| factor * joint).sum(),
            )
        };
        let q = pose.rotation;
        let values = Values::Forward {
            joints: joints.to_vec(),
            position: pose.translation.vector.into(),
            rotation: std::array::from_fn(|row| std::array::from_fn(|column| rotation[(row, column)])),
            quaternion: [q.w, q.i, q.j, q.k],
            motors,
            motor_angles: angles.filter(|_| lengths.is_some()),
            links: links.iter().map(position).collect(),
        };
        let mut answer = Self::of(machine, values);
        answer.notes.extend(notes);
        Ok(answer)
    }

    /// Joint positions for a pose, the solution nearest to `--near` first.
    pub(super) fn inverse(machine: &Machine, solutions: &Solutions, near: &Joints) -> Self {
        let singular = singular::note(&*machine.robot, solutions.preferred(), near, "--near");
        let solutions = solutions.iter().map(|joints| joints.to_vec()).collect();
        let mut answer = Self::of(machine, Values::Inverse { solutions });
        answer.notes.extend(singular.map(|note| format!("the nearest posture is {note}")));
        answer
    }

    /// Jacobian and distance from a singularity at these joints.
    pub(super) fn jacobian(machine: &Machine, joints: &Joints) -> anyhow::Result<Self> {
        let jacobian = machine.robot.jacobian(joints)?;
        let row = |row| (0..machine.robot.axes()).map(|column| jacobian[(row, column)]).collect();
        let values =
            Values::Jacobian { jacobian: std::array::from_fn(row), singularity: machine.robot.singularity(joints)? };
        let mut answer = Self::of(machine, values);
        answer.notes.extend(motors(machine, joints).1);
        Ok(answer)
    }

    /// A converted trajectory file.
    pub(super) fn converted(machine: &Machine, file: &TrajectoryFile) -> Self {
        Self::of(machine, Values::Converted { trajectory: file.to_string() })
    }

    /// Permitted ranges of joints and motors.
    pub(super) fn limits(machine: &Machine) -> Self {
        let angles = machine.robot.motor_limits().to_vec();
        let legs = machine.leg_limits();
        let mut motors = angles.clone();
        if let Some(legs) = legs {
            motors[..3].copy_from_slice(&legs);
        }
        let values = Values::Limits {
            joints: machine.robot.joint_limits().to_vec(),
            motors,
            motor_angles: legs.map(|_| angles),
        };
        Self::of(machine, values)
    }
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.values {
            Values::Forward { joints, position, rotation, quaternion, motors, motor_angles, .. } => {
                writeln!(f, "joints      {}", row(joints))?;
                writeln!(f, "position    {} m", row(position))?;
                for (number, values) in rotation.iter().enumerate() {
                    let name = if number == 0 { "rotation" } else { "" };
                    writeln!(f, "{name:<11} {}", row(values))?;
                }
                writeln!(f, "quaternion  {} (w x y z)", row(quaternion))?;
                if let (Some(motors), Some(_)) = (motors, motor_angles) {
                    writeln!(f, "legs        {} m", row(&motors[..3]))?;
                }
                if let Some(angles) = motor_angles.as_ref().or(motors.as_ref()) {
                    writeln!(f, "motors      {} rad", row(angles))?;
                }
            }
            Values::Inverse { solutions } => {
                for solution in solutions {
                    writeln!(f, "joints      {}", row(solution))?;
                }
            }
            Values::Jacobian { jacobian, singularity: Singularity { axis, margin } } => {
                let names = ["vx", "vy", "vz", "wx", "wy", "wz"];
                for (name, values) in names.into_iter().zip(jacobian) {
                    writeln!(f, "{name}          {}", row(values))?;
                }
                writeln!(f, "smallest singular value {margin:.9}, of axis {axis}")?;
            }
            // Notes would be lines of the file.
            Values::Converted { trajectory } => return f.write_str(trajectory),
            Values::Limits { joints, motors, motor_angles } => {
                ranges(f, "joint", "", joints)?;
                if motor_angles.is_some() {
                    ranges(f, "leg", "m", &motors[..3])?;
                }
                ranges(f, "motor", "rad", motor_angles.as_ref().unwrap_or(motors))?;
            }
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// Writes one line per range.
fn ranges(f: &mut fmt::Formatter<'_>, what: &str, unit: &str, limits: &[Limits]) -> fmt::Result {
    limits.iter().enumerate().try_for_each(|(axis, limits)| {
        let what = format!("{what} {axis}");
        if limits.is_continuous() {
            return writeln!(f, "{what:<11} without end");
        }
        writeln!(f, "{what:<11} {} {unit}", row(&[limits.low, limits.high]))
    })
}

/// Formats values in columns of equal width.
fn row(values: &[f64]) -> String {
    let columns: Vec<_> = values.iter().map(|value| format!("{value:>14.9}")).collect();
    columns.join(" ")
}
