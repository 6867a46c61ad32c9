//! The error of a posture with respect to a pose.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::geometry::Frames;

/// A pose of the flange to be reached.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    /// Origin of the flange in the base frame, m.
    pub(super) origin: Vector3<f64>,
    /// Orientation of the flange in the base frame.
    pub(super) rotation: Matrix3<f64>,
    /// Direction in the flange frame about which the flange may turn.
    pub(super) free_axis: Option<Vector3<f64>>,
}

/// Displacement from a posture to its target: translation of the origin, m, and rotation vector, rad, both in the base
/// frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseError {
    pub(super) linear: Vector3<f64>,
    pub(super) angular: Vector3<f64>,
}

impl Target {
    /// The error of a posture.
    pub(super) fn error(&self, frames: &Frames) -> PoseError {
        let angular = match self.free_axis {
            None => rotation_vector(&(self.rotation * frames.rotation.transpose())),
            Some(axis) => between(&(frames.rotation * axis), &(self.rotation * axis)),
        };
        PoseError { linear: self.origin - frames.origin, angular }
    }
}

impl PoseError {
    /// Distance, m.
    pub(super) fn distance(&self) -> f64 {
        self.linear.norm()
    }

    /// Angle, rad.
    pub(super) fn angle(&self) -> f64 {
        self.angular.norm()
    }

    /// Both parts as one vector, lengths in units of `length` m.
    pub(super) fn scaled(&self, length: f64) -> Vector6<f64> {
        let (v, w) = (self.linear / length, self.angular);
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }
}

/// Rotation vector of a rotation matrix: the axis times the angle, which is at most π.
fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let m = rotation;
    let twice = Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]);
    let (sin, cos) = (0.5 * twice.norm(), 0.5 * (m.trace() - 1.0));
    if sin > 1e-6 {
        return twice * (0.5 * sin.atan2(cos) / sin);
    }
    if cos > 0.0 {
        return twice * 0.5;
    }
    // Half a turn: R + 1 is twice the dyad of the axis.
    let dyad = m + Matrix3::identity();
    let longest = (0..3).map(|column| dyad.column(column).into_owned()).max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let axis = longest.and_then(|axis| axis.try_normalize(f64::EPSILON)).unwrap_or_else(Vector3::z);
    axis * std::f64::consts::PI
}

/// The shortest rotation vector that turns one unit vector to another.
fn between(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let (cross, cos) = (from.cross(to), from.dot(to));
    let sin = cross.norm();
    if sin > 1e-6 {
        return cross * (sin.atan2(cos) / sin);
    }
    if cos > 0.0 {
        return cross;
    }
    let mut aside = Vector3::zeros();
    aside[from.iamin()] = 1.0;
    from.cross(&aside).normalize() * std::f64::consts::PI
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn rotation_vectors_are_exact_from_no_turn_to_half_a_turn() {
        let axis = Vector3::new(0.3, -0.8, 0.5).normalize();
        for angle in [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.0, std::f64::consts::PI - 1e-4] {
            let found = rotation_vector(Rotation3::from_scaled_axis(axis * angle).matrix());
            assert!((found - axis * angle).norm() < 1e-11, "{angle}: {found}");
        }
        let half = rotation_vector(Rotation3::from_scaled_axis(axis * std::f64::consts::PI).matrix());
        assert!((half.norm() - std::f64::consts::PI).abs() < 1e-12 && half.cross(&axis).norm() < 1e-7);
        let back = between(&axis, &-axis);
        assert!((Rotation3::from_scaled_axis(back) * axis + axis).norm() < 1e-12);
    }
}
