//! Bodies without robots.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::plant::Noise;
use crate::scene::{BodyConfig, BodyId, GripConfig, Holder, Material, Scene, SceneError, Shape, WallConfig};

const METAL: Material = Material { stiffness: 1e5, damping: 0.0, friction: 0.0 };

fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

/// A floor at height zero.
fn floor(material: Material) -> WallConfig {
    WallConfig { shape: Shape::HalfSpace, pose: Isometry3::identity(), material }
}

fn cube(pose: Isometry3<f64>) -> BodyConfig {
    let zero = [0.0; 3];
    BodyConfig { mass: 2.0, half: [0.05; 3], material: METAL, pose, velocity: zero, spin: zero }
}

fn run(scene: &mut Scene, steps: u32) {
    for _ in 0..steps {
        scene.step();
    }
    assert_eq!(scene.unsolved(), 0);
}

#[test]
fn free_body_flies_on_and_keeps_its_angular_momentum() {
    let mut scene = Scene::new();
    scene.set_gravity([0.0; 3]).unwrap();
    let bar = BodyConfig {
        half: [0.25, 0.05, 0.02],
        velocity: [1.0, 2.0, 3.0],
        // Rotation about the middle axis is unstable: the bar tumbles.
        spin: [0.1, 20.0, 0.1],
        ..cube(at(0.0, 0.0, 0.0))
    };
    let bar = scene.add_body(&bar).unwrap();
    let (energy, (linear, angular)) = (scene.energy(), scene.momentum());
    let mut turned = 0.0_f64;
    for _ in 0..10_000 {
        scene.step();
        turned = turned.max(1.0 - (scene.body(bar).pose.rotation * Vector3::y()).y);
    }
    assert!(turned > 1.5, "{turned}");
    let (end, spun) = scene.momentum();
    assert!((end - linear).norm() < 1e-12 * linear.norm() && (spun - angular).norm() < 1e-11 * angular.norm());
    assert!((scene.energy() - energy).abs() < 1e-11 * energy, "{} of {energy}", scene.energy());
    assert!((scene.body(bar).pose.translation.vector - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-9);
}

#[test]
fn falling_body_falls_by_the_law_and_bounces_back_to_its_height() {
    let mut scene = Scene::new();
    scene.add_wall(&floor(METAL)).unwrap();
    let cube = scene.add_body(&cube(at(0.0, 0.0, 0.05 + 0.1))).unwrap();
    let energy = scene.energy();
    run(&mut scene, 1_000);
    let height = scene.body(cube).pose.translation.z;
    assert!((height - (0.15 - 0.5 * 9.81 * 0.01)).abs() < 1e-9, "{height}");
    let mut top = 0.0_f64;
    for step in 0..4_000 {
        run(&mut scene, 1);
        assert!((scene.energy() - energy).abs() < 1e-9 * energy, "{} of {energy} at {step}", scene.energy());
        top = if step > 1_500 { top.max(scene.body(cube).pose.translation.z) } else { 0.0 };
    }
    assert!((top - 0.15).abs() < 1e-5, "{top}");
}

#[test]
fn bodies_that_meet_keep_their_momentum() {
    for (damping, friction) in [(0.0, 0.0), (300.0, 0.0), (300.0, 0.5)] {
        let mut scene = Scene::new();
        scene.set_gravity([0.0; 3]).unwrap();
        let material = Material { damping, friction, ..METAL };
        let leaning =
            Isometry3::from_parts(Translation3::new(0.0, 0.02, 0.01), UnitQuaternion::from_euler_angles(0.4, 0.5, 0.6));
        let first = BodyConfig { material, velocity: [1.0, 0.0, 0.0], spin: [1.0, 2.0, 3.0], ..cube(leaning) };
        let second = BodyConfig { material, mass: 5.0, half: [0.05, 0.1, 0.2], ..cube(at(0.2, 0.0, 0.0)) };
        scene.add_body(&first).unwrap();
        let struck = scene.add_body(&second).unwrap();
        let (energy, (linear, angular)) = (scene.energy(), scene.momentum());
        run(&mut scene, 5_000);
        assert!(scene.body(struck).velocity.norm() > 0.1, "they have met");
        let (end, spun) = scene.momentum();
        assert!((end - linear).norm() < 1e-9 * linear.norm(), "{end} for {linear}");
        assert!((spun - angular).norm() < 1e-9 * angular.norm(), "{spun} for {angular}");
        assert!(scene.energy() < energy * (1.0 + 1e-9), "{} of {energy}", scene.energy());
        if damping == 0.0 {
            assert!((scene.energy() - energy).abs() < 1e-9 * energy, "{} of {energy}", scene.energy());
        }
    }
}

#[test]
fn box_at_rest_sinks_in_by_its_weight_over_the_stiffness() {
    let mut scene = Scene::new();
    scene.add_wall(&floor(Material { damping: 300.0, friction: 0.3, ..METAL })).unwrap();
    let cube = scene.add_body(&cube(at(0.0, 0.0, 0.05))).unwrap();
    run(&mut scene, 10_000);
    let depth = 0.05 - scene.body(cube).pose.translation.z;
    assert!((depth - 2.0 * 9.81 / 4e5).abs() < 1e-9, "{depth} m");
}

#[test]
fn body_on_a_slope_stands_below_the_friction_angle_and_slides_above() {
    // Friction 0.3 holds up to 0.2915 rad.
    for (slope, stands) in [(0.25, true), (0.28, true), (0.30, false), (0.35, false)] {
        let turn = UnitQuaternion::from_euler_angles(0.0, slope, 0.0);
        let mut scene = Scene::new();
        let material = Material { damping: 300.0, friction: 0.3, ..METAL };
        let pose = Isometry3::from_parts(Translation3::identity(), turn);
        scene.add_wall(&WallConfig { pose, ..floor(material) }).unwrap();
        let cube = scene.add_body(&cube(pose * at(0.0, 0.0, 0.05))).unwrap();
        run(&mut scene, 5_000);
        let velocity = scene.body(cube).velocity.norm();
        if stands {
            assert!(velocity < 1e-4, "{slope} rad: {velocity} m/s");
        } else {
            let law = 0.5 * 9.81 * (slope.sin() - 0.3 * slope.cos());
            assert!((velocity - law).abs() < 6e-3, "{slope} rad: {velocity} m/s for {law}");
        }
    }
}

#[test]
fn belt_carries_a_box_to_its_own_speed() {
    let mut scene = Scene::new();
    let belt = scene.add_wall(&floor(Material { damping: 300.0, friction: 0.5, ..METAL })).unwrap();
    let cube = scene.add_body(&cube(at(0.0, 0.0, 0.05 - 2.0 * 9.81 / 4e5))).unwrap();
    scene.set_belt(belt, [0.0, 0.1, 0.0]);
    // Friction accelerates by 4.9 m/s², which takes 20 ms.
    run(&mut scene, 100);
    let velocity = scene.body(cube).velocity.y;
    assert!((velocity - 0.5 * 9.81 * 0.01).abs() < 2e-3, "{velocity} m/s");
    run(&mut scene, 9_900);
    let state = scene.body(cube);
    assert!((state.velocity - Vector3::new(0.0, 0.1, 0.0)).norm() < 1e-6, "{}", state.velocity);
    let way = 0.1 - 0.5 * 0.1 * 0.1 / 4.905;
    assert!((state.pose.translation.y - way).abs() < 1e-4, "{}", state.pose.translation.y);
}

#[test]
fn clamp_holds_a_body_by_its_springs() {
    let mut scene = Scene::new();
    let body = scene.add_body(&cube(at(0.3, 0.0, 1.0))).unwrap();
    // The clamp is at the left end of the body's frame, 0.3 m beside its centre.
    let grip = scene.hold(&GripConfig::NOMINAL, Holder::World, &at(0.0, 0.0, 1.0), body, None).unwrap();
    run(&mut scene, 30_000);
    let weight = 2.0 * 9.81;
    let found = scene.grip_wrench(grip);
    let state = scene.body(body);
    // The torque of the springs is the stiffness times the sine of the angle.
    let angle = state.pose.rotation.angle();
    let arm = 0.3 * angle.cos();
    let expected = [0.0, 0.0, weight, 0.0, -weight * arm, 0.0];
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{found} for {expected}");
    }
    assert!((2e3 * angle.sin() - weight * arm).abs() < 1e-6, "{angle} rad");
    let fallen = 1.0 - 0.3 * angle.sin() - weight / 1e5;
    assert!((state.pose.translation.z - fallen).abs() < 1e-9, "{}", state.pose.translation.z);
    scene.release(grip);
    run(&mut scene, 1_000);
    assert!((scene.body(body).velocity.z + 0.981).abs() < 1e-3, "it falls");
    assert_eq!(scene.grip_wrench(grip), [0.0; 6]);
}

#[test]
fn light_bar_in_a_strongly_damped_grip_beside_its_centre_is_solved() {
    let mut scene = Scene::new();
    let bar = BodyConfig { mass: 0.1, half: [0.01, 0.01, 0.06], spin: [0.0, 0.0, 20.0], ..cube(at(0.0, 0.0, 1.0)) };
    let bar = scene.add_body(&bar).unwrap();
    let energy = scene.energy();
    scene.hold(&GripConfig::NOMINAL, Holder::World, &at(0.25, 0.0, 1.0), bar, None).unwrap();
    // Checks that all steps are solved.
    run(&mut scene, 1_000);
    assert!(scene.energy() < energy, "{} of {energy}", scene.energy());
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

/// A room of six walls with a post, bodies that fly about, and clamps on some of them.
fn random_scene(noise: &mut Noise) -> (Scene, Vec<BodyId>) {
    let mut scene = Scene::new();
    if noise.bits() & 1 == 0 {
        scene.set_gravity([0.0; 3]).unwrap();
    }
    let ceiling = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    let quarter = std::f64::consts::FRAC_PI_2;
    let sides = [quarter, -quarter].map(|angle| UnitQuaternion::from_euler_angles(angle, 0.0, 0.0));
    let ends = [quarter, -quarter].map(|angle| UnitQuaternion::from_euler_angles(0.0, angle, 0.0));
    for turn in [UnitQuaternion::identity(), ceiling].into_iter().chain(sides).chain(ends) {
        let pose = Isometry3::from_parts(Translation3::identity(), turn) * at(0.0, 0.0, -0.2);
        scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material: material(noise) }).unwrap();
    }
    let post = Shape::Box { half: [0.02, 0.03, 0.1] };
    scene.add_wall(&WallConfig { shape: post, pose: pose(noise, 0.1), material: material(noise) }).unwrap();
    let count = 1 + noise.bits() % 3;
    let bodies: Vec<_> = (0..count)
        .map(|_| {
            let config = BodyConfig {
                mass: 10.0_f64.powf(between(noise, -1.0, 1.0)),
                half: [0; 3].map(|_: i32| between(noise, 0.01, 0.06)),
                material: material(noise),
                pose: pose(noise, 0.15),
                velocity: vector(noise, 2.0),
                spin: vector(noise, 20.0),
            };
            scene.add_body(&config).unwrap()
        })
        .collect();
    for &body in &bodies {
        if noise.bits().is_multiple_of(3) {
            let config = GripConfig {
                stiffness: 10.0_f64.powf(between(noise, 3.0, 5.5)),
                damping: between(noise, 0.0, 300.0),
                turning_stiffness: between(noise, 0.0, 2e3),
                turning_damping: between(noise, 0.0, 6.0),
            };
            scene.hold(&config, Holder::World, &pose(noise, 0.15), body, None).unwrap();
        }
    }
    (scene, bodies)
}

/// `MRROC_RANDOM_TIMES` multiplies the number of scenes.
#[test]
fn random_scenes_gain_no_energy() {
    let times = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    let mut worst = 0.0_f64;
    for seed in 0..100 * times {
        let mut noise = Noise::new(seed);
        let (mut scene, _) = random_scene(&mut noise);
        // The energy of a scene may be near zero, because the potential energy is zero at height zero.
        let mut least = scene.energy();
        let scale = least.abs().max(0.1);
        for step in 0..500 {
            scene.step();
            let energy = scene.energy();
            worst = worst.max((energy - least) / scale);
            assert!(energy - least < 1e-6 * scale, "seed {seed}, step {step}: {energy} J after {least}");
            least = least.min(energy);
        }
        assert_eq!(scene.unsolved(), 0, "seed {seed}");
    }
    println!("largest share gained: {worst:e}");
}

#[test]
fn one_scene_is_one_run_bit_for_bit() {
    for seed in 0..10 {
        let run = || {
            let (mut scene, bodies) = random_scene(&mut Noise::new(seed));
            for _ in 0..500 {
                scene.step();
            }
            let bits = bodies.into_iter().map(|body| scene.body(body).pose.to_homogeneous().map(f64::to_bits));
            bits.collect::<Vec<_>>()
        };
        assert_eq!(run(), run(), "seed {seed}");
    }
}

#[test]
fn parts_that_cannot_be_are_refused() {
    let mut scene = Scene::new();
    for material in [
        Material { stiffness: 0.0, ..METAL },
        Material { stiffness: f64::INFINITY, ..METAL },
        Material { damping: -1.0, ..METAL },
        Material { friction: f64::NAN, ..METAL },
    ] {
        assert!(matches!(scene.add_wall(&floor(material)), Err(SceneError::Surface { .. })), "{material:?}");
        let body = BodyConfig { material, ..cube(Isometry3::identity()) };
        assert!(matches!(scene.add_body(&body), Err(SceneError::Surface { .. })), "{material:?}");
    }
    let nowhere = at(0.0, f64::NAN, 0.0);
    let wall = WallConfig { pose: nowhere, ..floor(METAL) };
    assert_eq!(scene.add_wall(&wall), Err(SceneError::NotFinite { what: "the place of a wall" }));
    let flat = WallConfig { shape: Shape::Box { half: [1.0, 0.0, 1.0] }, ..floor(METAL) };
    assert_eq!(scene.add_wall(&flat), Err(SceneError::Length { what: "an edge", value: 0.0 }));
    let cube = cube(Isometry3::identity());
    for mass in [0.0, -1.0, f64::INFINITY] {
        assert_eq!(scene.add_body(&BodyConfig { mass, ..cube }), Err(SceneError::Mass { mass }));
    }
    let fast = BodyConfig { spin: [f64::NAN, 0.0, 0.0], ..cube };
    assert_eq!(scene.add_body(&fast), Err(SceneError::NotFinite { what: "the velocity of a body" }));
    let body = scene.add_body(&cube).unwrap();
    let grip = GripConfig { damping: -1.0, ..GripConfig::NOMINAL };
    let refused = scene.hold(&grip, Holder::World, &Isometry3::identity(), body, None);
    assert_eq!(refused, Err(SceneError::Grip { stiffness: 1e5, damping: -1.0 }));
}

#[test]
fn parts_of_steps_that_are_not_solved_are_counted() {
    let mut scene = Scene::new();
    let unsolved = scene.watch_unsolved();
    // The stiffness demands parts of a step far below the shortest part.
    scene.add_wall(&floor(Material { stiffness: 1e15, ..METAL })).unwrap();
    let light = BodyConfig { mass: 1e-6, velocity: [0.1, 0.2, -1.0], spin: [3.0, 2.0, 1.0], ..cube(at(0.0, 0.0, 0.1)) };
    scene.add_body(&light).unwrap();
    assert!((0..2_000).any(|_| {
        scene.step();
        unsolved.count() > 0
    }));
    assert_eq!(unsolved.count(), scene.unsolved());
}
