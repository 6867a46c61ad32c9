//! Chains against a second computation: poses of the links as products of isometries, all derivatives by differences.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::super::{ChainBodies, ChainBodyJoint, Mechanism, MechanismConfig};
use super::{G, check, polycrank, posed};
use crate::plant::Noise;

pub(super) const STRAIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// The numbers of a chain, as a description has them.
#[derive(Clone, Debug)]
pub(super) struct Arm {
    pub(super) joints: Vec<ChainBodyJoint>,
    pub(super) flange: ([f64; 3], [f64; 4]),
    pub(super) up: [f64; 3],
    /// Joints from motors.
    pub(super) rows: Vec<Vec<f64>>,
    pub(super) rotors: Vec<f64>,
    /// Mass, kg, and centre, m, in the frame of the flange.
    pub(super) payload: (f64, [f64; 3]),
}

/// A revolute joint with its axis along z.
pub(super) const HINGE: ChainBodyJoint = ChainBodyJoint {
    translation: [0.0; 3],
    rotation: STRAIGHT,
    axis: [0.0, 0.0, 1.0],
    prismatic: false,
    mass: 0.0,
    centre: [0.0; 3],
    inertia: [0.0; 6],
    at_home: 0.0,
};

/// Mass, frame, centre, and inertia about the centre in the axes of the frame.
type Body = (f64, Isometry3<f64>, Vector3<f64>, Matrix3<f64>);

/// Half of the interval of a difference, rad.
const STEP: f64 = 1e-4;

impl Arm {
    /// An arm whose motors turn the joints directly, with `up` along y.
    pub(super) fn direct(joints: Vec<ChainBodyJoint>, rotor: f64) -> Self {
        let count = joints.len();
        Self {
            joints,
            flange: ([0.0; 3], STRAIGHT),
            up: [0.0, 1.0, 0.0],
            rows: diagonal(&vec![1.0; count]),
            rotors: vec![rotor; count],
            payload: (0.0, [0.0; 3]),
        }
    }

    /// A random arm. `ratio` is the order of the ratios of motor angle to joint position.
    pub(super) fn random(count: usize, ratio: f64, noise: &mut Noise) -> Self {
        let joints: Vec<ChainBodyJoint> = (0..count).map(|_| random_joint(noise)).collect();
        let mut rows = diagonal(&vec![0.0; count]);
        for (row, (numbers, joint)) in rows.iter_mut().zip(&joints).enumerate() {
            for (column, number) in numbers.iter_mut().enumerate().take(row + 1) {
                let share = if row == column { 1.0 + 0.3 * noise.symmetric() } else { 0.3 * noise.symmetric() };
                *number = share * if joint.prismatic { 0.3 } else { 1.0 } / ratio;
            }
        }
        Self {
            joints,
            flange: (vector(0.2, noise), random_rotation(noise)),
            up: vector(1.0, noise),
            rows,
            rotors: (0..count).map(|_| (0.1 + 0.05 * noise.symmetric()) / (ratio * ratio)).collect(),
            payload: (1.5, vector(0.1, noise)),
        }
    }

    pub(super) fn axes(&self) -> usize {
        self.joints.len()
    }

    pub(super) fn config(&self) -> MechanismConfig {
        let bodies = ChainBodies::new(&self.joints, self.flange, self.up, &self.rows, &self.rotors);
        MechanismConfig::Chain(Arc::new(bodies.expect("the numbers of an arm")))
    }

    /// The mechanism with its motors at these angles from home.
    pub(super) fn posed(&self, motors: &[f64]) -> Mechanism {
        let mechanism = posed(&self.config(), motors);
        mechanism.set_payload(self.payload.0, self.payload.1);
        mechanism
    }

    /// Frames of the links, and last of the flange.
    pub(super) fn places(&self, motors: &[f64]) -> Vec<Isometry3<f64>> {
        let mut place = Isometry3::identity();
        let mut places = Vec::new();
        for (joint, row) in self.joints.iter().zip(&self.rows) {
            let position: f64 = joint.at_home + row.iter().zip(motors).map(|(it, motor)| it * motor).sum::<f64>();
            let axis = Vector3::from(joint.axis).normalize() * position;
            place *= isometry(joint.translation, joint.rotation);
            place *= if joint.prismatic {
                Isometry3::from_parts(Translation3::from(axis), UnitQuaternion::identity())
            } else {
                Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_scaled_axis(axis))
            };
            places.push(place);
        }
        places.push(place * isometry(self.flange.0, self.flange.1));
        places
    }

    fn bodies(&self, motors: &[f64]) -> Vec<Body> {
        let places = self.places(motors);
        let links = self.joints.iter().zip(&places).map(|(joint, place)| {
            let [xx, yy, zz, xy, xz, yz] = joint.inertia;
            let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
            (joint.mass, *place, place * nalgebra::Point3::from(joint.centre), inertia)
        });
        let flange = places[self.axes()];
        let payload = (self.payload.0, flange, flange * nalgebra::Point3::from(self.payload.1), Matrix3::zeros());
        links.chain([payload]).map(|(mass, place, centre, inertia)| (mass, place, centre.coords, inertia)).collect()
    }

    /// Potential energy, J.
    pub(super) fn potential(&self, motors: &[f64]) -> f64 {
        let up = Vector3::from(self.up).normalize();
        self.bodies(motors).iter().map(|(mass, _, centre, _)| G * mass * up.dot(centre)).sum()
    }

    /// Matrix of the kinetic energy, at the motors.
    pub(super) fn inertia(&self, motors: &[f64]) -> DMatrix<f64> {
        let count = self.axes();
        let here = self.bodies(motors);
        let moved: Vec<_> =
            (0..count).map(|motor| [-STEP, STEP].map(|by| self.bodies(&shifted(motors, motor, by)))).collect();
        let mut inertia = DMatrix::from_diagonal(&DVector::from_row_slice(&self.rotors));
        for (number, (mass, place, _, tensor)) in here.iter().enumerate() {
            let motion: Vec<_> = moved
                .iter()
                .map(|[low, high]| {
                    let turn = high[number].1.rotation * low[number].1.rotation.inverse();
                    let spin = place.rotation.inverse() * turn.scaled_axis() / (2.0 * STEP);
                    ((high[number].2 - low[number].2) / (2.0 * STEP), spin)
                })
                .collect();
            for row in 0..count {
                for column in 0..count {
                    inertia[(row, column)] +=
                        mass * motion[row].0.dot(&motion[column].0) + motion[row].1.dot(&(tensor * motion[column].1));
                }
            }
        }
        inertia
    }

    /// Torques of the weight and of the velocities, by Lagrange's equation.
    pub(super) fn torques(&self, motors: &[f64], rates: &[f64]) -> DVector<f64> {
        let rate = DVector::from_row_slice(rates);
        let slope = |motor: usize| {
            let [low, high] = [-STEP, STEP].map(|by| shifted(motors, motor, by));
            let weight = (self.potential(&high) - self.potential(&low)) / (2.0 * STEP);
            (weight, (self.inertia(&high) - self.inertia(&low)) / (2.0 * STEP))
        };
        let slopes: Vec<_> = (0..self.axes()).map(slope).collect();
        let change: DMatrix<f64> = slopes.iter().zip(rates).map(|((_, slope), rate)| slope * *rate).sum();
        let torque = |(weight, slope): &(f64, DMatrix<f64>)| 0.5 * rate.dot(&(slope * &rate)) - weight;
        DVector::from_iterator(self.axes(), slopes.iter().map(torque)) - change * rate
    }
}

pub(in super::super) fn random_chain(joints: usize, ratio: f64, noise: &mut Noise) -> MechanismConfig {
    Arm::random(joints, ratio, noise).config()
}

pub(super) fn vector(size: f64, noise: &mut Noise) -> [f64; 3] {
    [0; 3].map(|_: u8| size * noise.symmetric())
}

fn random_rotation(noise: &mut Noise) -> [f64; 4] {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(vector(PI, noise)));
    [turn.w, turn.i, turn.j, turn.k]
}

fn random_joint(noise: &mut Noise) -> ChainBodyJoint {
    // The tensor of a box in any orientation.
    let mass = 2.0 + 1.5 * noise.symmetric();
    let [a, b, c] = vector(0.2, noise).map(|it| it * it);
    let moments = Matrix3::from_diagonal(&Vector3::new(b + c, a + c, a + b)) * mass;
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(vector(PI, noise))).to_rotation_matrix();
    let tensor = turn.matrix() * moments * turn.matrix().transpose();
    let at = |row, column| tensor[(row, column)];
    ChainBodyJoint {
        translation: vector(0.4, noise),
        rotation: random_rotation(noise),
        axis: vector(1.0, noise),
        prismatic: noise.symmetric() > 0.5,
        mass,
        centre: vector(0.3, noise),
        inertia: [at(0, 0), at(1, 1), at(2, 2), at(0, 1), at(0, 2), at(1, 2)],
        at_home: 0.2 * noise.symmetric(),
    }
}

fn isometry(translation: [f64; 3], [w, x, y, z]: [f64; 4]) -> Isometry3<f64> {
    let turn = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(translation), turn)
}

pub(super) fn diagonal(numbers: &[f64]) -> Vec<Vec<f64>> {
    let row = |row| (0..numbers.len()).map(|column| if row == column { numbers[row] } else { 0.0 }).collect();
    (0..numbers.len()).map(row).collect()
}

fn shifted(motors: &[f64], motor: usize, by: f64) -> Vec<f64> {
    let mut motors = motors.to_vec();
    motors[motor] += by;
    motors
}

#[test]
fn random_chains_weigh_and_resist_as_their_energies_say() {
    let mut noise = Noise::new(21);
    for count in (1..=8).cycle().take(100) {
        let arm = Arm::random(count, 1.0, &mut noise);
        let motors: Vec<f64> = (0..count).map(|_| 2.0 * noise.symmetric()).collect();
        let mechanism = arm.posed(&motors);
        let inertia = arm.inertia(&motors);
        let torques = arm.torques(&motors, &vec![0.0; count]);
        for number in 0..count {
            let load = mechanism.load(number);
            let near = |found: f64, expected: f64| (found - expected).abs() < 1e-6 * (1.0 + expected.abs());
            assert!(near(load.torque, torques[number]), "{arm:?} {number}: {} {} N·m", load.torque, torques[number]);
            let expected = inertia[(number, number)];
            assert!(near(load.inertia, expected), "{arm:?} {number}: {} {expected} kg·m²", load.inertia);
        }
        let (kinematics, _) = mechanism.kinematics();
        let flange = arm.places(&motors)[count];
        assert!((kinematics.flange.origin - flange.translation.vector).norm() < 1e-12, "{arm:?}");
        assert!((kinematics.flange.axes - flange.rotation.to_rotation_matrix().matrix()).norm() < 1e-12, "{arm:?}");
    }
}

/// Polycrank by Denavit and Hartenberg: d, a, quarter turns about x, and mass of a rod from joint to joint.
const CRANKS: [(f64, f64, f64, f64); 7] = [
    (0.220, -0.299, 0.0, 12.0),
    (0.152, 0.180, 0.0, 9.0),
    (0.335, 0.0, 1.0, 7.0),
    (0.120, 0.151, 0.0, 4.0),
    (0.116, 0.151, 0.0, 3.5),
    (0.060, 0.0, 1.0, 1.5),
    (0.043, 0.0, 0.0, 0.6),
];

#[test]
fn polycrank_as_a_chain_moves_and_weighs_like_polycrank() {
    let mut noise = Noise::new(22);
    let mut previous = ([0.0; 3], STRAIGHT);
    let mut joints = Vec::new();
    for (d, a, quarters, mass) in CRANKS {
        let (translation, rotation) = previous;
        let [xx, zz, xz] = [d * d, a * a, -a * d].map(|it| it * mass / 12.0);
        let inertia = [xx, xx + zz, zz, 0.0, xz, 0.0];
        joints.push(ChainBodyJoint { translation, rotation, mass, centre: [a / 2.0, 0.0, d / 2.0], inertia, ..HINGE });
        let half = FRAC_PI_2 * quarters / 2.0;
        previous = ([a, 0.0, d], [half.cos(), half.sin(), 0.0, 0.0]);
    }
    let mut arm = Arm {
        joints,
        flange: previous,
        up: [1.0, 0.0, 0.0],
        rows: diagonal(&[1.0 / 50.0; 7]),
        rotors: vec![1e-4; 7],
        payload: (3.0, [0.02, -0.03, 0.1]),
    };
    for coupled in [false, true] {
        if coupled {
            // Motors 1 to 3 and 4 to 6 set sums of joint angles.
            for joint in [1, 2, 4, 5] {
                arm.rows[joint][joint - 1] = -1.0 / 50.0;
            }
        }
        for _ in 0..50 {
            let motors: Vec<f64> = (0..7).map(|_| 100.0 * noise.symmetric()).collect();
            let (chain, cranks) = (arm.posed(&motors), posed(&polycrank(coupled), &motors));
            cranks.set_payload(arm.payload.0, arm.payload.1);
            for number in 0..7 {
                check(chain.load(number).torque, cranks.load(number).torque, "torque");
                check(chain.load(number).inertia, cranks.load(number).inertia, "inertia");
            }
            let (found, expected) = (chain.kinematics().0, cranks.kinematics().0);
            assert!((found.flange.origin - expected.flange.origin).norm() < 1e-12, "{motors:?}");
            assert!((found.flange.axes - expected.flange.axes).norm() < 1e-12, "{motors:?}");
            for (found, expected) in found.motors.iter().zip(&expected.motors) {
                assert!((found.velocity - expected.velocity).norm() < 1e-14, "{motors:?}");
                assert!((found.spin - expected.spin).norm() < 1e-14, "{motors:?}");
            }
        }
    }
}

#[test]
fn links_without_mass_weigh_nothing_and_carry_a_payload() {
    let hinge = ChainBodyJoint { translation: [0.5, 0.0, 0.0], ..HINGE };
    let arm = Arm { flange: ([0.5, 0.0, 0.0], STRAIGHT), ..Arm::direct(vec![HINGE, hinge], 0.01) };
    let mechanism = arm.posed(&[0.0; 2]);
    for number in 0..2 {
        assert_eq!((mechanism.load(number).torque, mechanism.load(number).inertia), (0.0, 0.01));
    }
    mechanism.set_payload(2.0, [0.0; 3]);
    for (number, arm) in [1.0, 0.5].into_iter().enumerate() {
        check(mechanism.load(number).torque, -2.0 * G * arm, "torque");
        check(mechanism.load(number).inertia, 0.01 + 2.0 * arm * arm, "inertia");
    }
}

#[test]
fn a_lift_carries_its_mass_and_a_level_slide_only_moves_it() {
    for (up, torque) in [([0.0, 0.0, 2.0], -3.0 * G * 0.01), ([5.0, 0.0, 0.0], 0.0), ([0.0, 0.0, -0.1], 3.0 * G * 0.01)]
    {
        let lift = ChainBodyJoint { prismatic: true, mass: 3.0, centre: [0.1, 0.2, 0.3], ..HINGE };
        let arm = Arm { up, rows: vec![vec![0.01]], ..Arm::direct(vec![lift], 1e-4) };
        let mechanism = arm.posed(&[20.0]);
        check(mechanism.load(0).torque, torque, "torque");
        check(mechanism.load(0).inertia, 1e-4 + 3.0 * 1e-4, "inertia");
        assert!((mechanism.kinematics().0.flange.origin - Vector3::new(0.0, 0.0, 0.2)).norm() < 1e-15);
        assert!((Vector3::from(mechanism.up()) - Vector3::from(up).normalize()).norm() < 1e-15);
    }
}
