//! Coupled dynamics of chains: against Lagrange's equation, and energy and momentum of motors that swing freely.

use nalgebra::DVector;

use super::super::coupling::Coupled;
use super::super::serial::SerialChain;
use super::super::{Body, ChainBodyJoint, Mechanism, MechanismConfig};
use super::chains::{Arm, HINGE};
use super::{G, smooth};
use crate::plant::{AxisConfig, Demand, Noise, NominalJoint, PlantAxis, SUB_STEP};

/// A motor without friction, switches and buffers.
pub(super) fn motor() -> AxisConfig {
    let config = AxisConfig::polycrank(0).expect("it has the axis");
    AxisConfig { start_angle: 0.0, ..smooth(config, |motor| motor.end_stops = None) }
}

/// Motors of an arm, which begin at rest at these angles.
pub(super) struct Swing {
    arm: Arm,
    mechanism: Mechanism,
    axes: Vec<PlantAxis>,
}

impl Swing {
    pub(super) fn new(arm: Arm, motors: &[f64]) -> Self {
        let config = arm.config();
        Self::of(arm, config, motors)
    }

    /// The arm with the mechanism `config`, which must describe the same arm.
    pub(super) fn of(arm: Arm, config: MechanismConfig, motors: &[f64]) -> Self {
        let mechanism = Mechanism::new(config);
        mechanism.set_payload(arm.payload.0, arm.payload.1);
        let axes = motors.iter().enumerate().map(|(number, &start_angle)| {
            let mount = mechanism.mount(number, 0.0);
            PlantAxis::mounted(&AxisConfig { start_angle, ..motor() }, 1, mount.as_ref())
        });
        Self { arm, axes: axes.collect(), mechanism }
    }

    /// Advances all axes one after the other.
    fn advance(&mut self, steps: u32) {
        self.axes.iter_mut().for_each(|axis| axis.advance(steps, Demand::Off));
    }

    pub(super) fn motors(&self) -> Vec<f64> {
        self.axes.iter().map(PlantAxis::angle).collect()
    }

    fn velocities(&self) -> DVector<f64> {
        let mut robot = self.mechanism.lock();
        let coupling = robot.links.coupling().expect("coupled motors");
        DVector::from_iterator(self.axes.len(), coupling.velocities.iter().copied().take(self.axes.len()))
    }

    fn momenta(&self) -> DVector<f64> {
        self.arm.inertia(&self.motors()) * self.velocities()
    }

    /// Kinetic and potential energy, J.
    fn energies(&self) -> (f64, f64) {
        (0.5 * self.momenta().dot(&self.velocities()), self.arm.potential(&self.motors()))
    }

    /// Greatest kinetic energy, and greatest deviation of the energy from its value at the beginning, J.
    pub(super) fn drift(&mut self, seconds: f64, steps: u32) -> (f64, f64) {
        let start = self.energies();
        let (mut most, mut off) = (0.0_f64, 0.0_f64);
        for k in 0..(seconds / (f64::from(steps) * SUB_STEP)) as u32 {
            self.advance(steps);
            if k.is_multiple_of(400 / steps) {
                let (kinetic, potential) = self.energies();
                most = most.max(kinetic);
                off = off.max((kinetic + potential - start.0 - start.1).abs());
            }
        }
        (most, off)
    }
}

fn rod(mass: f64, length: f64, from: f64) -> ChainBodyJoint {
    let inertia = mass * length * length / 12.0;
    ChainBodyJoint {
        translation: [from, 0.0, 0.0],
        mass,
        centre: [length / 2.0, 0.0, 0.0],
        inertia: [0.0, inertia, inertia, 0.0, 0.0, 0.0],
        ..HINGE
    }
}

#[test]
fn inertia_and_torques_are_those_of_lagrange() {
    let mut noise = Noise::new(31);
    for count in (1..=8).cycle().take(100) {
        let arm = Arm::random(count, 1.0, &mut noise);
        let mut draw = |size: f64| (0..count).map(|_| size * noise.symmetric()).collect::<Vec<f64>>();
        let (motors, rates) = (draw(2.0), draw(3.0));
        let MechanismConfig::Chain(bodies) = arm.config() else { unreachable!("a chain") };
        let mut chain = SerialChain::new(bodies);
        let all = |numbers: &[f64]| std::array::from_fn(|axis| numbers.get(axis).copied().unwrap_or(0.0));
        chain.set_payload(Body::point(arm.payload.0, arm.payload.1), &all(&motors));
        let pose = chain.pose(&chain.joints(&all(&motors)));
        let found = chain.dynamics(&pose);
        let inertia = arm.inertia(&motors);
        let off = (found.inertia.view((0, 0), (count, count)) - &inertia).norm();
        assert!(off < 1e-6 * inertia.norm(), "{arm:?}: {off} kg·m²");
        let impulses = chain.impulses(&pose, &all(&rates).into());
        let torques = found.weight + impulses.column_sum();
        let expected = arm.torques(&motors, &rates);
        let off = (torques.rows(0, count) - &expected).norm();
        assert!(off < 1e-4 * (1.0 + expected.norm()), "{arm:?}: {off} N·m of {expected}");
        // While one motor turns, the momenta of all other motors stay, and so does the kinetic energy.
        let rate = DVector::from_row_slice(&rates);
        for motor in 0..count {
            let [low, high] = [-1e-4, 1e-4].map(|by| {
                let mut motors = motors.clone();
                motors[motor] += by;
                arm.inertia(&motors)
            });
            let slope = (high - low) / 2e-4;
            let mut expected = &slope * &rate * -rates[motor];
            expected[motor] += 0.5 * rate.dot(&(&slope * &rate));
            let off = (impulses.column(motor).rows(0, count) - &expected).norm();
            assert!(off < 1e-4 * (1.0 + expected.norm()), "{arm:?} {motor}: {off} N·m of {expected}");
        }
    }
}

#[test]
fn pendulum_swings_in_its_period_and_two_links_fall_as_their_closed_form_says() {
    // 2 kg at 0.5 m and a rotor of 0.1 kg·m², 0.02 rad beside its rest.
    let bob = ChainBodyJoint { mass: 2.0, centre: [0.5, 0.0, 0.0], ..HINGE };
    let rest = -std::f64::consts::FRAC_PI_2;
    let mut swing = Swing::new(Arm::direct(vec![bob], 0.1), &[rest + 0.02]);
    let period = std::f64::consts::TAU * ((2.0 * 0.25 + 0.1) / (2.0 * G * 0.5)).sqrt();
    let periods = (20.0 * period / SUB_STEP).round() as u32;
    (0..periods).for_each(|_| swing.advance(1));
    assert!((swing.motors()[0] - rest - 0.02).abs() < 2e-5, "{:?}", swing.motors());

    // Two rods of 1 kg and 1 m, level, at rest: (M) a = -(3 g / 2, g / 2) with M of the straight double pendulum.
    let mut swing = Swing::new(Arm::direct(vec![rod(1.0, 1.0, 0.0), rod(1.0, 1.0, 1.0)], 1e-9), &[0.0, 0.0]);
    (0..10).for_each(|_| swing.advance(1));
    let (m11, m12, m22) = (1.0 / 3.0 + 1.0 / 3.0 + 1.0 + 1.0, 1.0 / 3.0 + 0.5, 1.0 / 3.0);
    let (first, second, det) = (-2.0 * G, -0.5 * G, m11 * m22 - m12 * m12);
    let expected = [(m22 * first - m12 * second) / det, (m11 * second - m12 * first) / det];
    for (velocity, expected) in swing.velocities().iter().zip(expected) {
        assert!((velocity - expected * 1e-3).abs() < 1e-5, "{velocity} rad/s for {expected} rad/s² in 1 ms");
    }
}

#[test]
fn double_pendulum_keeps_its_energy_for_ten_seconds() {
    for steps in [1, 10, 20] {
        let rods = vec![rod(1.0, 0.5, 0.0), rod(1.0, 0.5, 0.5)];
        let mut swing = Swing::new(Arm::direct(rods, 0.01), &[1.0, 0.5]);
        let (most, off) = swing.drift(10.0, steps);
        println!("in {steps} sub-steps: {off:.4} J of {most:.2} J");
        assert!(most > 10.0 && off < 0.01 * most, "{off} J of {most} J, in {steps} sub-steps");
    }
}

#[test]
fn random_chains_keep_their_energy_under_gravity_in_any_direction() {
    let mut noise = Noise::new(32);
    let mut worst = 0.0_f64;
    for number in 0..100 {
        let count = 1 + number % 8;
        let ratio = if number % 3 == 0 { 30.0 } else { 1.0 };
        let arm = Arm::random(count, ratio, &mut noise);
        let motors: Vec<f64> = (0..count).map(|_| ratio * noise.symmetric()).collect();
        let text = format!("{arm:?} from {motors:?}");
        let mut swing = Swing::new(arm, &motors);
        let steps = if number % 2 == 0 { 1 } else { 20 };
        let (most, off) = swing.drift(0.3, steps);
        worst = worst.max(off / most);
        assert!(off < 0.05 * most, "{off} J of {most} J in {steps} sub-steps: {text}");
    }
    println!("greatest drift in 0.3 s: {worst:.4} of the kinetic energy");
}

#[test]
fn momentum_about_the_plumb_line_is_conserved() {
    let mut noise = Noise::new(33);
    for _ in 0..10 {
        let mut arm = Arm::random(4, 1.0, &mut noise);
        (arm.joints[0], arm.up) = (HINGE, [0.0, 0.0, 1.0]);
        arm.rows = super::chains::diagonal(&[1.0; 4]);
        arm.joints.iter_mut().for_each(|joint| joint.prismatic = false);
        let mut swing = Swing::new(arm, &[0.3, -0.4, 0.5, 0.1]);
        let (mut most, mut sum) = (0.0_f64, 0.0_f64);
        for _ in 0..100 {
            (0..100).for_each(|_| swing.advance(1));
            let whole = swing.arm.inertia(&swing.motors())[(0, 0)] * swing.velocities()[0];
            most = most.max(whole.abs());
            sum = sum.max(swing.momenta()[0].abs());
        }
        assert!(most > 0.05 && sum < 0.01 * most, "{sum} of {most} N·m·s");
    }
}

/// Two rods of 1 kg and 0.5 m, hanging from 0.4 rad beside their rest.
fn rods() -> (Arm, [f64; 2]) {
    let rods = vec![rod(1.0, 0.5, 0.0), rod(1.0, 0.5, 0.5)];
    (Arm::direct(rods, 0.01), [0.4 - std::f64::consts::FRAC_PI_2, 0.0])
}

#[test]
fn a_held_axis_is_rigid() {
    let (arm, motors) = rods();
    // One rod of 2 kg and 1 m, with the rotor of the first axis.
    let whole = Arm::direct(vec![rod(2.0, 1.0, 0.0)], 0.01);
    for (brake, mounted) in [(100.0, true), (0.0, false)] {
        let mut held = Swing::new(arm.clone(), &motors);
        if mounted {
            let mount = held.mechanism.mount(1, 0.0);
            held.axes[1] = PlantAxis::mounted(&AxisConfig { brake, ..motor() }, 1, mount.as_ref());
        } else {
            held = Swing::new(arm.clone(), &motors[..1]);
        }
        let mut rigid = Swing::new(whole.clone(), &motors[..1]);
        for k in 0..5000 {
            // The brake of the second motor takes the velocity that the first motor has given to it.
            held.axes.iter_mut().for_each(|axis| axis.advance(1, Demand::Off));
            rigid.advance(1);
            let off = held.motors()[0] - rigid.motors()[0];
            assert!(off.abs() < 2e-3, "{off} rad at sub-step {k}, mounted: {mounted}");
        }
        assert!(held.motors().get(1).is_none_or(|second| *second == 0.0), "{:?}", held.motors());
    }
}

#[test]
fn friction_takes_energy_in_whatever_blocks_drives_advance() {
    for steps in [1, 10, 20, 200] {
        let (arm, motors) = rods();
        let mut swing = Swing::new(arm, &motors);
        for (number, axis) in swing.axes.iter_mut().enumerate() {
            let mut config = AxisConfig { start_angle: motors[number], ..motor() };
            let crate::plant::PlantConfig::Physical(rubbed) = &mut config.plant else { unreachable!("it is physical") };
            rubbed.viscous = 0.02;
            rubbed.friction.coulomb = 0.05;
            rubbed.friction.stiction = 0.1;
            let mount = swing.mechanism.mount(number, 0.0);
            *axis = PlantAxis::mounted(&config, 1, mount.as_ref());
        }
        let energy = |swing: &Swing| swing.energies().0 + swing.energies().1;
        let (start, mut last) = (energy(&swing), energy(&swing));
        for k in 0..1000 {
            (0..200 / steps).for_each(|_| swing.advance(steps));
            let now = energy(&swing);
            assert!(now < last + 0.01, "{now} J after {last} J at {k}, blocks of {steps} sub-steps");
            last = now;
        }
        assert!(
            last < start - 0.5 && swing.velocities().norm() < 1e-9,
            "{last} J of {start} J: {}",
            swing.velocities()
        );
    }
}

#[test]
fn payload_is_taken_up_with_the_momentum_of_the_motors() {
    let (arm, motors) = rods();
    let mut swing = Swing::new(arm, &motors);
    (0..2000).for_each(|_| swing.advance(1));
    let before = swing.momenta();
    swing.mechanism.set_payload(2.0, [0.1, 0.0, 0.0]);
    swing.arm.payload = (2.0, [0.1, 0.0, 0.0]);
    let off = (swing.momenta() - &before).norm();
    assert!(before.norm() > 0.1 && off < 1e-6, "{off} of {before}");
}

#[test]
fn a_tip_is_as_heavy_as_the_free_motors_make_it() {
    // Two rods at a right angle: a force along the first rod meets the second rod alone, which turns about its joint
    // while the joint stays where it is in that direction.
    let arm = Arm { flange: ([0.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]), ..rods().0 };
    let quarter = std::f64::consts::FRAC_PI_2;
    let mechanism = arm.posed(&[0.0, quarter]);
    let inertia = arm.inertia(&[0.0, quarter]);
    let (kinematics, _) = mechanism.kinematics();
    for direction in [[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]] {
        let torques = kinematics.torques(&direction.into(), &nalgebra::Vector3::zeros());
        let torques = DVector::from_row_slice(&torques[..2]);
        let mobility = torques.dot(
            &inertia
                .clone()
                .try_inverse()
                .unwrap()
                .column_iter()
                .zip(torques.iter())
                .fold(DVector::zeros(2), |sum, (column, torque)| sum + column * *torque),
        );
        let found = mechanism.effective_mass([0.0; 3], direction);
        assert!((found * mobility - 1.0).abs() < 1e-6, "{found} kg for {} kg", 1.0 / mobility);
    }
}

#[test]
fn a_scene_sees_the_velocities_of_all_shafts() {
    let (arm, motors) = rods();
    let (mut inside, mut outside) = (Swing::new(arm.clone(), &motors), Swing::new(arm, &motors));
    inside.mechanism.enter_scene();
    for _ in 0..3000 {
        inside.advance(1);
        outside.advance(1);
        let shafts = inside.mechanism.shafts();
        let off = (DVector::from_row_slice(&shafts.velocities[..2]) - inside.velocities()).norm();
        assert!(off < 1e-12, "{off} rad/s");
        assert_eq!(shafts.angles[..2], inside.motors()[..2]);
    }
    assert_eq!(inside.motors(), outside.motors());
}

/// A random arm with a nominal motor for each joint.
fn driven(ratio: f64, noise: &mut Noise) -> (Arm, Vec<AxisConfig>) {
    let mut arm = Arm { rows: super::chains::diagonal(&[1.0; 6]), ..Arm::random(6, 1.0, noise) };
    arm.rotors = vec![1e-9; 6];
    let (mut inertia, mut effort) = ([0.0_f64; 6], [0.0_f64; 6]);
    for _ in 0..50 {
        let motors: Vec<f64> = (0..6).map(|_| noise.symmetric()).collect();
        let (matrix, weight) = (arm.inertia(&motors), arm.torques(&motors, &[0.0; 6]));
        for axis in 0..6 {
            inertia[axis] = inertia[axis].max(matrix[(axis, axis)]);
            effort[axis] = effort[axis].max(weight[axis].abs());
        }
    }
    arm.rows = super::chains::diagonal(&[1.0 / ratio; 6]);
    let joints: Vec<NominalJoint> = (0..6)
        .map(|axis| NominalJoint {
            ratio,
            inertia: inertia[axis],
            velocity: 2.0,
            effort: 1.5 * effort[axis] + 20.0 * inertia[axis],
            home: 0.0,
            travel: None,
        })
        .collect();
    arm.rotors = joints.iter().map(NominalJoint::rotor_inertia).collect();
    let config = |joint| AxisConfig { start_angle: 0.0, ..AxisConfig::nominal(joint).expect("a sound joint") };
    (arm, joints.iter().map(config).collect())
}

#[test]
fn drives_move_and_hold_all_axes_of_random_arms_in_blocks_of_any_length() {
    let mut noise = Noise::new(34);
    for number in 0..12 {
        let ratio = [1.0, 10.0, 100.0][number % 3];
        let steps = [1, 10, 20, 200][number % 4];
        let (arm, configs) = driven(ratio, &mut noise);
        let mechanism = arm.posed(&[]);
        let mut axes: Vec<PlantAxis> = configs
            .iter()
            .enumerate()
            .map(|(axis, config)| PlantAxis::mounted(config, axis as u64, mechanism.mount(axis, 0.0).as_ref()))
            .collect();
        let mut from = [0.0; 6];
        let block = f64::from(steps) * SUB_STEP;
        for k in 1..=(2.0 / block) as u32 {
            // At rest for 0.5 s, then to 0.3 rad in 1 s, then at rest.
            let phase = (f64::from(k) * block - 0.5).clamp(0.0, 1.0) * std::f64::consts::PI;
            for (axis, (plant, config)) in axes.iter_mut().zip(&configs).enumerate() {
                let scale = f64::from(config.counts_per_revolution) / std::f64::consts::TAU * ratio;
                let to = 0.15 * (1.0 - phase.cos()) * scale;
                plant.advance(steps, Demand::Position { counts: from[axis], velocity: (to - from[axis]) / block });
                from[axis] = to;
                let off = (plant.angle() / ratio - to / scale).abs();
                let text = format!("axis {axis} at {k}: {off} rad, ratio {ratio}, blocks of {steps} sub-steps");
                assert_eq!(plant.feedback().trip, None, "{text}");
                assert!(off < 0.1, "{text}");
                assert!(off < 2e-3 || f64::from(k) * block < 1.8, "{text}");
            }
        }
    }
}
