//! Momentum and energy in random scenes: rooms with robots, belts, and free impacts.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::robots::Robot;
use crate::plant::Noise;
use crate::scene::{BodyConfig, BodyId, GripConfig, GripId, Holder, Material, Scene, Shape, TipConfig, WallConfig};

const STEPS: u64 = 500;

/// A random scene, and what its energy is relative to.
struct Case {
    scene: Scene,
    bodies: Vec<BodyId>,
    /// Grips of a robot, each with the number of the step before which it opens.
    grips: Vec<(GripId, u64)>,
    /// Velocity of the frame in which no contact adds energy, m/s: that of a belt.
    frame: Vector3<f64>,
    gravity: Vector3<f64>,
    /// Mass of all bodies, kg.
    mass: f64,
    /// No wall and no grip is in the scene, and no gravity: momentum stays.
    free: bool,
    /// A robot at rest, with its motors.
    _robot: Option<Robot>,
}

impl Case {
    fn of(scene: Scene) -> Self {
        let zero = Vector3::zeros();
        Self {
            scene,
            bodies: Vec::new(),
            grips: Vec::new(),
            frame: zero,
            gravity: zero,
            mass: 0.0,
            free: false,
            _robot: None,
        }
    }

    /// The scene of a seed, in turn a room, a belt and a free impact.
    fn random(seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        match seed % 4 {
            0 | 1 => room(&mut noise),
            2 => belt(&mut noise),
            _ => impact(&mut noise),
        }
    }

    /// Energy in the moving frame at `time`, s.
    fn energy(&self, time: f64) -> f64 {
        let (momentum, _) = self.scene.momentum();
        let moving = 0.5 * self.mass * self.frame.norm_squared() - momentum.dot(&self.frame);
        self.scene.energy() + moving + self.mass * self.gravity.dot(&self.frame) * time
    }

    fn step(&mut self, number: u64) {
        for (grip, _) in self.grips.iter().filter(|(_, opens)| *opens == number) {
            self.scene.release(*grip);
        }
        self.scene.step();
    }
}

fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

/// A random number between two limits.
fn between(noise: &mut Noise, low: f64, high: f64) -> f64 {
    low + 0.5 * (high - low) * (1.0 + noise.symmetric())
}

fn vector(noise: &mut Noise, size: f64) -> [f64; 3] {
    [0; 3].map(|_: i32| size * noise.symmetric())
}

fn pose(noise: &mut Noise, size: f64) -> Isometry3<f64> {
    let [x, y, z] = vector(noise, size);
    let [a, b, c] = vector(noise, 3.0);
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(a, b, c))
}

fn material(noise: &mut Noise) -> Material {
    Material {
        stiffness: 10.0_f64.powf(between(noise, 3.0, 6.0)),
        damping: if noise.bits() & 1 == 0 { 0.0 } else { between(noise, 0.0, 500.0) },
        friction: if noise.bits() & 1 == 0 { 0.0 } else { between(noise, 0.0, 1.0) },
    }
}

/// A room of six walls with a post, bodies that fly about, and clamps on some of them. Half of the rooms have a robot with
/// a tip in the room, which holds some of the bodies for a while.
fn room(noise: &mut Noise) -> Case {
    let mut scene = Scene::new();
    if noise.bits() & 1 == 0 {
        scene.set_gravity([0.0; 3]).unwrap();
    }
    let ceiling = UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
    let quarter = FRAC_PI_2;
    let sides = [quarter, -quarter].map(|angle| UnitQuaternion::from_euler_angles(angle, 0.0, 0.0));
    let ends = [quarter, -quarter].map(|angle| UnitQuaternion::from_euler_angles(0.0, angle, 0.0));
    for turn in [UnitQuaternion::identity(), ceiling].into_iter().chain(sides).chain(ends) {
        let pose = Isometry3::from_parts(Translation3::identity(), turn) * at(0.0, 0.0, -0.2);
        scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material: material(noise) }).unwrap();
    }
    let post = Shape::Box { half: [0.02, 0.03, 0.1] };
    scene.add_wall(&WallConfig { shape: post, pose: pose(noise, 0.1), material: material(noise) }).unwrap();
    let mut case = Case { bodies: random_bodies(&mut scene, noise), ..Case::of(scene) };
    let scene = &mut case.scene;
    for &body in &case.bodies {
        if noise.bits().is_multiple_of(3) {
            scene.hold(&random_grip(noise), Holder::World, &pose(noise, 0.15), body, None).unwrap();
        }
    }
    if noise.bits() & 1 == 0 {
        stand_in_a_room(&mut case, noise);
    }
    case
}

/// One to three bodies that fly about.
fn random_bodies(scene: &mut Scene, noise: &mut Noise) -> Vec<BodyId> {
    let count = 1 + noise.bits() % 3;
    (0..count).map(|_| scene.add_body(&random_body(noise)).unwrap()).collect()
}

fn random_body(noise: &mut Noise) -> BodyConfig {
    BodyConfig {
        mass: 10.0_f64.powf(between(noise, -1.0, 1.0)),
        half: [0; 3].map(|_: i32| between(noise, 0.01, 0.06)),
        material: material(noise),
        pose: pose(noise, 0.15),
        velocity: vector(noise, 2.0),
        spin: vector(noise, 20.0),
    }
}

fn random_grip(noise: &mut Noise) -> GripConfig {
    GripConfig {
        stiffness: 10.0_f64.powf(between(noise, 3.0, 5.5)),
        damping: between(noise, 0.0, 300.0),
        turning_stiffness: between(noise, 0.0, 2e3),
        turning_damping: between(noise, 0.0, 6.0),
    }
}

/// Adds an IRb-6 at rest with three tips near the middle of the room.
fn stand_in_a_room(case: &mut Case, noise: &mut Noise) {
    let robot = Robot::irb6([0.0, 0.0, 0.0, -128.0 * FRAC_PI_2, -128.0 * FRAC_PI_2]);
    let scene = &mut case.scene;
    // A trial scene gives the place of the flange.
    let mut trial = Scene::new();
    let id = trial.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
    let flange = trial.flange(id).translation.vector;
    drop(trial);
    let base = Isometry3::translation(-flange.x, -flange.y, 0.15 - flange.z);
    let id = scene.add_robot(&robot.mechanism, &base).unwrap();
    for _ in 0..3 {
        let [x, y, z] = vector(noise, 0.1);
        let radius = if noise.bits() & 1 == 0 { 0.0 } else { between(noise, 1e-3, 0.02) };
        scene.add_tip(id, &TipConfig { centre: [x, y, 0.15 + z], radius }).unwrap();
    }
    for &body in &case.bodies {
        if noise.bits() & 1 == 0 {
            let config = random_grip(noise);
            let gripper = Isometry3::translation(0.0, 0.0, 0.15) * pose(noise, 0.1);
            let grip = scene.hold(&config, Holder::Robot(id), &gripper, body, None).unwrap();
            case.grips.push((grip, noise.bits() % STEPS));
        }
    }
    case._robot = Some(robot);
}

/// Bodies on a belt of any direction and slope. The belt has no end.
fn belt(noise: &mut Noise) -> Case {
    let mut scene = Scene::new();
    let turn = UnitQuaternion::from_euler_angles(0.3 * noise.symmetric(), 0.3 * noise.symmetric(), 0.0);
    let place = Isometry3::from_parts(Translation3::identity(), turn);
    let wall = WallConfig { shape: Shape::HalfSpace, pose: place * at(0.0, 0.0, -0.2), material: material(noise) };
    let wall = scene.add_wall(&wall).unwrap();
    let [x, y, _] = vector(noise, 1.0);
    let frame = turn * Vector3::new(x, y, 0.0);
    scene.set_belt(wall, frame.into());
    let configs: Vec<_> = (0..1 + noise.bits() % 3).map(|_| random_body(noise)).collect();
    let mass = configs.iter().map(|config| config.mass).sum();
    let bodies = configs.iter().map(|config| scene.add_body(config).unwrap()).collect();
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    Case { bodies, frame, gravity, mass, ..Case::of(scene) }
}

/// Two bodies that fly at each other.
fn impact(noise: &mut Noise) -> Case {
    let mut scene = Scene::new();
    scene.set_gravity([0.0; 3]).unwrap();
    let bodies = [-1.0, 1.0].map(|side| {
        let mut config = random_body(noise);
        let turn = config.pose.rotation;
        let [x, y, z] = vector(noise, 0.02);
        config.pose = Isometry3::from_parts(Translation3::new(x + 0.12 * side, y, z), turn);
        config.velocity[0] = -side * between(noise, 1.0, 4.0);
        scene.add_body(&config).unwrap()
    });
    Case { bodies: bodies.into(), free: true, ..Case::of(scene) }
}

/// `MRROC_RANDOM_TIMES` multiplies the number of scenes.
#[test]
fn random_scenes_gain_no_energy_and_free_impacts_keep_momentum() {
    let times = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    let (mut gained, mut changed, mut touched) = (0.0_f64, 0.0_f64, 0_u64);
    for seed in 0..100 * times {
        let mut case = Case::random(seed);
        // The energy of a scene may be near zero, because the potential energy is zero at height zero.
        let mut least = case.energy(0.0);
        let scale = least.abs().max(0.1);
        let (linear, angular) = case.scene.momentum();
        let speeds = case.bodies.iter().map(|&body| case.scene.body(body).velocity).collect::<Vec<_>>();
        let reach: f64 = speeds.iter().map(Vector3::norm).sum();
        for step in 0..STEPS {
            // A grip that opens removes the energy of its springs.
            case.step(step);
            let energy = case.energy((step + 1) as f64 * 1e-4);
            gained = gained.max((energy - least) / scale);
            assert!(energy - least < 1e-6 * scale, "seed {seed}, step {step}: {energy} J after {least}");
            least = least.min(energy);
        }
        assert_eq!(case.scene.unsolved(), 0, "seed {seed}");
        if case.free {
            let (end, spun) = case.scene.momentum();
            let change = ((end - linear).norm() / linear.norm()).max((spun - angular).norm() / angular.norm());
            changed = changed.max(change);
            assert!(change < 1e-9, "seed {seed}: momentum changed by {change:e}");
            let last =
                case.bodies.iter().zip(&speeds).map(|(&body, first)| (case.scene.body(body).velocity - first).norm());
            touched += u64::from(last.sum::<f64>() > 1e-3 * reach);
        }
    }
    // About half of the bodies that fly at each other meet.
    assert!(4 * touched > 25 * times, "{touched} impacts");
    println!("largest share gained: {gained:e}; {touched} free impacts, largest change of momentum: {changed:e}");
}

#[test]
fn one_scene_is_one_run_bit_for_bit() {
    for seed in 0..12 {
        let run = || {
            let mut case = Case::random(seed);
            (0..STEPS).for_each(|step| case.step(step));
            let bits = case.bodies.iter().map(|&body| case.scene.body(body).pose.to_homogeneous().map(f64::to_bits));
            bits.collect::<Vec<_>>()
        };
        assert_eq!(run(), run(), "seed {seed}");
    }
}
