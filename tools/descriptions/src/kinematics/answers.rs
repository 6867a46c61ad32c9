//! Answers to kinematic questions: one JSON object, or lines for a person.

use std::collections::BTreeMap;
use std::fmt;

use controller::robot::{Joints, KinematicsError, Limits, Solutions, Space};
use serde::Serialize;

use super::Machine;

/// A joint position beyond its limit and beyond this value, rad, was probably given in degrees: four turns.
const DEGREES: f64 = 8.0 * std::f64::consts::PI;

/// Position and orientation of the flange.
#[derive(Serialize)]
pub struct Forward {
    robot: String,
    joints: Vec<f64>,
    /// Origin of the flange in the base frame, m.
    position: [f64; 3],
    /// `base_from_flange`, row by row.
    rotation: [[f64; 3]; 3],
    /// The same rotation as a quaternion w, x, y, z.
    quaternion: [f64; 4],
    /// Motor positions, rad. The first three motors of the RNT are given by their leg lengths, m. Null if a limit
    /// forbids the joints.
    motors: Option<Vec<f64>>,
    /// All motor positions, rad, for a robot whose `motors` contains leg lengths.
    #[serde(skip_serializing_if = "Option::is_none")]
    motor_angles: Option<Vec<f64>>,
    /// Position of each joint in the description file of the robot.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    links: BTreeMap<&'static str, f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

impl Forward {
    pub(super) fn of(machine: &Machine, joints: &Joints) -> anyhow::Result<Self> {
        let pose = machine.robot.forward(joints)?;
        let rotation = pose.rotation.to_rotation_matrix();
        let mut notes = notes(machine);
        let angles = match machine.robot.motors_from_joints(joints) {
            Ok(motors) => Some(motors.to_vec()),
            Err(error) => {
                notes.push(format!("no motors: {error}"));
                if let KinematicsError::BeyondLimit {
                    space: Space::Joint,
                    value,
                    ..
                } = error
                    && value.abs() > DEGREES
                {
                    notes.push("positions of joints are in rad and m, not degrees and mm".into());
                }
                None
            }
        };
        let lengths = machine.leg_lengths(joints)?;
        let motors = angles.clone().map(|mut motors| {
            if let Some(lengths) = lengths {
                motors[..3].copy_from_slice(&lengths);
            }
            motors
        });
        let links = machine.robot.links().map_or_else(Vec::new, |links| links.0);
        let position = |link: &controller::robot::Link| {
            let terms = joints.iter().zip(link.coupling);
            (link.name, terms.map(|(joint, factor)| factor * joint).sum())
        };
        let q = pose.rotation;
        Ok(Self {
            robot: machine.name.clone(),
            joints: joints.to_vec(),
            position: pose.translation.vector.into(),
            rotation: std::array::from_fn(|row| {
                std::array::from_fn(|column| rotation[(row, column)])
            }),
            quaternion: [q.w, q.i, q.j, q.k],
            motors,
            motor_angles: angles.filter(|_| lengths.is_some()),
            links: links.iter().map(position).collect(),
            notes,
        })
    }
}

impl fmt::Display for Forward {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "joints      {}", row(&self.joints))?;
        writeln!(f, "position    {} m", row(&self.position))?;
        for (number, values) in self.rotation.iter().enumerate() {
            let name = if number == 0 { "rotation" } else { "" };
            writeln!(f, "{name:<11} {}", row(values))?;
        }
        writeln!(f, "quaternion  {} (w x y z)", row(&self.quaternion))?;
        if let Some(motors) = &self.motors {
            match &self.motor_angles {
                Some(angles) => {
                    writeln!(f, "legs        {} m", row(&motors[..3]))?;
                    writeln!(f, "motors      {} rad", row(angles))?;
                }
                None => writeln!(f, "motors      {} rad", row(motors))?,
            }
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// Joint positions for a pose of the flange.
#[derive(Serialize)]
pub struct Inverse {
    robot: String,
    /// Solutions, the preferred solution first.
    solutions: Vec<Vec<f64>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

impl Inverse {
    pub(super) fn of(machine: &Machine, solutions: &Solutions) -> Self {
        Self {
            robot: machine.name.clone(),
            solutions: solutions.iter().map(|joints| joints.to_vec()).collect(),
            notes: notes(machine),
        }
    }
}

impl fmt::Display for Inverse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for solution in &self.solutions {
            writeln!(f, "joints      {}", row(solution))?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// Relation between velocities of joints and flange.
#[derive(Serialize)]
pub struct Sensitivity {
    robot: String,
    /// Six rows, one column per joint.
    jacobian: [Vec<f64>; 6],
    /// Distance to the nearest singularity.
    singularity: Singularity,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

#[derive(Serialize)]
struct Singularity {
    /// Index, from 0, of the axis with the largest motion for the least motion of the flange.
    axis: u8,
    /// Smallest singular value of the Jacobian.
    margin: f64,
}

impl Sensitivity {
    pub(super) fn of(machine: &Machine, joints: &Joints) -> anyhow::Result<Self> {
        let jacobian = machine.robot.jacobian(joints)?;
        let near = machine.robot.singularity(joints)?;
        let columns = 0..machine.robot.axes();
        let values = |row| {
            columns
                .clone()
                .map(|column| jacobian[(row, column)])
                .collect()
        };
        Ok(Self {
            robot: machine.name.clone(),
            jacobian: std::array::from_fn(values),
            singularity: Singularity {
                axis: near.axis,
                margin: near.margin,
            },
            notes: notes(machine),
        })
    }
}

impl fmt::Display for Sensitivity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, values) in ["vx", "vy", "vz", "wx", "wy", "wz"]
            .into_iter()
            .zip(&self.jacobian)
        {
            writeln!(f, "{name}          {}", row(values))?;
        }
        let Singularity { axis, margin } = self.singularity;
        writeln!(f, "smallest singular value {margin:.9}, of axis {axis}")?;
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// Permitted ranges of a robot.
#[derive(Serialize)]
pub struct Ranges {
    robot: String,
    joints: Vec<Limits>,
    /// Motor ranges, rad. The first three ranges of the RNT are leg lengths, m.
    motors: Vec<Limits>,
    /// All motor ranges, rad, for a robot whose `motors` contains leg lengths.
    #[serde(skip_serializing_if = "Option::is_none")]
    motor_angles: Option<Vec<Limits>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

impl Ranges {
    pub(super) fn of(machine: &Machine) -> Self {
        let angles = machine.robot.motor_limits().to_vec();
        let legs = machine.leg_limits();
        let mut motors = angles.clone();
        if let Some(legs) = legs {
            motors[..3].copy_from_slice(&legs);
        }
        Self {
            robot: machine.name.clone(),
            joints: machine.robot.joint_limits().to_vec(),
            motors,
            motor_angles: legs.map(|_| angles),
            notes: notes(machine),
        }
    }
}

impl fmt::Display for Ranges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut list = |what: &str, unit: &str, limits: &[Limits]| {
            let mut numbered = limits.iter().enumerate();
            numbered.try_for_each(|(axis, limits)| {
                let what = format!("{what} {axis}");
                if limits.is_continuous() {
                    return writeln!(f, "{what:<11} without end");
                }
                writeln!(f, "{what:<11} {} {unit}", row(&[limits.low, limits.high]))
            })
        };
        list("joint", "", &self.joints)?;
        match &self.motor_angles {
            Some(angles) => {
                list("leg", "m", &self.motors[..3])?;
                list("motor", "rad", angles)?;
            }
            None => list("motor", "rad", &self.motors)?,
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

fn notes(machine: &Machine) -> Vec<String> {
    machine.caution.map(str::to_owned).into_iter().collect()
}

/// Numbers in columns.
fn row(values: &[f64]) -> String {
    let columns: Vec<_> = values
        .iter()
        .map(|value| format!("{value:>14.9}"))
        .collect();
    columns.join(" ")
}
