//! Notes on postures beside a singular posture, in which a pose does not determine all joints.

use std::f64::consts::TAU;

use controller::robot::{Joints, KinematicsError, Robot};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Change of a pose, m and rad: the sixth digit.
const CHANGE: f64 = 1e-6;

/// Motion of an axis by this change above which the posture counts as beside a singular posture, rad or m. Far from
/// singular postures, an axis moves by about 1e-6.
const SENSITIVE: f64 = 5e-4;

/// Largest difference of an axis that is neglected, rad or m.
const SAME: f64 = 1e-6;

/// The note on a posture beside a singular posture: the axis that the pose does not determine, and what to do if this
/// axis differs from the posture `near`. `near_is`: name of `near` in the note.
pub(super) fn note(robot: &dyn Robot, joints: &Joints, near: &Joints, near_is: &str) -> Option<String> {
    let axis = open_axis(robot, joints).ok()??;
    let by = (joints[axis] - near[axis]).abs();
    let told = match by < SAME {
        true => format!("the axis is that of {near_is}"),
        false => format!(
            "its last digits do, and the axis is {by:.3} from {near_is}: give positions and orientations with nine digits, or \
             move the joints"
        ),
    };
    Some(format!("beside a singular posture, and the pose does not determine axis {axis}: {told}"))
}

/// The axis that moves farthest if the pose changes in its sixth digit; `None` if no axis moves far. Among axes with at
/// least 90 % of the greatest motion, the axis nearest to the base.
fn open_axis(robot: &dyn Robot, joints: &Joints) -> Result<Option<usize>, KinematicsError> {
    let pose = robot.forward(joints)?;
    let mut moved = vec![0.0_f64; robot.axes()];
    for direction in [Vector3::x(), Vector3::y(), Vector3::z()] {
        for by in [CHANGE, -CHANGE].map(|by| direction * by) {
            let turned = Isometry3::from_parts(pose.translation, UnitQuaternion::from_scaled_axis(by) * pose.rotation);
            // A changed pose may be out of reach.
            let solved = [Translation3::from(by) * pose, turned].map(|changed| robot.inverse(&changed, joints));
            for changed in solved.iter().flatten() {
                for (axis, moved) in moved.iter_mut().enumerate() {
                    // Whole turns lead to the same pose.
                    let by = changed.preferred()[axis] - joints[axis];
                    *moved = moved.max((by - TAU * (by / TAU).round()).abs());
                }
            }
        }
    }
    let most = moved.iter().copied().fold(0.0, f64::max);
    Ok(moved.iter().position(|&moved| most > SENSITIVE && moved > 0.9 * most))
}
