//! A robot in the scene: its flange, the tips of its tool, and its force sensors.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::contact::Sphere;
use super::motion::{Motion, Moving, Place, Wrench};
use super::probe::{Sensor, Touch};
use crate::plant::{Kinematics, Mechanism};

pub(super) struct Arm {
    mechanism: Mechanism,
    /// Origin and axes of the base in the world.
    base: (Vector3<f64>, Matrix3<f64>),
    kinematics: Kinematics,
    /// The flange at the last step.
    before: Place,
    now: Place,
    /// The flange at this step.
    pub(super) flange: Moving,
    /// The flange over the present part of the step.
    pub(super) motion: Motion,
    pub(super) tips: Vec<Sphere>,
    pub(super) sensors: Vec<Sensor>,
    /// Switches that the tips of the tool close.
    pub(super) touches: Vec<Touch>,
    /// Wrench of the forces on the tool about the origin of the flange, in the axes of the world.
    pub(super) wrench: Wrench,
    /// Sum of the forces on the tips, N, in the axes of the world.
    tip_force: Vector3<f64>,
}

impl Arm {
    /// A robot whose mechanism has already entered the scene. `base`: pose of the base frame in the world.
    pub(super) fn new(mechanism: &Mechanism, base: &Isometry3<f64>) -> Self {
        let base = (base.translation.vector, base.rotation.to_rotation_matrix().into_inner());
        let (kinematics, _) = mechanism.kinematics();
        let still = Place { origin: Vector3::zeros(), turn: UnitQuaternion::identity() };
        let mut arm = Self {
            mechanism: mechanism.clone(),
            base,
            kinematics,
            before: still,
            now: still,
            flange: Moving::WORLD,
            motion: Motion::standing(Vector3::zeros(), Matrix3::identity()),
            tips: Vec::new(),
            sensors: Vec::new(),
            touches: Vec::new(),
            wrench: Wrench::default(),
            tip_force: Vector3::zeros(),
        };
        arm.follow();
        arm.before = arm.now;
        arm
    }

    /// Computes the flange from the present motor angles, and clears the forces.
    pub(super) fn follow(&mut self) {
        let (kinematics, velocities) = self.mechanism.kinematics();
        let twist = kinematics.twist(&velocities);
        let (origin, axes) = &self.base;
        self.kinematics = kinematics;
        self.flange = Moving {
            origin: origin + axes * kinematics.flange.origin,
            axes: axes * kinematics.flange.axes,
            velocity: axes * twist.velocity,
            spin: axes * twist.spin,
        };
        let turn = Rotation3::from_matrix_unchecked(self.flange.axes);
        self.before = self.now;
        self.now = Place { origin: self.flange.origin, turn: UnitQuaternion::from_rotation_matrix(&turn) };
        // Two quaternions of opposite sign describe the same rotation. The interpolation needs the nearer one.
        if self.before.turn.coords.dot(&self.now.turn.coords) < 0.0 {
            self.now.turn = UnitQuaternion::new_unchecked(-self.now.turn.into_inner());
        }
        self.wrench = Wrench::default();
        self.tip_force = Vector3::zeros();
    }

    /// Sets the motion of the flange over a part of the last step: from the share `from` of the step to the share `to`.
    /// The part lasts `dt` seconds.
    pub(super) fn set_motion(&mut self, from: f64, to: f64, dt: f64) {
        let place = |share| self.before.towards(&self.now, share);
        self.motion = Motion::between(&place(from), &place(to), dt);
    }

    /// Upward direction of the mechanism, in the world.
    pub(super) fn up(&self) -> Vector3<f64> {
        self.base.1 * Vector3::from(self.mechanism.up())
    }

    /// Place of the flange in the world.
    pub(super) fn place(&self) -> Isometry3<f64> {
        Isometry3::from_parts(self.now.origin.into(), self.now.turn)
    }

    /// Adds a force, N, on the tool at a point, m. Both are in the axes of the world.
    pub(super) fn push(&mut self, at: &Vector3<f64>, force: &Vector3<f64>) {
        self.wrench.push(&(at - self.flange.origin), force);
    }

    /// Adds a force, N, on a tip of the tool at a point, m. Both are in the axes of the world.
    pub(super) fn push_tip(&mut self, at: &Vector3<f64>, force: &Vector3<f64>) {
        self.tip_force += force;
        self.push(at, force);
    }

    /// Applies the forces to the sensors, the switches and the motors.
    pub(super) fn finish(&mut self, gravity: &Vector3<f64>) {
        for sensor in &mut self.sensors {
            sensor.measure(&self.flange, &self.wrench, gravity);
        }
        for touch in &self.touches {
            touch.measure(&self.tip_force);
        }
        let axes = &self.base.1;
        let (force, torque) = (axes.tr_mul(&self.wrench.force), axes.tr_mul(&self.wrench.torque));
        self.mechanism.push(&self.kinematics, &force, &torque);
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        self.mechanism.leave_scene();
    }
}
