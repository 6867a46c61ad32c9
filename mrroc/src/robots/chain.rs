//! Emulation of a chain that a cell describes. The emulator takes the numbers of the description, and shares no
//! computation with the controller.

use std::sync::Arc;

use controller::robot::{ChainParameters, LinkKind};
use hil::plant::{ChainBodies, ChainBodyJoint, ChainError, NominalJoint};
use hil::{AxisConfig, MechanismConfig};
use nalgebra::{DMatrix, UnitQuaternion, Vector3};

/// The links of the chain as one mechanism; `None` if the description has no masses.
pub(super) fn mechanism(given: &ChainParameters) -> Result<Option<MechanismConfig>, ChainError> {
    if given.joints.iter().all(|joint| joint.body.is_none()) {
        return Ok(None);
    }
    let quaternion = |turn: UnitQuaternion<f64>| [turn.w, turn.i, turn.j, turn.k];
    let joints: Vec<_> = given
        .joints
        .iter()
        .map(|joint| {
            let body = joint.body.unwrap_or_default();
            ChainBodyJoint {
                translation: joint.parent_from_joint.translation.vector.into(),
                rotation: quaternion(joint.parent_from_joint.rotation),
                axis: joint.axis,
                prismatic: joint.kind == LinkKind::Prismatic,
                mass: body.mass,
                centre: body.centre,
                inertia: body.inertia,
                at_home: joint.joint_at_home,
            }
        })
        .collect();
    let flange = given.link_from_flange;
    let rotors: Vec<_> = (0..joints.len()).map(|number| demand(given, number).rotor_inertia()).collect();
    let bodies = ChainBodies::new(
        &joints,
        (flange.translation.vector.into(), quaternion(flange.rotation)),
        given.up,
        &joints_from_motors(given),
        &rotors,
    );
    Ok(Some(MechanismConfig::Chain(Arc::new(bodies?))))
}

/// Motor, sensors and switches of axis `number`, with its motor at home at 0.
pub(super) fn plant(given: &ChainParameters, number: usize) -> AxisConfig {
    AxisConfig::nominal(&demand(given, number)).expect(SOUND)
}

/// Requirements of a joint on its nominal motor, from the description where it states them.
fn demand(given: &ChainParameters, number: usize) -> NominalJoint {
    let joint = &given.joints[number];
    let is_linear = joint.kind == LinkKind::Prismatic;
    let ratio = match &given.motors_from_joints {
        Some(rows) => rows[number].iter().fold(0.0, |most, factor| f64::max(most, factor.abs())),
        None => joint.ratio,
    };
    let Load { weight, inertia } = load(given, number);
    let velocity = joint.velocity.unwrap_or(if is_linear { 0.25 } else { 1.0 });
    let effort = joint.effort.unwrap_or(2.0 * (weight + inertia * velocity / RISE).max(LEAST_EFFORT));
    let at_home = |position: f64| ratio * (position - joint.joint_at_home);
    let ends = (at_home(joint.limits.low), at_home(joint.limits.high));
    let has_ends = joint.kind != LinkKind::Continuous && given.motors_from_joints.is_none();
    NominalJoint {
        ratio,
        // The acceleration of an unknown load takes a quarter of the effort.
        inertia: if inertia > 0.0 { inertia } else { 0.25 * effort * RISE / velocity },
        velocity,
        effort,
        home: 0.0,
        travel: has_ends.then_some((ends.0.min(ends.1), ends.0.max(ends.1))),
    }
}

/// Time from rest to the greatest velocity, s, of a joint whose effort is unknown.
const RISE: f64 = 0.5;

/// Least effort of a joint whose effort is unknown, N·m or N.
const LEAST_EFFORT: f64 = 5.0;

/// Upper bounds of the load of a joint in any pose.
struct Load {
    /// N·m or N.
    weight: f64,
    /// kg·m² or kg.
    inertia: f64,
}

/// Load of the links behind joint `number`, at their greatest distances from the joint.
fn load(given: &ChainParameters, number: usize) -> Load {
    let is_linear = given.joints[number].kind == LinkKind::Prismatic;
    let (mut reach, mut weight, mut inertia) = (0.0, 0.0, 0.0);
    for (index, joint) in given.joints.iter().enumerate().skip(number) {
        if index > number {
            reach += joint.parent_from_joint.translation.vector.norm();
        }
        if joint.kind == LinkKind::Prismatic && index > number {
            reach += joint.limits.low.abs().max(joint.limits.high.abs());
        }
        let Some(body) = &joint.body else { continue };
        let distance = reach + Vector3::from(body.centre).norm();
        let spread = body.inertia[..3].iter().copied().fold(0.0, f64::max);
        (weight, inertia) = match is_linear {
            true => (weight + GRAVITY * body.mass, inertia + body.mass),
            false => (weight + GRAVITY * body.mass * distance, inertia + body.mass * distance * distance + spread),
        };
    }
    Load { weight, inertia }
}

const GRAVITY: f64 = 9.81;

/// Joint positions per motor position, rad/rad or m/rad, row by row.
fn joints_from_motors(given: &ChainParameters) -> Vec<Vec<f64>> {
    let count = given.joints.len();
    let motors = DMatrix::from_fn(count, count, |row, column| match &given.motors_from_joints {
        Some(rows) => rows[row][column],
        None if row == column => given.joints[row].ratio,
        None => 0.0,
    });
    let joints = motors.try_inverse().expect(SOUND);
    (0..count).map(|row| joints.row(row).iter().copied().collect()).collect()
}

const SOUND: &str = "a parsed chain has sound numbers";
