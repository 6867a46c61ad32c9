//! Frames of a chain: forward kinematics and Jacobian.

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use servo::MAX_AXES;

use super::super::{Jacobian, LinkKind, Pose};
use super::parameters::{ChainParameters, direction};

/// Fixed pose of one joint in the previous joint, with the z axes on the axes of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    prismatic: bool,
}

/// Fixed geometry of a chain.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Geometry {
    steps: [Step; MAX_AXES],
    pub(super) axes: usize,
    end_rotation: Matrix3<f64>,
    end_translation: Vector3<f64>,
}

/// Axes of a chain at one posture, and its flange, in the base frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frames {
    /// Directions of the axes.
    pub(super) axes: [Vector3<f64>; MAX_AXES],
    /// A point on each axis, m.
    pub(super) points: [Vector3<f64>; MAX_AXES],
    /// Orientation of the flange.
    pub(super) rotation: Matrix3<f64>,
    /// Origin of the flange, m.
    pub(super) origin: Vector3<f64>,
}

impl Geometry {
    /// The geometry of parameters that passed their check.
    pub(super) fn new(parameters: &ChainParameters) -> Self {
        let nothing = Step { rotation: Matrix3::identity(), translation: Vector3::zeros(), prismatic: false };
        let mut steps = [nothing; MAX_AXES];
        let mut aligned = Matrix3::identity();
        for (step, joint) in steps.iter_mut().zip(&parameters.joints) {
            let (rotation, translation) = parts(&joint.parent_from_joint);
            let next = aligning(direction(joint.axis).expect("the check refuses an axis without direction"));
            step.rotation = aligned.transpose() * rotation * next;
            step.translation = aligned.transpose() * translation;
            step.prismatic = joint.kind == LinkKind::Prismatic;
            aligned = next;
        }
        let (rotation, translation) = parts(&parameters.link_from_flange);
        Self {
            steps,
            axes: parameters.joints.len(),
            end_rotation: aligned.transpose() * rotation,
            end_translation: aligned.transpose() * translation,
        }
    }

    /// Whether a joint is linear.
    pub(super) fn is_prismatic(&self, axis: usize) -> bool {
        self.steps[axis].prismatic
    }

    /// A point of the base on the first axis, m.
    pub(super) fn root(&self) -> Vector3<f64> {
        self.steps[0].translation
    }

    /// Distance along the chain from the first axis to the flange with linear joints at zero, m.
    pub(super) fn length(&self) -> f64 {
        let between = self.steps[1..self.axes].iter().map(|step| step.translation.norm());
        between.sum::<f64>() + self.end_translation.norm()
    }

    /// The frames at these joint positions. Entries beyond the axes are zero.
    pub(super) fn frames(&self, joints: &[f64; MAX_AXES]) -> Frames {
        let zero = Vector3::zeros();
        let mut frames =
            Frames { axes: [zero; MAX_AXES], points: [zero; MAX_AXES], rotation: Matrix3::identity(), origin: zero };
        let (mut rotation, mut origin) = (Matrix3::identity(), zero);
        for (axis, (step, &joint)) in self.steps[..self.axes].iter().zip(joints).enumerate() {
            origin += rotation * step.translation;
            rotation *= step.rotation;
            let along: Vector3<f64> = rotation.column(2).into();
            frames.axes[axis] = along;
            if step.prismatic {
                origin += along * joint;
            } else {
                let (sin, cos) = joint.sin_cos();
                let (x, y): (Vector3<f64>, Vector3<f64>) = (rotation.column(0).into(), rotation.column(1).into());
                rotation.set_column(0, &(x * cos + y * sin));
                rotation.set_column(1, &(y * cos - x * sin));
            }
            frames.points[axis] = origin;
        }
        frames.origin = origin + rotation * self.end_translation;
        frames.rotation = rotation * self.end_rotation;
        frames
    }

    /// The Jacobian of the flange.
    pub(super) fn jacobian(&self, frames: &Frames) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        for axis in 0..self.axes {
            let along = frames.axes[axis];
            if self.is_prismatic(axis) {
                jacobian.fixed_view_mut::<3, 1>(0, axis).copy_from(&along);
            } else {
                let linear = along.cross(&(frames.origin - frames.points[axis]));
                jacobian.fixed_view_mut::<3, 1>(0, axis).copy_from(&linear);
                jacobian.fixed_view_mut::<3, 1>(3, axis).copy_from(&along);
            }
        }
        jacobian
    }
}

impl Frames {
    /// `base_from_flange`.
    pub(super) fn flange(&self) -> Pose {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Pose::from_parts(Translation3::from(self.origin), UnitQuaternion::from_rotation_matrix(&rotation))
    }
}

/// Rotation matrix and translation of a pose.
fn parts(pose: &Pose) -> (Matrix3<f64>, Vector3<f64>) {
    let rotation = UnitQuaternion::from_quaternion(pose.rotation.into_inner());
    (rotation.to_rotation_matrix().into_inner(), pose.translation.vector)
}

/// A rotation whose z axis is `axis`: exact for an axis of the frame.
fn aligning(axis: Vector3<f64>) -> Matrix3<f64> {
    if axis == Vector3::z() {
        return Matrix3::identity();
    }
    let least = axis.iamin();
    let mut across = Vector3::zeros();
    across[least] = 1.0;
    let x = (across - axis * axis[least]).normalize();
    Matrix3::from_columns(&[x, axis.cross(&x), axis])
}
