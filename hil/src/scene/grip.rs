//! A gripper that holds a body: a spring and a damper in six dimensions.

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::motion::{Motion, Moving, Wrench};

/// Springs and dampers between a gripper and the body in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripConfig {
    /// Force per displacement, N/m.
    pub stiffness: f64,
    /// Force per velocity, N·s/m.
    pub damping: f64,
    /// Torque per small angle, N·m/rad.
    pub turning_stiffness: f64,
    /// Torque per angular velocity, N·m·s/rad.
    pub turning_damping: f64,
}

impl GripConfig {
    /// 1e5 N/m, 300 N·s/m and 2e3 N·m/rad. Damping per stiffness is 3 ms for displacements and for angles (chosen
    /// here).
    pub const NOMINAL: Self = Self { stiffness: 1e5, damping: 300.0, turning_stiffness: 2e3, turning_damping: 6.0 };

    pub(super) fn is_passive(&self) -> bool {
        [self.stiffness, self.damping, self.turning_stiffness, self.turning_damping]
            .iter()
            .all(|value| value.is_finite() && *value >= 0.0)
    }

    /// Mean force per mean velocity, N·s/m, and mean torque per angular velocity, N·m·s, over a step of `dt` seconds
    /// near the relaxed angle.
    pub(super) fn resistance(&self, dt: f64) -> (f64, f64) {
        (self.damping + 0.5 * dt * self.stiffness, self.turning_damping + 0.5 * dt * self.turning_stiffness)
    }
}

/// One end of a grip: a point and three axes that are fixed to a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    pub(super) point: Vector3<f64>,
    pub(super) axes: Matrix3<f64>,
}

impl From<&Isometry3<f64>> for End {
    fn from(pose: &Isometry3<f64>) -> Self {
        Self { point: pose.translation.vector, axes: pose.rotation.to_rotation_matrix().into_inner() }
    }
}

/// Force and torque of a grip on its body, in the axes of the world. The opposite force acts on the gripper at
/// `anchor`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Hold {
    /// Point of the body, m, at which the force acts.
    pub(super) point: Vector3<f64>,
    /// Point of the gripper, m.
    pub(super) anchor: Vector3<f64>,
    /// Force at the point, N.
    pub(super) force: Vector3<f64>,
    /// Torque, N·m.
    pub(super) torque: Vector3<f64>,
}

/// Three springs between the axes of gripper and body: the energy is `turning_stiffness · (1 - cos angle)`.
fn turning(config: &GripConfig, body: &Matrix3<f64>, gripper: &Matrix3<f64>) -> Vector3<f64> {
    let springs = (0..3).map(|axis| body.column(axis).cross(&gripper.column(axis)));
    0.5 * config.turning_stiffness * springs.sum::<Vector3<f64>>()
}

/// Mean forces over a step of `dt` seconds.
pub(super) fn over_step(
    config: &GripConfig,
    (gripper, anchor): (&Motion, &End),
    (body, held): (&Motion, &End),
    dt: f64,
) -> Hold {
    let anchors = gripper.points(&anchor.point);
    let points = body.points(&held.point);
    let stretch = [points[0] - anchors[0], points[1] - anchors[1]];
    let force = -0.5 * config.stiffness * (stretch[0] + stretch[1]) - (config.damping / dt) * (stretch[1] - stretch[0]);
    let torque = turning(config, &(body.mean_axes() * held.axes), &(gripper.mean_axes() * anchor.axes))
        - config.turning_damping * (body.spin - gripper.spin);
    Hold { point: 0.5 * (points[0] + points[1]), anchor: 0.5 * (anchors[0] + anchors[1]), force, torque }
}

/// Forces at one instant.
pub(super) fn at_instant(
    config: &GripConfig,
    (gripper, anchor): (&Moving, &End),
    (body, held): (&Moving, &End),
) -> Hold {
    let at = gripper.origin + gripper.axes * anchor.point;
    let point = body.origin + body.axes * held.point;
    let rate = body.velocity_at(&point) - gripper.velocity_at(&at);
    let torque = turning(config, &(body.axes * held.axes), &(gripper.axes * anchor.axes))
        - config.turning_damping * (body.spin - gripper.spin);
    Hold { point, anchor: at, force: -config.stiffness * (point - at) - config.damping * rate, torque }
}

/// Energy of the springs, J.
pub(super) fn energy(config: &GripConfig, (gripper, anchor): (&Moving, &End), (body, held): (&Moving, &End)) -> f64 {
    let stretch = body.origin + body.axes * held.point - gripper.origin - gripper.axes * anchor.point;
    let apart = body.axes * held.axes - gripper.axes * anchor.axes;
    0.5 * config.stiffness * stretch.norm_squared() + 0.25 * config.turning_stiffness * apart.norm_squared()
}

impl Hold {
    /// Adds the opposite of the forces to the wrench on the gripper about `origin`, m.
    pub(super) fn pull(&self, wrench: &mut Wrench, origin: &Vector3<f64>) {
        wrench.push(&(self.anchor - origin), &-self.force);
        wrench.torque -= self.torque;
    }
}
