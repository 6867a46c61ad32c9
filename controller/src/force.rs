//! Conversion of wrenches between frames, and the wrench of a tool on the force/torque sensor that carries the tool.
//!
//! A sensor between flange and tool measures the sum of two wrenches: the contact wrench on the tool, and the wrench of
//! weight and inertia of the load behind the sensor. [`Load::wrench`] computes the second wrench, and [`Load::contact`]
//! subtracts it from a measurement. [`Wrench::seen_from`] expresses a wrench in another frame. All functions are pure:
//! the caller passes angular velocity and accelerations, for example those of the set-points
//! ([`SensorMotion::commanded`]).
//!
//! Not modelled: forces of cables, hoses and coolant.

mod motion;

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use thiserror::Error;

/// Gravitational acceleration, m/s².
const GRAVITY: f64 = 9.81;

/// Largest violation of the triangle inequality of principal moments of inertia, relative to their sum.
const INERTIA_TOLERANCE: f64 = 1e-9;

/// A force, and a torque about the origin of a frame, both in the axes of this frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force, N.
    pub force: Vector3<f64>,
    /// Torque about the origin, N·m.
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// A wrench from forces along x, y and z, N, and torques about x, y and z, N·m. The order is that of
    /// [`WrenchState::wrench`](drive::wrench::WrenchState::wrench).
    pub fn from_components([fx, fy, fz, tx, ty, tz]: [f64; 6]) -> Self {
        Self { force: Vector3::new(fx, fy, fz), torque: Vector3::new(tx, ty, tz) }
    }

    /// Forces along x, y and z, N, and torques about x, y and z, N·m.
    pub fn components(&self) -> [f64; 6] {
        let Self { force, torque } = self;
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }

    /// The same wrench in another frame "to": the torque is about the origin of that frame, in its axes.
    /// `to_from_here`: pose of the present frame in the frame "to".
    ///
    /// The power of the wrench is the same in every frame.
    pub fn seen_from(&self, to_from_here: &Isometry3<f64>) -> Self {
        let force = to_from_here.rotation * self.force;
        let torque = to_from_here.rotation * self.torque + to_from_here.translation.vector.cross(&force);
        Self { force, torque }
    }
}

impl std::ops::Add for Wrench {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { force: self.force + other.force, torque: self.torque + other.torque }
    }
}

impl std::ops::Sub for Wrench {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { force: self.force - other.force, torque: self.torque - other.torque }
    }
}

/// The load behind a sensor: the tool, a carried object, and the tool-side plate of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    mass: f64,
    centre: Vector3<f64>,
    inertia: Matrix3<f64>,
}

/// Motion of a sensor relative to the base. All vectors are in the axes of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorMotion {
    /// Rotation from the axes of the sensor to those of the base.
    pub base_from_sensor: UnitQuaternion<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Angular acceleration, rad/s².
    pub angular_acceleration: Vector3<f64>,
    /// Acceleration of the sensor's origin, m/s²; zero at rest.
    pub acceleration: Vector3<f64>,
}

impl SensorMotion {
    /// A sensor at rest with this orientation.
    pub fn at_rest(base_from_sensor: UnitQuaternion<f64>) -> Self {
        let zero = Vector3::zeros();
        Self { base_from_sensor, angular_velocity: zero, angular_acceleration: zero, acceleration: zero }
    }
}

/// Why a load is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum LoadError {
    #[error("a mass of {mass} kg is not a number from 0 on")]
    Mass { mass: f64 },
    #[error("the centre of mass has a coordinate of {coordinate} m")]
    Centre { coordinate: f64 },
    /// The principal moments of a body are not negative, and none exceeds the sum of the other two.
    #[error("the inertia about the centre of mass is not that of a body")]
    Inertia,
}

impl Load {
    /// A load of `mass`, kg, with its centre of mass at `centre`, m, in the frame of the sensor. `inertia`: inertia
    /// about the centre of mass, kg·m², in the axes of the sensor.
    pub fn new(mass: f64, centre: Vector3<f64>, inertia: Matrix3<f64>) -> Result<Self, LoadError> {
        if !(mass >= 0.0 && mass.is_finite()) {
            return Err(LoadError::Mass { mass });
        }
        if let Some(&coordinate) = centre.iter().find(|coordinate| !coordinate.is_finite()) {
            return Err(LoadError::Centre { coordinate });
        }
        let finite = inertia.iter().all(|entry| entry.is_finite());
        let tolerance = INERTIA_TOLERANCE * inertia.trace().abs();
        if !finite || (inertia - inertia.transpose()).amax() > tolerance {
            return Err(LoadError::Inertia);
        }
        let moments = inertia.symmetric_eigenvalues();
        // No principal moment exceeds the sum of the other two. This condition also excludes negative moments.
        if 2.0 * moments.max() > moments.sum() + tolerance || moments.min() < -tolerance {
            return Err(LoadError::Inertia);
        }
        Ok(Self { mass, centre, inertia })
    }

    /// A load as a point mass, without inertia about its centre of mass. Sufficient for slow motions.
    pub fn of_weight(mass: f64, centre: Vector3<f64>) -> Result<Self, LoadError> {
        Self::new(mass, centre, Matrix3::zeros())
    }

    /// This load and another one, rigidly joined.
    #[must_use]
    pub fn carrying(&self, part: &Self) -> Self {
        let mass = self.mass + part.mass;
        if mass == 0.0 {
            return Self { inertia: self.inertia + part.inertia, ..*self };
        }
        let centre = (self.centre * self.mass + part.centre * part.mass) / mass;
        let about_centre = |load: &Self| {
            let arm = load.centre - centre;
            load.inertia + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * load.mass
        };
        Self { mass, centre, inertia: about_centre(self) + about_centre(part) }
    }

    /// Greatest absolute readings of a sensor by the weight of this load in any orientation: forces, N, then torques, N·m.
    pub fn greatest_weight(&self) -> [f64; 6] {
        let weight = self.mass * GRAVITY;
        let [x, y, z] = self.centre.into();
        [weight, weight, weight, weight * y.hypot(z), weight * z.hypot(x), weight * x.hypot(y)]
    }

    /// Whether the load has no mass and no inertia.
    pub fn is_none(&self) -> bool {
        self.mass == 0.0 && self.inertia == Matrix3::zeros()
    }

    /// Wrench on the sensor by weight and inertia of the load, in the frame of the sensor. The z axis of the base
    /// points upward.
    ///
    /// Newton and Euler about the centre of mass c: the force is F = m (g − a_c), with a_c = a + α × c + ω × (ω × c).
    /// The torque about the sensor's origin is c × F − (I α + ω × I ω).
    pub fn wrench(&self, motion: &SensorMotion) -> Wrench {
        let &SensorMotion { base_from_sensor, angular_velocity, angular_acceleration, acceleration } = motion;
        let gravity = base_from_sensor.inverse() * Vector3::new(0.0, 0.0, -GRAVITY);
        let of_centre = acceleration
            + angular_acceleration.cross(&self.centre)
            + angular_velocity.cross(&angular_velocity.cross(&self.centre));
        let force = self.mass * (gravity - of_centre);
        let spin = self.inertia * angular_acceleration + angular_velocity.cross(&(self.inertia * angular_velocity));
        Wrench { force, torque: self.centre.cross(&force) - spin }
    }

    /// The contact wrench on the tool, in the frame of the sensor.
    ///
    /// `measured`: wrench of the sensor relative to its zero. `zeroed_at`: motion of the sensor at the zeroing, usually
    /// at rest. The tool must have had no contact then. `None` if the sensor was not zeroed, or was zeroed without the
    /// load.
    pub fn contact(&self, measured: &Wrench, motion: &SensorMotion, zeroed_at: Option<&SensorMotion>) -> Wrench {
        let zero = zeroed_at.map_or_else(Wrench::default, |zeroed_at| self.wrench(zeroed_at));
        *measured + zero - self.wrench(motion)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::Translation3;

    use super::*;
    use crate::random::Random;

    fn vector(random: &mut Random, most: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| random.within(-most, most))
    }

    fn rotation(random: &mut Random) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(vector(random, 3.0))
    }

    fn wrench(random: &mut Random) -> Wrench {
        Wrench { force: vector(random, 100.0), torque: vector(random, 10.0) }
    }

    fn close(a: &Wrench, b: &Wrench) -> bool {
        let difference = *a - *b;
        difference.force.amax() < 1e-9 && difference.torque.amax() < 1e-9
    }

    /// A load of four point masses, and each mass, kg, with its position, m, in the frame of the sensor.
    fn points(random: &mut Random) -> (Load, [(f64, Vector3<f64>); 4]) {
        let points: [(f64, Vector3<f64>); 4] = std::array::from_fn(|_| (random.within(0.1, 2.0), vector(random, 0.3)));
        let mass: f64 = points.iter().map(|(mass, _)| mass).sum();
        let centre = points.iter().map(|(mass, at)| *mass * at).sum::<Vector3<f64>>() / mass;
        let about = |(mass, at): &(f64, Vector3<f64>)| {
            let arm = at - centre;
            *mass * (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose())
        };
        let inertia = points.iter().map(about).sum();
        (Load::new(mass, centre, inertia).unwrap(), points)
    }

    #[test]
    fn two_joined_loads_weigh_and_resist_as_both_together() {
        let mut random = Random(5);
        let body = |random: &mut Random| {
            let moments = Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.04));
            Load::new(random.within(0.1, 3.0), vector(random, 0.2), moments).unwrap()
        };
        for _ in 0..100 {
            let (one, other) = (body(&mut random), body(&mut random));
            let motion = SensorMotion {
                base_from_sensor: UnitQuaternion::from_scaled_axis(vector(&mut random, 2.0)),
                angular_velocity: vector(&mut random, 3.0),
                angular_acceleration: vector(&mut random, 20.0),
                acceleration: vector(&mut random, 10.0),
            };
            let off = one.carrying(&other).wrench(&motion) - (one.wrench(&motion) + other.wrench(&motion));
            assert!(off.force.amax() < 1e-9 && off.torque.amax() < 1e-9, "{one:?} {other:?}: {off:?}");
        }
    }

    #[test]
    fn a_wrench_moves_to_another_frame_as_calculated_by_hand() {
        let push = Wrench::from_components([10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        // The sensor's origin is at y = 0.2 m of the other frame, with the same axes: -0.2 m · 10 N about z.
        let beside = Isometry3::from_parts(Translation3::new(0.0, 0.2, 0.0), UnitQuaternion::identity());
        assert!(close(&push.seen_from(&beside), &Wrench::from_components([10.0, 0.0, 0.0, 0.0, 0.0, -2.0])));
        // Turned by 90° about z, x of the sensor is y of the other frame.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
        let turned = Isometry3::from_parts(Translation3::new(0.3, 0.0, 0.0), turn);
        assert!(close(&push.seen_from(&turned), &Wrench::from_components([0.0, 10.0, 0.0, 0.0, 0.0, 3.0])));
        // A pure torque is the same about every point.
        let twist = Wrench::from_components([0.0, 0.0, 0.0, 0.0, 0.0, 4.0]);
        assert!(close(&twist.seen_from(&turned), &twist));
    }

    #[test]
    fn a_wrench_returns_from_any_frame_and_its_power_is_the_same_there() {
        let mut random = Random(14);
        for _ in 0..1_000 {
            let here = wrench(&mut random);
            let to_from_here = Isometry3::from_parts(vector(&mut random, 2.0).into(), rotation(&mut random));
            let there = here.seen_from(&to_from_here);
            assert!(close(&there.seen_from(&to_from_here.inverse()), &here));
            assert_eq!(Wrench::from_components(here.components()), here);
            // The twist of a body about the origin of each frame.
            let (spin, velocity) = (vector(&mut random, 3.0), vector(&mut random, 3.0));
            let spin_there = to_from_here.rotation * spin;
            let origin = to_from_here.translation.vector;
            let velocity_there = to_from_here.rotation * velocity - spin_there.cross(&origin);
            let power = here.force.dot(&velocity) + here.torque.dot(&spin);
            let power_there = there.force.dot(&velocity_there) + there.torque.dot(&spin_there);
            assert!((power - power_there).abs() < 1e-8 * (1.0 + power.abs()));
        }
    }

    #[test]
    fn weight_at_rest_is_as_calculated_by_hand() {
        // The gripper of the IRp-6: 10.8 N, 0.156 m from the sensor.
        let load = Load::of_weight(10.8 / GRAVITY, Vector3::new(0.0, 0.0, 0.156)).unwrap();
        let table = [
            // The sensor points upward, downward, and along x of the base.
            (UnitQuaternion::identity(), [0.0, 0.0, -10.8, 0.0, 0.0, 0.0]),
            (UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 2.0 * FRAC_PI_2), [0.0, 0.0, 10.8, 0.0, 0.0, 0.0]),
            (UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2), [10.8, 0.0, 0.0, 0.0, 10.8 * 0.156, 0.0]),
        ];
        for (orientation, expected) in table {
            let found = load.wrench(&SensorMotion::at_rest(orientation));
            assert!(close(&found, &Wrench::from_components(expected)), "{found:?}");
        }
    }

    #[test]
    fn inertia_in_motion_is_as_calculated_by_hand() {
        let inertia = Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.04));
        let load = Load::new(2.0, Vector3::new(0.1, 0.0, 0.0), inertia).unwrap();
        let weight = Wrench::from_components([0.0, 0.0, -2.0 * GRAVITY, 0.0, 0.1 * 2.0 * GRAVITY, 0.0]);
        let rest = SensorMotion::at_rest(UnitQuaternion::identity());
        let table: [(SensorMotion, [f64; 6]); 4] = [
            // Acceleration along y: -m a, and 0.1 m · -6 N about z.
            (SensorMotion { acceleration: Vector3::new(0.0, 3.0, 0.0), ..rest }, [0.0, -6.0, 0.0, 0.0, 0.0, -0.6]),
            // Angular acceleration about z: the centre accelerates by 0.5 m/s² along y; (I + m c²) α about z.
            (
                SensorMotion { angular_acceleration: Vector3::new(0.0, 0.0, 5.0), ..rest },
                [0.0, -1.0, 0.0, 0.0, 0.0, -(0.04 + 2.0 * 0.01) * 5.0],
            ),
            // Rotation about z: the centre accelerates by ω² c toward the axis.
            (
                SensorMotion { angular_velocity: Vector3::new(0.0, 0.0, 4.0), ..rest },
                [2.0 * 16.0 * 0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            ),
            // Rotation about y and z: a_c = ω (ω·c) - ω² c = -0.2 m/s² per (rad/s)²; ω × I ω = (ω_y ω_z (I_z - I_y), 0,
            // 0).
            (
                SensorMotion { angular_velocity: Vector3::new(0.0, 3.0, 4.0), ..rest },
                [2.0 * 25.0 * 0.1, 0.0, 0.0, -3.0 * 4.0 * 0.01, 0.0, 0.0],
            ),
        ];
        for (motion, expected) in table {
            let found = load.wrench(&motion) - weight;
            assert!(close(&found, &Wrench::from_components(expected)), "{found:?} {expected:?}");
        }
    }

    #[test]
    fn a_body_puts_the_same_wrench_on_the_sensor_as_its_points() {
        let mut random = Random(15);
        for _ in 0..1_000 {
            let (load, points) = points(&mut random);
            let motion = SensorMotion {
                base_from_sensor: rotation(&mut random),
                angular_velocity: vector(&mut random, 5.0),
                angular_acceleration: vector(&mut random, 20.0),
                acceleration: vector(&mut random, 10.0),
            };
            let of_point = |(mass, at): &(f64, Vector3<f64>)| {
                let spin = motion.angular_velocity;
                let of_point =
                    motion.acceleration + motion.angular_acceleration.cross(at) + spin.cross(&spin.cross(at));
                let gravity = motion.base_from_sensor.inverse() * Vector3::new(0.0, 0.0, -GRAVITY);
                let force = *mass * (gravity - of_point);
                Wrench { force, torque: at.cross(&force) }
            };
            let sum = points.iter().map(of_point).fold(Wrench::default(), |sum, wrench| sum + wrench);
            assert!(close(&load.wrench(&motion), &sum));
        }
    }

    #[test]
    fn the_contact_is_what_the_sensor_measures_without_the_load() {
        let mut random = Random(16);
        for _ in 0..1_000 {
            let (load, _) = points(&mut random);
            let contact = wrench(&mut random);
            let zeroed_at = SensorMotion::at_rest(rotation(&mut random));
            let motion = SensorMotion {
                angular_velocity: vector(&mut random, 5.0),
                acceleration: vector(&mut random, 10.0),
                ..SensorMotion::at_rest(rotation(&mut random))
            };
            let raw = contact + load.wrench(&motion);
            assert!(close(&load.contact(&raw, &motion, None), &contact));
            // The zero contains the weight of the load in the pose of the zeroing.
            let zeroed = raw - load.wrench(&zeroed_at);
            assert!(close(&load.contact(&zeroed, &motion, Some(&zeroed_at)), &contact));
        }
    }

    #[test]
    fn what_is_no_body_is_refused() {
        let (centre, none) = (Vector3::zeros(), Matrix3::zeros());
        let diagonal = |x, y, z| Matrix3::from_diagonal(&Vector3::new(x, y, z));
        assert_eq!(Load::new(-1.0, centre, none), Err(LoadError::Mass { mass: -1.0 }));
        assert!(matches!(Load::new(f64::NAN, centre, none), Err(LoadError::Mass { .. })));
        let far = Vector3::new(0.0, f64::INFINITY, 0.0);
        assert_eq!(Load::new(1.0, far, none), Err(LoadError::Centre { coordinate: f64::INFINITY }));
        let skewed = Matrix3::new(1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        for inertia in [diagonal(1.0, 1.0, 2.1), diagonal(-1.0, 1.0, 1.0), diagonal(f64::NAN, 1.0, 1.0), skewed] {
            assert_eq!(Load::new(1.0, centre, inertia), Err(LoadError::Inertia), "{inertia}");
        }
        // A flat body has one moment that is the sum of the others.
        assert!(Load::new(1.0, centre, diagonal(1.0, 1.0, 2.0)).is_ok());
        assert!(Load::new(0.0, centre, none).is_ok());
    }
}
