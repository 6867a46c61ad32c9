//! The axes of a chain with all joints at zero, and where they meet or run parallel.

use nalgebra::{Matrix3, Rotation3, Vector3};
use servo::MAX_AXES;

use super::geometry::Geometry;
use super::pose_error::Target;
use super::subproblems::turned;

/// Largest sine between axes that count as parallel, and largest distance of axes that count as meeting, m. Angles in
/// descriptions are often rounded to six digits. Newton's method on the exact axes follows.
const SAME: f64 = 1e-5;

/// Axes of a chain with all joints at zero, in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Screws {
    pub(super) axes: [Vector3<f64>; MAX_AXES],
    pub(super) points: [Vector3<f64>; MAX_AXES],
    pub(super) prismatic: [bool; MAX_AXES],
    pub(super) count: usize,
    rotation: Matrix3<f64>,
    origin: Vector3<f64>,
}

/// The displacement of the flange from its place with all joints at zero to a target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Displacement {
    pub(super) rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Screws {
    pub(super) fn new(geometry: &Geometry) -> Self {
        let frames = geometry.frames(&[0.0; MAX_AXES]);
        Self {
            axes: frames.axes,
            points: frames.points,
            prismatic: std::array::from_fn(|axis| geometry.is_prismatic(axis)),
            count: geometry.axes,
            rotation: frames.rotation,
            origin: frames.origin,
        }
    }

    pub(super) fn displacement(&self, target: &Target) -> Displacement {
        let rotation = target.rotation * self.rotation.transpose();
        Displacement { rotation, translation: target.origin - rotation * self.origin }
    }

    /// A point moved by one revolute joint.
    pub(super) fn moved(&self, axis: usize, angle: f64, point: &Vector3<f64>) -> Vector3<f64> {
        let on = self.points[axis];
        on + turned(&self.axes[axis], angle, &(point - on))
    }

    pub(super) fn rotation(&self, axis: usize, angle: f64) -> Rotation3<f64> {
        super::subproblems::rotation(&self.axes[axis], angle)
    }

    pub(super) fn are_parallel(&self, a: usize, b: usize) -> bool {
        self.axes[a].cross(&self.axes[b]).norm() < SAME
    }

    /// The point at which two axes meet that are not parallel.
    pub(super) fn crossing(&self, a: usize, b: usize) -> Option<Vector3<f64>> {
        if self.are_parallel(a, b) {
            return None;
        }
        let (k, l) = (self.axes[a], self.axes[b]);
        let between = self.points[b] - self.points[a];
        let normal = k.cross(&l);
        if between.dot(&normal).abs() > SAME * normal.norm() {
            return None;
        }
        let along = between.cross(&l).dot(&normal) / normal.norm_squared();
        Some(self.points[a] + k * along)
    }

    /// Distance of a point from an axis, m.
    fn beside(&self, axis: usize, point: &Vector3<f64>) -> f64 {
        (point - self.points[axis]).cross(&self.axes[axis]).norm()
    }

    /// The point at which three axes meet.
    pub(super) fn meeting(&self, [a, b, c]: [usize; 3]) -> Option<Vector3<f64>> {
        self.crossing(a, b).filter(|point| !self.are_parallel(b, c) && self.beside(c, point) < SAME)
    }
}

impl Displacement {
    /// Position at the target of a point that moves with the flange. `point` is its position with all joints at zero.
    pub(super) fn of(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }
}
