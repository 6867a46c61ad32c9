//! Examination of a robot by its contract: kinematics that contradict each other are refused before anything moves.

use std::f64::consts::PI;

use controller::robot::{Joints, KinematicsError, Pose, Robot};

/// Number of examined postures.
const POSTURES: u32 = 256;

/// Numbers with irrational roots, one per axis.
const PRIMES: [f64; 8] = [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0];

/// Step of joints for numerical derivatives, rad or m.
const STEP: f64 = 1e-6;

/// Greatest difference of poses, m and rad, and of positions, rad or m.
const CLOSE: f64 = 1e-6;

/// Greatest difference of a Jacobian from the numerical derivative, per 1 + its magnitude.
const DERIVATIVE: f64 = 1e-4;

/// Compares forward and inverse kinematics, Jacobian and drive train of a robot with each other, in postures throughout
/// its ranges. Describes the first contradiction.
pub fn examine(robot: &dyn Robot) -> Result<(), String> {
    let home = robot.home();
    let at_home = robot.joints_from_motors(&home).map_err(|error| format!("joints_from_motors at home: {error}"))?;
    posture(robot, &at_home)?;
    let mut reached = 0;
    for number in 1..=POSTURES {
        let Some(joints) = spread(robot, number) else {
            return Err("joint_limits has a range without numbers".to_owned());
        };
        if robot.motors_from_joints(&joints).is_ok() {
            posture(robot, &joints)?;
            reached += 1;
        }
    }
    match reached {
        0 => Err("motors_from_joints refuses every posture within the ranges of the joints".to_owned()),
        _ => Ok(()),
    }
}

/// Compares two poses of the flange at the same angles of the motors: the pose from `place`, of the emulated links, and
/// the pose from forward kinematics and drive train of the robot. Describes the first contradiction.
pub(super) fn examine_links(robot: &dyn Robot, mut place: impl FnMut(&[f64]) -> Option<Pose>) -> Result<(), String> {
    for joints in (1..=POSTURES).filter_map(|number| spread(robot, number)) {
        let (Ok(motors), Ok(pose)) = (robot.motors_from_joints(&joints), robot.forward(&joints)) else {
            continue;
        };
        let at = || format!("at the joints {joints:?}, motors {motors:?}");
        let Some(found) = place(&motors) else {
            return Err(format!("place_links has no pose of the links {}", at()));
        };
        let (distance, angle) = apart(&pose, &found);
        if !(distance <= CLOSE && angle <= CLOSE) {
            return Err(format!(
                "place_links has the flange {distance:.6} m and {angle:.6} rad from that of forward {}",
                at()
            ));
        }
    }
    Ok(())
}

/// Posture `number` of an even spread: each joint at a multiple of an irrational part of its range.
fn spread(robot: &dyn Robot, number: u32) -> Option<Joints> {
    let joint = |(axis, limits): (usize, &controller::robot::Limits)| {
        let (low, high) = if limits.is_continuous() { (-PI, PI) } else { (limits.low, limits.high) };
        let part = (f64::from(number) * PRIMES[axis % PRIMES.len()].sqrt()).fract();
        let joint = low + (high - low) * part;
        joint.is_finite().then_some(joint)
    };
    Joints::new(&robot.joint_limits().iter().enumerate().map(joint).collect::<Option<Vec<_>>>()?)
}

fn posture(robot: &dyn Robot, joints: &Joints) -> Result<(), String> {
    let at = |what: &str| format!("{what} at the joints {joints:?}");
    let motors = robot.motors_from_joints(joints).map_err(|error| format!("{}: {error}", at("motors_from_joints")))?;
    let back = robot.joints_from_motors(&motors).map_err(|error| format!("{}: {error}", at("joints_from_motors")))?;
    if !back.iter().zip(joints.iter()).all(|(back, joint)| (back - joint).abs() <= CLOSE) {
        return Err(format!("{} differs: {back:?}", at("joints_from_motors")));
    }
    let pose = robot.forward(joints).map_err(|error| format!("{}: {error}", at("forward")))?;
    if !pose.translation.vector.iter().all(|part| part.is_finite()) {
        return Err(format!("{} is no pose: {pose:?}", at("forward")));
    }
    let found = match robot.inverse(&pose, joints) {
        Ok(solutions) => robot.forward(solutions.preferred()),
        Err(KinematicsError::Singular { .. }) => Ok(pose),
        Err(error) => return Err(format!("{}, of the pose that forward has there: {error}", at("inverse"))),
    };
    let found = found.map_err(|error| format!("forward of a solution of {}: {error}", at("inverse")))?;
    let (distance, angle) = apart(&pose, &found);
    if !(distance <= CLOSE && angle <= CLOSE) {
        return Err(format!("{} misses its pose by {distance:.6} m and {angle:.6} rad", at("inverse")));
    }
    derivative(robot, joints)
}

/// Compares the Jacobian with the numerical derivative of the forward kinematics.
fn derivative(robot: &dyn Robot, joints: &Joints) -> Result<(), String> {
    let Ok(jacobian) = robot.jacobian(joints) else {
        return Ok(());
    };
    for axis in 0..robot.axes() {
        let moved = |by: f64| {
            let mut moved = *joints;
            moved[axis] += by;
            robot.forward(&moved)
        };
        // A posture at the edge of the workspace may have no neighbour.
        let (Ok(before), Ok(after)) = (moved(-STEP), moved(STEP)) else {
            continue;
        };
        let linear = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
        let turn = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * STEP);
        for row in 0..6 {
            let (stated, found) = (jacobian[(row, axis)], if row < 3 { linear[row] } else { turn[row - 3] });
            let is_close = (stated - found).abs() <= DERIVATIVE * (1.0 + found.abs());
            if !is_close {
                return Err(format!(
                    "jacobian at the joints {joints:?} has {stated:.6} in row {row}, column {axis}, and forward changes by \
                     {found:.6}"
                ));
            }
        }
    }
    Ok(())
}

/// Distance, m, and angle, rad.
fn apart(one: &Pose, other: &Pose) -> (f64, f64) {
    ((one.translation.vector - other.translation.vector).norm(), one.rotation.angle_to(&other.rotation))
}

#[cfg(test)]
mod tests {
    use super::super::Model;
    use super::*;

    #[test]
    fn the_built_in_robots_keep_the_contract() {
        for model in Model::ALL {
            let robot = model.parameters().kinematics().unwrap();
            assert_eq!(examine(&*robot), Ok(()), "{model:?}");
        }
    }
}
