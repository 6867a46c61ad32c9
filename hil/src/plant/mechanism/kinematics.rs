//! Pose and motion of the flange of a mechanism, and the motor torques that a wrench on the flange causes.

use nalgebra::{Matrix3, Vector3};

use super::AXES;
use super::chain::Vector;

/// A frame in the base frame of its mechanism.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    /// Axes of the frame, as columns.
    pub(crate) axes: Matrix3<f64>,
    /// Origin, m.
    pub(crate) origin: Vector,
}

impl Frame {
    /// The base frame itself.
    pub(super) const BASE: Self =
        Self { axes: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), origin: Vector::new(0.0, 0.0, 0.0) };
}

/// Motion of a frame: velocity of its origin, m/s, and angular velocity, rad/s. A column of a Jacobian is the motion
/// per rad/s of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Twist {
    pub(crate) velocity: Vector,
    pub(crate) spin: Vector,
}

impl Twist {
    /// Motion of the frame while the joints turn at `rates`, rad/s.
    pub(super) fn sum<const N: usize>(joints: &[Self; N], rates: &[f64; N]) -> Self {
        let mut sum = Self::default();
        // Most motors turn one or two joints.
        for (joint, &rate) in joints.iter().zip(rates).filter(|(_, rate)| **rate != 0.0) {
            sum.velocity += joint.velocity * rate;
            sum.spin += joint.spin * rate;
        }
        sum
    }
}

/// The motor shafts of a mechanism at one instant. Absent motors stand at zero.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shafts {
    /// Angles, rad.
    pub(crate) angles: [f64; AXES],
    /// Velocities, rad/s.
    pub(crate) velocities: [f64; AXES],
}

impl Shafts {
    /// Number of shafts.
    pub(crate) const COUNT: usize = AXES;
}

/// The flange of a mechanism in one pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kinematics {
    /// The flange frame of [`Mechanism::set_payload`](super::Mechanism::set_payload).
    pub(crate) flange: Frame,
    /// Motion of the flange per rad/s of each motor; zero for absent motors.
    pub(crate) motors: [Twist; AXES],
    /// Displacement of a point of the tool from this pose, m, for which the bound of
    /// [`Mechanism::travel`](super::Mechanism::travel) holds.
    pub(crate) room: f64,
}

impl Kinematics {
    /// Motion of the flange while the motors turn at these velocities, rad/s.
    pub(crate) fn twist(&self, velocities: &[f64; AXES]) -> Twist {
        Twist::sum(&self.motors, velocities)
    }

    /// Torque on each motor, N·m, caused by a force, N, at the origin of the flange and a torque, N·m, both in the base
    /// frame. The transpose of the Jacobian gives these torques: wrench and motor torques do the same work.
    pub(crate) fn torques(&self, force: &Vector3<f64>, torque: &Vector3<f64>) -> [f64; AXES] {
        self.motors.map(|motor| motor.velocity.dot(force) + motor.spin.dot(torque))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::Vector3;

    use super::super::tests::chains::random_chain;
    use super::super::{Mechanism, MechanismConfig};
    use super::Kinematics;
    use crate::plant::{AxisConfig, Noise};

    /// The robots of the laboratory, and chains of one to eight joints.
    fn robots() -> Vec<MechanismConfig> {
        let mut robots = vec![
            MechanismConfig::Irb6,
            MechanismConfig::Irp6,
            MechanismConfig::Irp6OnTrack,
            MechanismConfig::Rnt { home_lengths: [AxisConfig::RNT_HOME_LENGTH; 3] },
            MechanismConfig::Polycrank { coupled: false, at_home: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7] },
            MechanismConfig::Polycrank { coupled: true, at_home: [0.0; 7] },
        ];
        let mut noise = Noise::new(9);
        robots.extend((1..=8).map(|joints| random_chain(joints, 100.0, &mut noise)));
        robots
    }

    /// A mechanism with its motors at these angles from home.
    fn at(config: &MechanismConfig, motors: &[f64]) -> (Mechanism, Kinematics) {
        let mechanism = Mechanism::new(config.clone());
        for (number, &motor) in motors.iter().enumerate() {
            mechanism.mount(number, 50.0).expect("it has the axis").place(50.0 + motor);
        }
        let (kinematics, _) = mechanism.kinematics();
        (mechanism, kinematics)
    }

    /// Random motor angles within the range of every mechanism.
    fn pose(config: &MechanismConfig, noise: &mut Noise) -> Vec<f64> {
        let together = 100.0 * noise.symmetric();
        let angle = |number: usize| match config {
            MechanismConfig::Rnt { .. } if number < 3 => 100.0 + together + 20.0 * noise.symmetric(),
            _ => 80.0 * noise.symmetric(),
        };
        (0..Mechanism::new(config.clone()).axes()).map(angle).collect()
    }

    #[test]
    fn flange_moves_as_the_jacobian_says() {
        let mut noise = Noise::new(5);
        for config in &robots() {
            for _ in 0..50 {
                let motors = pose(config, &mut noise);
                let (_, here) = at(config, &motors);
                for number in 0..motors.len() {
                    let moved = |by: f64| {
                        let mut motors = motors.clone();
                        motors[number] += by;
                        at(config, &motors).1.flange
                    };
                    let (low, high) = (moved(-1e-3), moved(1e-3));
                    let velocity = (high.origin - low.origin) / 2e-3;
                    let turn = high.axes * low.axes.transpose();
                    let turn = 0.5 * (turn - turn.transpose());
                    let spin = Vector3::new(turn[(2, 1)], turn[(0, 2)], turn[(1, 0)]) / 2e-3;
                    let twist = here.motors[number];
                    assert!((twist.velocity - velocity).norm() < 1e-9, "{config:?} {number}: {twist:?} {velocity}");
                    assert!((twist.spin - spin).norm() < 1e-9, "{config:?} {number}: {twist:?} {spin}");
                }
            }
        }
    }

    #[test]
    fn no_point_of_a_tool_moves_farther_than_the_travel_of_the_motors() {
        let mut noise = Noise::new(7);
        for config in &robots() {
            let distance = 0.4;
            let travel = Mechanism::new(config.clone()).travel(distance);
            // The farthest motion of each motor, as a share of its travel.
            let mut most = vec![0.0_f64; Mechanism::new(config.clone()).axes()];
            for _ in 0..500 {
                let from = pose(config, &mut noise);
                let point =
                    Vector3::new(noise.symmetric(), noise.symmetric(), noise.symmetric()).normalize() * distance;
                let place = |motors: &[f64]| {
                    let flange = at(config, motors).1.flange;
                    flange.origin + flange.axes * point
                };
                let start = place(&from);
                let room = at(config, &from).1.room;
                for size in [1e-3, 1.0, 100.0] {
                    let step: Vec<_> = from.iter().map(|_| size * noise.symmetric()).collect();
                    let to: Vec<_> = from.iter().zip(&step).map(|(from, step)| from + step).collect();
                    let bound: f64 = step.iter().zip(travel).map(|(step, travel)| step.abs() * travel).sum();
                    let moved = (place(&to) - start).norm();
                    assert!(
                        moved <= bound || bound > room,
                        "{config:?}: {moved} m of {bound} m from {from:?} to {to:?}"
                    );
                }
                for (number, most) in most.iter_mut().enumerate() {
                    let mut to = from.clone();
                    to[number] += 1e-3;
                    *most = most.max((place(&to) - start).norm() / (1e-3 * travel[number]));
                }
            }
            // A bound that is far too great would have no effect in a scene. Screws are steep only when stretched.
            assert!(most.iter().all(|share| (1e-3..1.0 + 1e-6).contains(share)), "{config:?}: {most:?}");
        }
    }

    /// The dynamics of the links and the Jacobian are computed by different code.
    #[test]
    fn force_of_a_weight_loads_motors_like_a_payload_of_that_weight() {
        let mut noise = Noise::new(6);
        for config in &robots() {
            for _ in 0..50 {
                let motors = pose(config, &mut noise);
                let (mechanism, here) = at(config, &motors);
                let empty: Vec<_> = (0..motors.len()).map(|axis| mechanism.load(axis).torque).collect();
                let centre = Vector3::new(0.1, -0.2, 0.3);
                mechanism.set_payload(3.0, centre.into());
                let force = -3.0 * 9.81 * Vector3::from(mechanism.up());
                let torque = (here.flange.axes * centre).cross(&force);
                let torques = here.torques(&force, &torque);
                for (axis, empty) in empty.iter().enumerate() {
                    let payload = mechanism.load(axis).torque - empty;
                    assert!((payload - torques[axis]).abs() < 1e-9, "{config:?} {axis}: {} {payload}", torques[axis]);
                }
            }
        }
    }

    #[test]
    fn mass_at_the_tip_is_that_of_the_motors_that_move_it() {
        let (mechanism, _) = at(&MechanismConfig::Irb6, &[0.0; 5]);
        // Sideways: the column alone, at 0.67 + 0.095 + 0.2 m, and the roll, on whose axis the point lies.
        let column = mechanism.load(0).inertia * 158.0 * 158.0 / (0.965 * 0.965);
        let found = mechanism.effective_mass([0.0, 0.0, 0.2], [0.0, 2.0, 0.0]);
        assert!((found - column).abs() < 1e-9 * column, "{found} for {column} kg");
        // Upwards: upper arm at 0.67 m behind its screw, and pitch at 0.295 m.
        let upper = mechanism.load(2).inertia * 175.126 * 175.126 / (0.67 * 0.67);
        let pitch = mechanism.load(3).inertia * 128.0 * 128.0 / (0.295 * 0.295);
        let both = 1.0 / (1.0 / upper + 1.0 / pitch);
        let found = mechanism.effective_mass([0.0, 0.0, 0.2], [0.0, 0.0, 1.0]);
        assert!((found - both).abs() < 1e-4 * both, "{found} for {both} kg");
    }

    #[test]
    fn mass_at_the_tip_is_that_of_the_present_pose_also_without_a_scene() {
        let moved = [40.0, 10.0, -20.0, 30.0, 0.0];
        let (placed, _) = at(&MechanismConfig::Irb6, &moved);
        let (driven, _) = at(&MechanismConfig::Irb6, &[0.0; 5]);
        for (number, motor) in moved.into_iter().enumerate() {
            driven.mount(number, 50.0).expect("it has the axis").load(50.0 + motor);
        }
        let mass = |mechanism: &Mechanism| mechanism.effective_mass([0.0, 0.0, 0.2], [0.3, 1.0, 0.5]);
        assert!((mass(&driven) - mass(&placed)).abs() < 1e-9, "{} {} kg", mass(&driven), mass(&placed));
    }

    #[test]
    fn irp6_flange_is_where_the_public_code_has_it() {
        let home = [-15.9, -5.0, -8.527, 151.31, 435.25, 791.0];
        let cases = [
            ([-15.9, -5.0, -8.527, 151.31, 435.25 - 76.8 * FRAC_PI_2, 791.0], [0.86, 0.0, 0.455]),
            (
                [-63.3, -27.601_462, 3.904_375 - 5.6e-5, 193.448_07, 392.908_07, 964.330_7],
                [0.754_232_820, 0.233_311_552, 0.465_238_581],
            ),
        ];
        for (motors, position) in cases {
            let relative: Vec<_> = motors.iter().zip(home).map(|(motor, home)| motor - home).collect();
            let (_, here) = at(&MechanismConfig::Irp6, &relative);
            assert!((here.flange.origin - Vector3::from(position)).norm() < 1e-6, "{here:?} for {position:?}");
        }
        let relative: Vec<_> = cases[1].0.iter().zip(home).map(|(motor, home)| motor - home).collect();
        let axes = at(&MechanismConfig::Irp6, &relative).1.flange.axes;
        let row = Vector3::new(0.612_201, 0.676_525, -0.409_296);
        assert!((axes.row(0).transpose() - row).norm() < 2e-6, "{axes}");
    }
}
