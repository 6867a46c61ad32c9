//! A drive of a robot in a scene.

use nalgebra::Isometry3;

use super::*;
use crate::scene::{Material, Scene, SensorConfig, Shape, TipConfig, WallConfig};
use crate::{Mechanism, MechanismConfig};

/// The upper arm of an IRb-6 at home, whose other axes stand.
fn upper_arm() -> (Epos4Config, Mechanism) {
    let mechanism = Mechanism::new(MechanismConfig::Irb6);
    let axis = AxisConfig { start_angle: 0.0, ..AxisConfig::irp6(Irp6Axis::UpperArm).with_home(0.0) };
    let mount = mechanism.mount(2, 0.0);
    (Epos4Config { mount, ..Epos4Config::new(NodeId::new(2).unwrap(), axis) }, mechanism)
}

/// A bench in which the robot is in a scene.
fn in_scene(config: Epos4Config, mechanism: &Mechanism) -> Bench {
    let mut bench = Bench::new(config);
    let mut scene = Scene::new();
    scene.add_robot(mechanism, &Isometry3::identity()).unwrap();
    bench.world.set_scene(scene);
    assert_eq!(bench.run(60), ["702#00"]);
    bench
}

/// Positions at the SYNCs of a sine in CSP, counts. `disturb` adds frames between the SYNCs.
fn positions(mut bench: Bench, disturb: bool) -> Vec<i32> {
    bench.write("656000", 1_000_000, 4);
    bench.cyclic();
    let mut positions = Vec::new();
    for cycle in 0..1_000_u32 {
        let angle = f64::from(cycle) * 2e-3 * 5.0;
        let target = (3_000.0 * (1.0 - angle.cos())) as i32;
        for answer in bench.follow(1, |_| target) {
            let answer = answer.strip_prefix("382#").expect("only TPDO3 is sent");
            positions.push(u32::from_str_radix(&answer[4..12], 16).unwrap().swap_bytes() as i32);
        }
        if disturb && cycle % 7 == 0 {
            // The next SYNC comes in the middle of a chunk, after an answer of the drive.
            bench.port.send(bench.now, &[parse("602#4064600000000000")]).unwrap();
            bench.run_micros(2_000 + 370);
        }
    }
    positions
}

#[test]
fn drive_in_a_scene_without_a_contact_follows_as_without_a_scene() {
    for disturb in [false, true] {
        let (config, _) = upper_arm();
        let alone = positions(Bench::booted(config), disturb);
        let (config, mechanism) = upper_arm();
        let with = positions(in_scene(config, &mechanism), disturb);
        assert!(alone.len() == 1_000 && with.len() == 1_000, "{} {}", alone.len(), with.len());
        let moved = alone.iter().fold(0, |most: i32, counts| most.max(counts.abs()));
        assert!(moved > 5_000, "{moved} counts");
        let worst = alone.iter().zip(&with).map(|(alone, with)| (alone - with).abs()).max();
        // Other frames end chunks in a scene early. The demand of such a chunk was computed for a whole millisecond.
        assert!(worst <= Some(if disturb { 15 } else { 1 }), "{worst:?} counts");
    }
}

#[test]
fn drive_whose_scene_ends_within_a_chunk_and_begins_again_follows_on() {
    let run = |mut bench: Bench, mechanism: Option<&Mechanism>| {
        bench.write("656000", 1_000_000, 4);
        bench.cyclic();
        let mut answers = Vec::new();
        for cycle in 0..600 {
            let angle = f64::from(cycle) * 2e-3 * 5.0;
            answers.extend(bench.follow(1, |_| (3_000.0 * (1.0 - angle.cos())) as i32));
            if cycle == 100 || cycle == 300 {
                bench.run_micros(370);
                let mut scene = Scene::new();
                let back = mechanism.filter(|_| cycle == 300);
                back.map(|mechanism| scene.add_robot(mechanism, &Isometry3::identity()).unwrap());
                bench.world.set_scene(scene);
            }
        }
        let position = |answer: &String| u32::from_str_radix(&answer[8..16], 16).unwrap().swap_bytes() as i32;
        answers.iter().map(position).collect::<Vec<_>>()
    };
    let alone = run(Bench::booted(upper_arm().0), None);
    let (config, mechanism) = upper_arm();
    let with = run(in_scene(config, &mechanism), Some(&mechanism));
    assert_eq!((alone.len(), with.len()), (600, 600));
    let worst = alone.iter().zip(&with).map(|(alone, with)| (alone - with).abs()).max();
    assert!(worst <= Some(15), "{worst:?} counts");
}

#[test]
fn drive_in_a_scene_modes_and_homes_as_without_a_scene() {
    // Profile position, with requests at any time between.
    let (config, mechanism) = upper_arm();
    let mut bench = in_scene(config, &mechanism);
    bench.write("656000", 1_000_000, 4);
    bench.enable(1);
    let start = bench.read("646000");
    bench.write("7A6000", i64::from(start + 4_000), 4);
    bench.write("406000", 0x1F, 2);
    bench.run(3_000);
    let reached = bench.read("646000");
    assert!((reached - start - 4_000).abs() <= 5, "{reached} from {start}");
    assert_eq!(bench.statusword() & 0x0400, 0x0400, "target reached");
}

#[test]
fn powered_drive_presses_on_a_floor_and_reports_its_torque() {
    let (config, mechanism) = upper_arm();
    let mut bench = Bench::new(config);
    let mut scene = Scene::new();
    let robot = scene.add_robot(&mechanism, &Isometry3::identity()).unwrap();
    scene.add_tip(robot, &TipConfig { centre: [0.0, 0.0, 0.1], radius: 0.0 }).unwrap();
    let sensor = SensorConfig { pose: Isometry3::identity(), mass: 0.0, centre: [0.0; 3], inertia: [0.0; 3] };
    let probe = scene.add_sensor(robot, &sensor).unwrap();
    let tip = scene.flange(robot) * nalgebra::Point3::new(0.0, 0.0, 0.1);
    let material = Material { stiffness: 1e4, damping: 100.0, friction: 0.0 };
    let pose = Isometry3::translation(0.0, 0.0, tip.z - 1e-3);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material }).unwrap();
    bench.world.set_scene(scene);
    bench.run(60);
    bench.write("656000", 1_000_000, 4);
    bench.cyclic();
    // Down by 10 mm at 0.67 m, in 1 s: the motor is geared 175:1. The rods keep the wrist level.
    let start = bench.read("646000");
    let down = 0.01 / 0.67 * 175.126 * 4000.0 / std::f64::consts::TAU;
    bench.follow(1_000, |cycle| start + (down * f64::from(cycle.min(500)) / 500.0) as i32);
    let force = probe.last();
    let size = (force[0] * force[0] + force[1] * force[1] + force[2] * force[2]).sqrt();
    // 9 mm into the floor, with a position loop that is much stiffer.
    assert!((size - 90.0).abs() < 2.0, "{force:?}");
}
