//! Linkages: comparison with equivalent chains and with closed forms, and energy of motors that swing freely.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::super::coupling::{Column, Coupled, Dynamics};
use super::super::linkage::Linkage;
use super::super::serial::SerialChain;
use super::super::{AXES, Body, LinkBody, LinkPoses, LinkageBodies, LinkageError, Mechanism, MechanismConfig};
use super::G;
use super::chains::Arm;
use super::coupled::{Swing, motor};
use crate::plant::{AxisConfig, Demand, Noise, PlantAxis, SUB_STEP};

impl LinkPoses for Arm {
    fn place(&self, motors: &[f64], poses: &mut [Isometry3<f64>]) -> bool {
        poses.copy_from_slice(&self.places(motors));
        true
    }
}

/// The linkage of an arm whose motors each turn one joint by about `ratio`.
fn linkage(arm: &Arm, ratio: f64) -> Arc<LinkageBodies> {
    let links = arm.joints.iter().map(|it| LinkBody { mass: it.mass, centre: it.centre, inertia: it.inertia });
    let links: Vec<_> = links.collect();
    let ratios = vec![-ratio; arm.axes()];
    Arc::new(LinkageBodies::new(Arc::new(arm.clone()), &links, arm.up, &ratios, &arm.rotors).unwrap())
}

fn padded(numbers: &[f64]) -> [f64; AXES] {
    std::array::from_fn(|axis| numbers.get(axis).copied().unwrap_or(0.0))
}

fn norm(numbers: impl IntoIterator<Item = f64>) -> f64 {
    numbers.into_iter().map(|it| it * it).sum::<f64>().sqrt()
}

/// Difference of two arrays, relative to the norm of the first or to `scale`, whichever is greater.
fn off<const N: usize>(one: &[f64; N], other: &[f64; N], scale: f64) -> f64 {
    norm(one.iter().zip(other).map(|(one, other)| one - other)) / norm(*one).max(scale)
}

/// Inertia, weight, and torques of the velocities as arrays.
fn torques<L: Coupled>(
    links: &L,
    motors: &[f64; AXES],
    rates: &[f64],
) -> ([f64; AXES * AXES], [f64; AXES], [f64; AXES * AXES]) {
    let pose = links.pose_at(motors).unwrap();
    let Dynamics { inertia, weight } = links.dynamics(&pose);
    let impulses = links.impulses(&pose, &Column::from(padded(rates)));
    let all = |matrix: &[[f64; AXES]; AXES]| std::array::from_fn(|at| matrix[at / AXES][at % AXES]);
    (all(&inertia.data.0), weight.into(), all(&impulses.data.0))
}

#[test]
fn a_chain_that_a_function_places_has_the_dynamics_of_the_chain() {
    let mut noise = Noise::new(41);
    let (mut worst, mut flanges) = ([0.0_f64; 3], 0.0_f64);
    for number in 0..48 {
        let count = 1 + number % 8;
        let ratio = [1.0, 30.0, 150.0][number % 3];
        let arm = Arm::random(count, ratio, &mut noise);
        let mut draw = |size: f64| (0..count).map(|_| size * noise.symmetric()).collect::<Vec<f64>>();
        let (motors, rates) = (padded(&draw(2.0 * ratio)), draw(3.0 * ratio));
        let MechanismConfig::Chain(bodies) = arm.config() else { unreachable!("a chain") };
        let (mut chain, mut placed) = (SerialChain::new(bodies), Linkage::new(linkage(&arm, ratio)));
        let payload = Body::point(arm.payload.0, arm.payload.1);
        chain.set_payload(payload, &motors);
        placed.set_payload(payload, &motors);
        let (of_chain, of_links) = (torques(&chain, &motors, &rates), torques(&placed, &motors, &rates));
        // The torques of a single joint are zero. `usual`: torques of an inertia that changes by its own size per
        // radian.
        let usual = norm(of_chain.0) * norm(rates.iter().copied()).powi(2) / ratio;
        let found = [
            off(&of_chain.0, &of_links.0, 0.0),
            off(&of_chain.1, &of_links.1, 1e-3 / ratio),
            off(&of_chain.2, &of_links.2, usual),
        ];
        assert!(found.iter().all(|off| *off < 1e-6), "{found:?} of {arm:?}");
        worst = std::array::from_fn(|at| worst[at].max(found[at]));
        for axis in 0..count {
            let (one, other) = (chain.load(axis, &motors), placed.load(axis, &motors));
            assert!((one.inertia() / other.inertia() - 1.0).abs() < 1e-7, "{axis} of {arm:?}");
            let weight = of_chain.1.iter().fold(0.0, |most: f64, torque| most.max(torque.abs()));
            assert!((one.links.torque - other.links.torque).abs() < 1e-7 * weight, "{axis} of {arm:?}");
        }
        let (one, other) = (chain.kinematics(&motors), placed.kinematics(&motors));
        assert!((one.flange.origin - other.flange.origin).norm() < 1e-12, "{arm:?}");
        assert!((one.flange.axes - other.flange.axes).norm() < 1e-12, "{arm:?}");
        for (one, other) in one.motors.iter().zip(&other.motors) {
            let off = ((one.velocity - other.velocity).norm() + (one.spin - other.spin).norm()) * ratio;
            flanges = flanges.max(off);
            assert!(off < 1e-7, "{arm:?}: {off}");
        }
    }
    println!("relative differences of inertia, weight and velocity torques: {worst:?}; of the flange: {flanges:e}");
}

#[test]
fn a_chain_that_a_function_places_swings_as_the_chain_and_keeps_its_energy() {
    let mut noise = Noise::new(42);
    let (mut worst, mut apart) = (0.0_f64, 0.0_f64);
    for number in 0..24 {
        let count = 1 + number % 4;
        let ratio = if number % 3 == 0 { 30.0 } else { 1.0 };
        let arm = Arm::random(count, ratio, &mut noise);
        let motors: Vec<f64> = (0..count).map(|_| ratio * noise.symmetric()).collect();
        let config = MechanismConfig::Linkage(linkage(&arm, ratio));
        let text = format!("{arm:?} from {motors:?}");
        let mut placed = Swing::of(arm.clone(), config, &motors);
        let mut chain = Swing::new(arm, &motors);
        let steps = if number % 2 == 0 { 1 } else { 20 };
        let (most, off) = placed.drift(0.3, steps);
        let (_, of_chain) = chain.drift(0.3, steps);
        worst = worst.max(off / most);
        assert!(off < 0.05 * most && off < of_chain + 1e-4 * most, "{off} J of {most} J, {of_chain} J: {text}");
        for (one, other) in placed.motors().iter().zip(chain.motors()) {
            apart = apart.max((one - other).abs() / ratio);
            assert!((one - other).abs() < 1e-4 * ratio, "{one} {other}: {text}");
        }
    }
    println!("greatest drift in 0.3 s: {worst:.5} of the kinetic energy; from the chain: {apart:e} rad");
}

/// A crank that moves a piston along y: closed form of its height.
#[derive(Debug)]
struct Piston;

const CRANK: f64 = 0.1;
const ROD: f64 = 0.3;

fn height(angle: f64) -> f64 {
    CRANK * angle.sin() + (ROD * ROD - (CRANK * angle.cos()).powi(2)).sqrt()
}

fn slope(angle: f64) -> f64 {
    let rod = (ROD * ROD - (CRANK * angle.cos()).powi(2)).sqrt();
    CRANK * angle.cos() + CRANK * CRANK * angle.cos() * angle.sin() / rod
}

impl LinkPoses for Piston {
    fn place(&self, motors: &[f64], poses: &mut [Isometry3<f64>]) -> bool {
        poses.fill(Isometry3::translation(0.0, height(motors[0]), 0.0));
        true
    }
}

#[test]
fn a_piston_on_a_crank_keeps_the_energy_of_its_closed_form() {
    let (mass, rotor, up) = (2.0, 0.004, [0.0, 1.0, 0.0]);
    let links = [LinkBody { mass, ..LinkBody::default() }];
    let bodies = LinkageBodies::new(Arc::new(Piston), &links, up, &[1.0], &[rotor]).unwrap();
    let mechanism = Mechanism::new(MechanismConfig::Linkage(Arc::new(bodies)));
    let config = AxisConfig { start_angle: 1.4, ..motor() };
    let mut axis = PlantAxis::mounted(&config, 1, mechanism.mount(0, 0.0).as_ref());
    let start = mass * G * height(1.4);
    let (mut most, mut off) = (0.0_f64, 0.0_f64);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for _ in 0..(5.0 / SUB_STEP) as u32 {
        axis.advance(1, Demand::Off);
        let (angle, velocity) = (axis.angle(), axis.velocity());
        let kinetic = 0.5 * (rotor + mass * slope(angle).powi(2)) * velocity * velocity;
        (most, off) = (most.max(kinetic), off.max((kinetic + mass * G * height(angle) - start).abs()));
        (low, high) = (low.min(angle), high.max(angle));
    }
    println!("{off:.5} J of {most:.3} J between {low:.3} and {high:.3} rad");
    assert!(off < 0.01 * most && most > 3.0, "{off} J of {most} J");
    // The crank swings to the same height on the other side.
    assert!((high - 1.4 - 0.0).abs() < 0.01 && (low + std::f64::consts::PI + 1.4).abs() < 0.01, "{low} {high}");
}

/// A five-bar mechanism in the plane: two driven rods, and two rods of this length, m, that join at the flange.
#[derive(Clone, Copy, Debug)]
struct FiveBar(f64);

const SIDES: [(f64, f64); 2] = [(-0.1, 1.0), (0.1, -1.0)];
const DRIVEN: f64 = 0.25;
const JOINED: f64 = 0.35;
const AT_HOME: [f64; 2] = [2.1, 1.04];

impl LinkPoses for FiveBar {
    fn place(&self, motors: &[f64], poses: &mut [Isometry3<f64>]) -> bool {
        let angle = |side: usize| AT_HOME[side] + motors[side];
        let elbow = [0, 1].map(|side: usize| {
            let (sin, cos) = angle(side).sin_cos();
            Vector3::new(SIDES[side].0 + DRIVEN * cos, DRIVEN * sin, 0.0)
        });
        let half = 0.5 * (elbow[1] - elbow[0]);
        let rest = self.0 * self.0 - half.norm_squared();
        if rest <= 0.0 {
            return false;
        }
        let flange = elbow[0] + half + Vector3::z().cross(&half).normalize() * rest.sqrt();
        let turned = |at: Vector3<f64>, angle: f64| {
            Isometry3::from_parts(Translation3::from(at), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle))
        };
        for side in 0..2 {
            let along = flange - elbow[side];
            poses[side] = turned(Vector3::new(SIDES[side].0, 0.0, 0.0), angle(side));
            poses[2 + side] = turned(elbow[side], along.y.atan2(along.x));
        }
        poses[4] = turned(flange, 0.0);
        true
    }
}

fn rods() -> [LinkBody; 4] {
    [(1.0, DRIVEN), (1.0, DRIVEN), (0.6, JOINED), (0.6, JOINED)].map(|(mass, length)| LinkBody::rod(mass, length))
}

/// Energy of the rods and the rotors from displacements along the motion.
fn energy(motors: [f64; 2], velocities: [f64; 2], rotor: f64) -> (f64, f64) {
    let step = 1e-6;
    let at = |share: f64| {
        let mut poses = [Isometry3::identity(); 5];
        assert!(
            FiveBar(JOINED).place(&[motors[0] + share * velocities[0], motors[1] + share * velocities[1]], &mut poses)
        );
        poses
    };
    let (low, here, high) = (at(-step), at(0.0), at(step));
    let (mut kinetic, mut potential) = (0.5 * rotor * (velocities[0].powi(2) + velocities[1].powi(2)), 0.0);
    for (number, LinkBody { mass, centre, inertia }) in rods().into_iter().enumerate() {
        let centre = Point3::from(centre);
        let velocity = (high[number] * centre - low[number] * centre) / (2.0 * step);
        let spin = low[number].rotation.angle_to(&high[number].rotation) / (2.0 * step);
        kinetic += 0.5 * mass * velocity.norm_squared() + 0.5 * inertia[2] * spin * spin;
        potential += mass * G * (here[number] * centre).y;
    }
    (kinetic, potential)
}

#[test]
fn a_closed_loop_of_links_keeps_its_energy() {
    let rotor = 0.01;
    for (up, steps) in [([0.0, 1.0, 0.0], 1), ([0.0, 1.0, 0.0], 20)] {
        let bodies = LinkageBodies::new(Arc::new(FiveBar(JOINED)), &rods(), up, &[1.0; 2], &[rotor; 2]).unwrap();
        let mechanism = Mechanism::new(MechanismConfig::Linkage(Arc::new(bodies)));
        let mut axes: Vec<PlantAxis> =
            (0..2).map(|number| PlantAxis::mounted(&motor(), 1, mechanism.mount(number, 0.0).as_ref())).collect();
        let start = energy([0.0; 2], [0.0; 2], rotor).1;
        let (mut most, mut off) = (0.0_f64, 0.0_f64);
        for _ in 0..(0.5 / (SUB_STEP * f64::from(steps))) as u32 {
            axes.iter_mut().for_each(|axis| axis.advance(steps, Demand::Off));
            let motors = [axes[0].angle(), axes[1].angle()];
            if motors[0].abs() > 0.9 || motors[1].abs() > 0.9 {
                break;
            }
            let velocities = mechanism.lock().links.coupling().unwrap().velocities;
            let (kinetic, potential) = energy(motors, [velocities[0], velocities[1]], rotor);
            (most, off) = (most.max(kinetic), off.max((kinetic + potential - start).abs()));
        }
        println!("{off:.5} J of {most:.3} J in {steps} sub-steps");
        assert!(most > 1.0 && off < 0.01 * most, "{off} J of {most} J in {steps} sub-steps");
    }
}

#[test]
fn links_that_cannot_take_a_pose_keep_their_last_inertia() {
    let mechanism = Mechanism::new(short());
    let mut axes: Vec<PlantAxis> =
        (0..2).map(|number| PlantAxis::mounted(&motor(), 1, mechanism.mount(number, 0.0).as_ref())).collect();
    for _ in 0..6000 {
        axes.iter_mut().for_each(|axis| axis.advance(1, Demand::Off));
        // The rods fall by less than 1 m. Their energy of 32 J turns the rotors alone at 80 rad/s.
        let fastest = axes.iter().map(|axis| axis.velocity().abs()).fold(0.0, f64::max);
        assert!(fastest < 80.0, "{fastest} rad/s at {} and {} rad", axes[0].angle(), axes[1].angle());
    }
    // A pose in which the links cannot be joined.
    let mechanism = Mechanism::new(short());
    mechanism.mount(0, 0.0).unwrap().place(1.04);
    mechanism.mount(1, 0.0).unwrap().place(-1.04);
    let (kinematics, _) = mechanism.kinematics();
    assert!(kinematics.flange.origin.iter().all(|part| part.is_finite()));
    assert_eq!(mechanism.load(0).inertia, 0.01);
    mechanism.set_payload(1.0, [0.0; 3]);
    let mut axis =
        PlantAxis::mounted(&AxisConfig { start_angle: 1.04, ..motor() }, 1, mechanism.mount(0, 0.0).as_ref());
    axis.advance(10, Demand::Off);
    assert!(axis.velocity().is_finite());
}

/// A mechanism whose motors turn its links through gears.
#[derive(Debug)]
struct Geared<T>(T, f64);

impl<T: LinkPoses> LinkPoses for Geared<T> {
    fn place(&self, motors: &[f64], poses: &mut [Isometry3<f64>]) -> bool {
        self.0.place(&motors.iter().map(|motor| motor / self.1).collect::<Vec<_>>(), poses)
    }
}

#[test]
fn links_near_a_singular_pose_are_found_behind_every_gear() {
    let found = |ratio: f64| {
        let poses = Arc::new(Geared(FiveBar(0.3), ratio));
        let rotors = [0.01 / (ratio * ratio); 2];
        let bodies = LinkageBodies::new(poses, &rods(), [0.0, 1.0, 0.0], &[ratio; 2], &rotors).unwrap();
        let linkage = Linkage::new(Arc::new(bodies));
        let bent = |by: f64| [by * ratio, -by * ratio, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        (0..2000).map(|step| linkage.pose_at(&bent(f64::from(step) * 5e-4)).is_some()).collect::<Vec<_>>()
    };
    let direct = found(1.0);
    let last = direct.iter().rposition(|is_placed| *is_placed).unwrap();
    let places = |motors: [f64; 2]| FiveBar(0.3).place(&motors, &mut [Isometry3::identity(); 5]);
    let beyond = f64::from(last as u32 + 1) * 5e-4;
    assert!(places([beyond, -beyond]), "the check must end before the links cannot be joined, at {beyond} rad");
    assert!(direct == found(50.0));
}

/// A mechanism whose joined rods are too short for some of its poses.
fn short() -> MechanismConfig {
    let bodies = LinkageBodies::new(Arc::new(FiveBar(0.3)), &rods(), [0.0, 1.0, 0.0], &[1.0; 2], &[0.01; 2]);
    MechanismConfig::Linkage(Arc::new(bodies.unwrap()))
}

#[derive(Debug)]
struct Nowhere;

impl LinkPoses for Nowhere {
    fn place(&self, _motors: &[f64], _poses: &mut [Isometry3<f64>]) -> bool {
        false
    }
}

#[test]
fn numbers_that_no_linkage_has_are_refused_in_words() {
    let link = rods()[0];
    let new =
        |links: &[LinkBody], up: [f64; 3], ratios: &[f64], rotors: &[f64]| -> Result<LinkageBodies, LinkageError> {
            LinkageBodies::new(Arc::new(FiveBar(JOINED)), links, up, ratios, rotors)
        };
    let (up, two) = ([0.0, 1.0, 0.0], [1.0; 2]);
    let at = |change: LinkBody| {
        let mut links = rods();
        links[1] = change;
        links
    };
    let cases = [
        (new(&[], up, &two, &two), "0 links, 1 to 16 are possible"),
        (new(&[link; 17], up, &two, &two), "17 links"),
        (new(&rods(), up, &[], &[]), "0 motors, 1 to 8 are possible"),
        (new(&rods(), up, &two, &[1.0]), "2 motors"),
        (new(&rods(), [0.0; 3], &two, &two), "it must have a direction"),
        (new(&rods(), [f64::NAN, 0.0, 0.0], &two, &two), "it must have a direction"),
        (new(&rods(), up, &[1.0, 0.0], &two), "motor 2: the magnitude of the ratio is 0, it must be above 0"),
        (new(&rods(), up, &two, &[f64::NAN, 1.0]), "motor 1: the inertia of the rotor is NaN"),
        (new(&at(LinkBody { mass: -1.0, ..link }), up, &two, &two), "link 2: the mass is -1 kg"),
        (new(&at(LinkBody { mass: f64::NAN, ..link }), up, &two, &two), "link 2: the mass is not a finite number"),
        (new(&at(LinkBody { inertia: [-1.0; 6], ..link }), up, &two, &two), "link 2: no link has the principal"),
        (LinkageBodies::new(Arc::new(Nowhere), &rods(), up, &two, &two), "no pose with all motors at home"),
    ];
    for (found, words) in cases {
        let text = found.unwrap_err().to_string();
        assert!(text.contains(words), "{text}, not {words}");
    }
    assert!(new(&rods(), up, &two, &two).is_ok());
}
