//! Light gates and conveyors.

use std::time::Duration;

use can::Instant;
use can::timing::Bitrate;
use canopen::NodeId;
use nalgebra::Isometry3;

use crate::scene::{
    BeamConfig, BeamEdge, BeamProbe, BodyConfig, Material, SHORTEST_RESPONSE, Scene, SceneError, Shape, WallConfig,
};
use crate::{DigitalIo, DigitalIoConfig, World};

const RUBBER: Material = Material { stiffness: 1e5, damping: 200.0, friction: 0.8 };

/// A beam across the belt at `x`, 30 mm above the belt.
fn beam(x: f64) -> BeamConfig {
    let response = Duration::from_micros(500);
    BeamConfig { from: [x, -0.2, 0.03], to: [x, 0.2, 0.03], response, jitter: Duration::ZERO, seed: 1 }
}

/// A belt of 2 m along x, with its surface at height zero.
fn belt() -> WallConfig {
    let shape = Shape::Box { half: [1.0, 0.15, 0.05] };
    WallConfig { shape, pose: Isometry3::translation(0.0, 0.0, -0.05), material: RUBBER }
}

/// A box of 80 mm length and 60 mm height, whose front is at `front`.
fn parcel(front: f64, velocity: f64) -> BodyConfig {
    let half = [0.04, 0.05, 0.03];
    let pose = Isometry3::translation(front - half[0], 0.0, half[2]);
    BodyConfig { mass: 0.5, half, material: RUBBER, pose, velocity: [velocity, 0.0, 0.0], spin: [0.0; 3] }
}

fn edges(probe: &BeamProbe) -> Vec<BeamEdge> {
    std::iter::from_fn(|| probe.take()).collect()
}

fn run(scene: &mut Scene, until: f64) {
    while scene.now().since(Instant::ZERO).as_secs_f64() < until {
        scene.step();
    }
}

#[test]
fn edges_are_the_instants_at_which_a_body_enters_and_leaves_the_beam() {
    let mut scene = Scene::new();
    scene.set_gravity([0.0; 3]).unwrap();
    let probe = BeamProbe::default();
    scene.add_beam(&beam(0.05), probe.clone()).unwrap();
    // 0.123 m/s is no whole number of steps per edge.
    scene.add_body(&parcel(0.0, 0.123)).unwrap();
    run(&mut scene, 1.5);
    let found = edges(&probe);
    assert_eq!(found.iter().map(|edge| edge.broken).collect::<Vec<_>>(), [true, false]);
    for (edge, way) in found.iter().zip([0.05, 0.13]) {
        let late = edge.at.since(Instant::ZERO).as_secs_f64() - 500e-6 - way / 0.123;
        assert!(late.abs() < 2e-9, "{late} s");
    }
    // Above and beside the beam.
    for (y, z) in [(0.0, 0.1), (0.3, 0.0)] {
        let mut scene = Scene::new();
        scene.set_gravity([0.0; 3]).unwrap();
        scene.add_beam(&beam(0.05), probe.clone()).unwrap();
        let body = parcel(0.0, 0.123);
        scene.add_body(&BodyConfig { pose: Isometry3::translation(0.0, y, z) * body.pose, ..body }).unwrap();
        run(&mut scene, 1.5);
        assert_eq!(edges(&probe), [], "{y} {z}");
    }
}

#[test]
fn a_body_that_is_placed_in_the_beam_breaks_the_beam_at_its_time() {
    let mut scene = Scene::new();
    scene.set_gravity([0.0; 3]).unwrap();
    let probe = BeamProbe::default();
    scene.add_beam(&beam(-0.04), probe.clone()).unwrap();
    let at = Instant::ZERO + Duration::from_millis(20);
    let number = scene.place_body(at, &parcel(0.0, 0.0)).unwrap();
    run(&mut scene, 0.0199);
    assert_eq!((scene.placed(number), edges(&probe)), (None, vec![]));
    run(&mut scene, 0.03);
    assert!(scene.placed(number).is_some());
    let found = edges(&probe);
    assert!(found.len() == 1 && found[0].broken, "{found:?}");
    let late = found[0].at.since(at + Duration::from_micros(500));
    assert!(late < Duration::from_nanos(1), "{late:?}");
}

#[test]
fn a_belt_carries_an_object_that_is_placed_on_it_at_rest() {
    let mut scene = Scene::new();
    let wall = scene.add_wall(&belt()).unwrap();
    scene.drift_belt(wall, [0.15, 0.0, 0.0], 0.05, Duration::from_secs(2));
    let number = scene.place_body(Instant::ZERO, &parcel(-0.8, 0.0)).unwrap();
    let speed_at = |scene: &mut Scene, until: f64| {
        run(scene, until);
        scene.body(scene.placed(number).unwrap()).velocity.x
    };
    // A sine of 2 s has its extremes at 0.5 s and 1.5 s.
    for (until, speed) in [(4.5, 0.1575), (5.5, 0.1425)] {
        let found = speed_at(&mut scene, until);
        assert!((found - speed).abs() < 1e-4, "{found} m/s at {until} s");
    }
    // Beyond the end of the belt the object falls.
    run(&mut scene, 14.0);
    let place = scene.body(scene.placed(number).unwrap()).pose.translation;
    assert!(place.z < -0.1, "{place}");
}

#[test]
fn jitter_delays_edges_and_repeats_with_its_seed() {
    let edges_of = |seed| {
        let mut scene = Scene::new();
        scene.set_gravity([0.0; 3]).unwrap();
        let probe = BeamProbe::default();
        let jitter = Duration::from_millis(2);
        scene.add_beam(&BeamConfig { jitter, seed, ..beam(0.01) }, probe.clone()).unwrap();
        scene.add_body(&parcel(0.0, 1.0)).unwrap();
        run(&mut scene, 0.2);
        edges(&probe)
    };
    let (one, other) = (edges_of(1), edges_of(2));
    assert_eq!(one, edges_of(1));
    assert_ne!(one, other);
    let exact = Instant::ZERO + Duration::from_micros(10_500);
    for edges in [one, other] {
        let late = edges[0].at.since(exact);
        assert!(edges[0].at >= exact && late < Duration::from_millis(2), "{late:?}");
    }
}

#[test]
fn an_input_of_a_module_is_high_while_the_beam_is_broken() {
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let mut scene = Scene::new();
    scene.set_gravity([0.0; 3]).unwrap();
    let probe = BeamProbe::default();
    scene.add_beam(&BeamConfig { response: SHORTEST_RESPONSE, ..beam(0.01) }, probe.clone()).unwrap();
    // The beam is broken from 0.1 s to 0.9 s.
    scene.add_body(&parcel(0.0, 0.1)).unwrap();
    let config = DigitalIoConfig { beams: vec![(5, probe)], ..DigitalIoConfig::new(NodeId::new(5).unwrap()) };
    let module = world.add_device(bus, Box::new(DigitalIo::new(config).unwrap()));
    world.set_scene(scene);
    for (micros, level) in [(100_199, 0), (100_201, 1 << 5), (900_199, 1 << 5), (900_201, 0)] {
        world.advance(Instant::ZERO + Duration::from_micros(micros));
        let device: &DigitalIo = world.device(module).unwrap();
        assert_eq!(device.inputs(), level, "{micros} µs");
    }
}

#[test]
fn an_impossible_light_gate_is_refused() {
    let table = [
        (BeamConfig { to: beam(0.0).from, ..beam(0.0) }, "the beam of a light gate of 0 m: use a length above zero"),
        (BeamConfig { from: [f64::NAN; 3], ..beam(0.0) }, "an end of a light gate is not finite"),
        (
            BeamConfig { response: Duration::from_micros(100), ..beam(0.0) },
            "a light gate with a response time of 100.0µs: use at least 200.0µs",
        ),
    ];
    for (config, message) in table {
        let refused: Result<(), SceneError> = Scene::new().add_beam(&config, BeamProbe::default());
        assert_eq!(refused.unwrap_err().to_string(), message);
    }
    let beams = vec![(8, BeamProbe::default())];
    let config = DigitalIoConfig { beams, ..DigitalIoConfig::new(NodeId::new(5).unwrap()) };
    assert!(DigitalIo::new(config).is_err());
}
