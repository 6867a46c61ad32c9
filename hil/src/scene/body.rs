//! A free rigid body: a box of uniform density.

use nalgebra::{Isometry3, Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3, Vector6};

use super::contact::{Sphere, Surface};
use super::motion::{Motion, Moving, Place, Wrench};
use super::surface::{Material, Shape};
use super::{SceneError, finite, lengths, passive};

/// A box or a bar that moves freely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyConfig {
    /// Mass, kg.
    pub mass: f64,
    /// Half of each edge, m.
    pub half: [f64; 3],
    /// Elasticity and friction of the faces. The values apply where a corner of another body or the tip of a tool
    /// touches a face. Where a corner of this body touches another surface, the values of the other surface apply.
    pub material: Material,
    /// Place of the centre in the world.
    pub pose: Isometry3<f64>,
    /// Velocity of the centre, m/s.
    pub velocity: [f64; 3],
    /// Angular velocity in the world's axes, rad/s.
    pub spin: [f64; 3],
}

impl BodyConfig {
    /// Refuses a body with an invalid number or a surface that is not passive.
    pub(super) fn check(&self) -> Result<(), SceneError> {
        passive(&self.material)?;
        lengths(self.half)?;
        finite(&self.pose, "the place of a body")?;
        if !(self.mass > 0.0 && self.mass.is_finite()) {
            return Err(SceneError::Mass { mass: self.mass });
        }
        if !self.velocity.iter().chain(&self.spin).all(|value| value.is_finite()) {
            return Err(SceneError::NotFinite { what: "the velocity of a body" });
        }
        Ok(())
    }
}

/// Place and motion of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyState {
    /// Place of the centre in the world.
    pub pose: Isometry3<f64>,
    /// Velocity of the centre, m/s.
    pub velocity: Vector3<f64>,
    /// Angular velocity in the world's axes, rad/s.
    pub spin: Vector3<f64>,
}

/// Number of corners of a box.
pub(super) const CORNERS: usize = 8;

#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) mass: f64,
    /// Principal moments of inertia about the axes of the body, kg·m².
    pub(super) inertia: Vector3<f64>,
    pub(super) surface: Surface,
    pub(super) corners: [Sphere; CORNERS],
    pub(super) place: Place,
    pub(super) velocity: Vector3<f64>,
    /// Angular momentum about the centre in the world's axes, kg·m²/s.
    pub(super) momentum: Vector3<f64>,
    /// The present step.
    pub(super) motion: Motion,
    /// Forces over the present step.
    pub(super) wrench: Wrench,
    /// Mean velocity over the present step, m/s.
    mean: Vector3<f64>,
    /// Velocity and angular momentum at the end of the present step.
    end: (Vector3<f64>, Vector3<f64>),
    end_place: Place,
    /// Resistance of the grips: force and torque per mean velocity and angular velocity over the present step, N·s/m,
    /// N·s and N·m·s.
    resistance: Matrix6<f64>,
    /// Factor of a correction of the guess, because of the resistance; `None` without a grip.
    share: Option<Matrix6<f64>>,
}

impl Body {
    pub(super) fn new(config: &BodyConfig) -> Self {
        let half = Vector3::from(config.half);
        let squared = half.component_mul(&half);
        let inertia = squared.map(|one| config.mass / 3.0 * (squared.sum() - one));
        let place = Place { origin: config.pose.translation.vector, turn: config.pose.rotation };
        let axes = place.axes();
        let momentum = axes * inertia.component_mul(&axes.tr_mul(&Vector3::from(config.spin)));
        let corner = |number: usize| {
            let sign = |bit: usize| if number >> bit & 1 == 0 { 1.0 } else { -1.0 };
            Sphere { centre: half.component_mul(&Vector3::new(sign(0), sign(1), sign(2))), radius: 0.0 }
        };
        let velocity = Vector3::from(config.velocity);
        Self {
            mass: config.mass,
            inertia,
            surface: Surface {
                shape: Shape::Box { half: config.half },
                material: config.material,
                belt: Vector3::zeros(),
            },
            corners: std::array::from_fn(corner),
            place,
            velocity,
            momentum,
            motion: Motion::standing(place.origin, axes),
            wrench: Wrench::default(),
            mean: velocity,
            end: (velocity, momentum),
            end_place: place,
            resistance: Matrix6::zeros(),
            share: None,
        }
    }

    /// Angular velocity, rad/s.
    pub(super) fn spin(&self) -> Vector3<f64> {
        let axes = self.place.axes();
        axes * axes.tr_mul(&self.momentum).component_div(&self.inertia)
    }

    pub(super) fn state(&self) -> BodyState {
        let pose = Isometry3::from_parts(self.place.origin.into(), self.place.turn);
        BodyState { pose, velocity: self.velocity, spin: self.spin() }
    }

    pub(super) fn moving(&self) -> Moving {
        Moving { origin: self.place.origin, axes: self.place.axes(), velocity: self.velocity, spin: self.spin() }
    }

    /// Kinetic energy, J.
    pub(super) fn kinetic_energy(&self) -> f64 {
        let local = self.place.axes().tr_mul(&self.momentum);
        0.5 * (self.mass * self.velocity.norm_squared() + local.component_div(&self.inertia).dot(&local))
    }

    /// Begins a step. The first guess is the motion without forces.
    pub(super) fn begin(&mut self, dt: f64) {
        let axes = self.place.axes();
        self.motion = Motion::standing(self.place.origin, axes);
        self.mean = self.velocity;
        self.end = (self.velocity, self.momentum);
        self.end_place = self.place;
        self.resistance = Matrix6::zeros();
        self.share = None;
        self.set_motion(axes.tr_mul(&self.momentum).component_div(&self.inertia), dt);
    }

    /// Adds the resistance of a grip at `arm`, m, from the centre: `linear`, N·s/m, and `turning`, N·m·s.
    pub(super) fn resist(&mut self, arm: &Vector3<f64>, linear: f64, turning: f64, dt: f64) {
        let cross = arm.cross_matrix();
        let add = |matrix: &mut Matrix6<f64>, row, column, block: Matrix3<f64>| {
            let mut view = matrix.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        add(&mut self.resistance, 0, 0, Matrix3::identity() * linear);
        add(&mut self.resistance, 0, 3, cross * -linear);
        add(&mut self.resistance, 3, 0, cross * linear);
        add(&mut self.resistance, 3, 3, cross.tr_mul(&cross) * linear + Matrix3::identity() * turning);
        let axes = self.motion.axes[0];
        let mut mass = Matrix6::zeros();
        add(&mut mass, 0, 0, Matrix3::identity() * self.mass);
        add(&mut mass, 3, 3, axes * Matrix3::from_diagonal(&self.inertia) * axes.transpose());
        // The sum is positive definite because the mass matrix is positive definite.
        self.share = (mass + self.resistance * (0.5 * dt)).cholesky().map(|sum| sum.solve(&mass));
    }

    /// Computes the end of the step under the forces of the present guess. Returns an upper bound, m/s, of the change
    /// of any body point's mean velocity since the last guess.
    ///
    /// The mean velocity is the mean of the velocities at the beginning and at the end of the step. The angular
    /// velocity follows from the mean of the angular momenta at both ends, each in the axes of the body. The change of
    /// energy is exactly the work of the forces, and the change of momentum is exactly their impulse (Lewis, Simo,
    /// 1994).
    ///
    /// For a body in a grip, a quasi-Newton method computes the next guess. Plain fixed-point iteration would not
    /// converge at any practical step if a strong damper holds a light bar.
    pub(super) fn improve(&mut self, dt: f64) -> f64 {
        let velocity = self.velocity + self.wrench.force * (dt / self.mass);
        let momentum = self.momentum + self.wrench.torque * dt;
        let mean = 0.5 * (self.velocity + velocity);
        let local = self.motion.axes[0].tr_mul(&self.momentum) + self.motion.axes[1].tr_mul(&momentum);
        let rates = (0.5 * local).component_div(&self.inertia);
        let turned = self.motion.axes[0] * rates - self.motion.spin;
        let moved = mean - self.mean;
        self.end = (velocity, momentum);
        let (moved, turned) = if let Some(share) = &self.share {
            let all = Vector6::new(moved.x, moved.y, moved.z, turned.x, turned.y, turned.z);
            let all = share * all;
            let (moved, turned) = (Vector3::new(all[0], all[1], all[2]), Vector3::new(all[3], all[4], all[5]));
            self.mean += moved;
            let spin = self.motion.spin + turned;
            self.set_motion(self.motion.axes[0].tr_mul(&spin), dt);
            (moved, turned)
        } else {
            self.mean = mean;
            self.set_motion(rates, dt);
            (moved, turned)
        };
        moved.norm() + turned.norm() * self.surface.shape.extent()
    }

    /// Sets the end of the step from the mean velocity and the angular velocity in the axes of the body.
    fn set_motion(&mut self, rates: Vector3<f64>, dt: f64) {
        let half = rates * (0.5 * dt);
        let turn = UnitQuaternion::new_normalize(Quaternion::from_parts(1.0, half));
        self.end_place = Place { origin: self.place.origin + self.mean * dt, turn: self.place.turn * turn };
        self.motion.origin[1] = self.end_place.origin;
        self.motion.axes[1] = self.end_place.axes();
        self.motion.spin = self.motion.axes[0] * rates;
    }

    /// Ends the step.
    pub(super) fn finish(&mut self) {
        (self.velocity, self.momentum) = self.end;
        // Rounding errors of the product of rotations would grow with the number of steps.
        self.end_place.turn.renormalize();
        self.place = self.end_place;
    }

    /// Adds a force at a point of the world to the forces over the present step.
    pub(super) fn push(&mut self, at: &Vector3<f64>, force: &Vector3<f64>) {
        let arm = at - self.motion.middle();
        self.wrench.push(&arm, force);
    }
}
