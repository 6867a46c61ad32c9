//! Motion of a frame over one step.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Poses of a frame at the beginning and at the end of a step, in the world.
///
/// The rotation follows Cayley's map: R₁ − R₀ = dt · ω × ½ (R₀ + R₁), with the rotation matrices R₀ and R₁ and the mean
/// angular velocity ω. With mean positions as lever arms, the work of a force and of its torque over the step is then
/// exact (Simo, Tarnow, Wong, 1992).
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// Origin at the beginning and at the end, m.
    pub(super) origin: [Vector3<f64>; 2],
    /// Axes as columns, at the beginning and at the end.
    pub(super) axes: [Matrix3<f64>; 2],
    /// Mean angular velocity, rad/s.
    pub(super) spin: Vector3<f64>,
}

impl Motion {
    /// A frame at rest.
    pub(super) fn standing(origin: Vector3<f64>, axes: Matrix3<f64>) -> Self {
        Self { origin: [origin; 2], axes: [axes; 2], spin: Vector3::zeros() }
    }

    /// The motion from one place to another in `dt` seconds.
    pub(super) fn between(start: &Place, end: &Place, dt: f64) -> Self {
        let turn = end.turn * start.turn.inverse();
        let half = turn.imag() / turn.scalar();
        Self { origin: [start.origin, end.origin], axes: [start.axes(), end.axes()], spin: half * (2.0 / dt) }
    }

    /// A point of the frame at the beginning and at the end of the step, m.
    pub(super) fn points(&self, local: &Vector3<f64>) -> [Vector3<f64>; 2] {
        [self.origin[0] + self.axes[0] * local, self.origin[1] + self.axes[1] * local]
    }

    /// Mean origin, m.
    pub(super) fn middle(&self) -> Vector3<f64> {
        0.5 * (self.origin[0] + self.origin[1])
    }

    /// Mean axes. The matrix differs from a rotation by the order of the square of the rotation angle in the step.
    pub(super) fn mean_axes(&self) -> Matrix3<f64> {
        0.5 * (self.axes[0] + self.axes[1])
    }
}

/// Position and orientation of a frame in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Origin, m.
    pub(super) origin: Vector3<f64>,
    /// Orientation.
    pub(super) turn: UnitQuaternion<f64>,
}

impl Place {
    pub(super) fn axes(&self) -> Matrix3<f64> {
        self.turn.to_rotation_matrix().into_inner()
    }

    /// The place at `share` of the displacement to `end`, 0 to 1.
    pub(super) fn towards(&self, end: &Self, share: f64) -> Self {
        Self { origin: self.origin + share * (end.origin - self.origin), turn: self.turn.nlerp(&end.turn, share) }
    }
}

/// Motion of a frame at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moving {
    /// Origin, m.
    pub(super) origin: Vector3<f64>,
    /// Axes as columns.
    pub(super) axes: Matrix3<f64>,
    /// Velocity of the origin, m/s.
    pub(super) velocity: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub(super) spin: Vector3<f64>,
}

impl Moving {
    /// The world itself.
    pub(super) const WORLD: Self = Self {
        origin: Vector3::new(0.0, 0.0, 0.0),
        axes: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        velocity: Vector3::new(0.0, 0.0, 0.0),
        spin: Vector3::new(0.0, 0.0, 0.0),
    };

    /// Velocity, m/s, of the point of the frame that is at `point`, m, in the world.
    pub(super) fn velocity_at(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.velocity + self.spin.cross(&(point - self.origin))
    }
}

/// A force and a torque about a reference point, in the world's axes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wrench {
    /// Force, N.
    pub(super) force: Vector3<f64>,
    /// Torque, N·m.
    pub(super) torque: Vector3<f64>,
}

impl Wrench {
    /// Adds a force that acts at `arm`, m, from the reference point.
    pub(super) fn push(&mut self, arm: &Vector3<f64>, force: &Vector3<f64>) {
        self.force += force;
        self.torque += arm.cross(force);
    }
}
