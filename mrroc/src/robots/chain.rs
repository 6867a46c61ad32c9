//! What emulates a chain that a cell describes. The emulator takes the numbers of the description, and computes with them
//! by itself.

use std::sync::Arc;

use controller::robot::{ChainParameters, LinkKind};
use hil::plant::{ChainBodies, ChainBodyJoint, ChainError, Duty};
use hil::{AxisConfig, Mechanism, MechanismConfig};
use nalgebra::{DMatrix, UnitQuaternion};

/// The links of the chain as one mechanism; `None` where the description knows no mass.
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
    let rotors: Vec<_> = (0..joints.len()).map(|number| duty(given, number).rotor()).collect();
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
    let duty = duty(given, number);
    let load =
        mechanism(given).ok().flatten().map(|mechanism| Mechanism::new(mechanism).load(number).inertia - duty.rotor());
    AxisConfig::nominal(&Duty { load: load.unwrap_or(duty.load), ..duty })
}

/// What the motor of an axis must do, where the description knows it. Its load is twice its rotor.
fn duty(given: &ChainParameters, number: usize) -> Duty {
    let joint = &given.joints[number];
    let ratio = match &given.motors_from_joints {
        Some(rows) => rows[number].iter().fold(0.0, |most, factor| f64::max(most, factor.abs())),
        None => joint.ratio.abs(),
    };
    let duty = Duty {
        torque: joint.effort.map_or(TORQUE, |effort| effort / ratio),
        velocity: joint.velocity.map_or(VELOCITY, |velocity| velocity * ratio),
        load: 0.0,
        travel: None,
    };
    Duty { load: 2.0 * duty.rotor(), ..duty }
}

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

/// Torque, N·m, and velocity, rad/s, of a motor of which the description says nothing.
const TORQUE: f64 = 1.0;
const VELOCITY: f64 = 300.0;

const SOUND: &str = "a parsed chain has sound numbers";
