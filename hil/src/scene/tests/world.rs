//! A robot whose drives are on a bus and on lines, in a world with a scene.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use can::{Frame, Instant, timing::Bitrate};
use canopen::NodeId;
use nalgebra::Isometry3;
use serial::Settings;

use crate::plant::{AxisConfig, Demand, Irp6Axis, Mechanism, MechanismConfig, PlantAxis};
use crate::scene::{
    BodyConfig, Material, RobotId, STEP, Scene, SensorConfig, SensorProbe, Shape, TipConfig, WallConfig,
};
use crate::{AxisController, AxisControllerConfig, Device, Epos4, Epos4Config, World};

/// An IRb-6 without power or brakes: two drives on one bus, one on another, two on lines. Its tip hangs 5 mm over a
/// floor.
fn world() -> (World, RobotId, SensorProbe) {
    let mechanism = Mechanism::new(MechanismConfig::Irb6);
    let mut world = World::new();
    let buses = [Bitrate::KBPS_1000, Bitrate::KBPS_500].map(|rate| world.add_bus(rate));
    let angles = [0.0, 0.0, 0.0, -128.0 * FRAC_PI_2, -128.0 * FRAC_PI_2];
    for (number, (axis, start_angle)) in Irp6Axis::ALL.into_iter().zip(angles).enumerate() {
        let axis = AxisConfig { start_angle, brake: 0.0, ..AxisConfig::irp6(axis).with_home(0.0) };
        let mount = mechanism.mount(number, 0.0);
        if number < 3 {
            let config = Epos4Config::new(NodeId::new(number as u8 + 1).expect("a node-ID"), axis);
            world.add_device(buses[number % 2], Box::new(Epos4::new(Epos4Config { mount, ..config })));
        } else {
            let config = AxisControllerConfig { mount, ..AxisControllerConfig::new(axis) };
            world.add_line(Settings::AXIS_CONTROLLER, None, Box::new(AxisController::hi_moxa(&config)));
        }
    }
    let mut scene = Scene::new();
    let robot = scene.add_robot(&mechanism, &Isometry3::identity()).unwrap();
    scene.add_tip(robot, &TipConfig { centre: [0.0, 0.0, 0.2], radius: 0.01 }).unwrap();
    let sensor = SensorConfig { pose: Isometry3::identity(), mass: 0.0, centre: [0.0; 3], inertia: [0.0; 3] };
    let probe = scene.add_sensor(robot, &sensor).unwrap();
    let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.3 };
    let pose = Isometry3::translation(0.0, 0.0, 0.455 - 0.095 - 0.2 - 0.01 - 5e-3);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material }).unwrap();
    world.set_scene(scene);
    (world, robot, probe)
}

#[test]
fn robot_without_power_falls_on_the_floor_and_stays() {
    let (mut world, robot, probe) = world();
    let height = |world: &World| world.scene().unwrap().flange(robot).translation.z - 0.2 - 0.01;
    let floor = 0.455 - 0.095 - 0.2 - 0.01 - 5e-3;
    assert!((height(&world) - floor - 5e-3).abs() < 1e-9);
    world.advance(Instant::ZERO + Duration::from_millis(3_000));
    assert_eq!(world.scene().unwrap().now(), Instant::ZERO + Duration::from_millis(3_000));
    let fallen = height(&world) - floor;
    assert!((-5e-3..0.0).contains(&fallen), "{fallen} m");
    // The tip carries between nothing and the weight of upper arm, wrist and gripper at the tip. The gears hold a part.
    let force = -probe.last()[2];
    let weight = 9.81 * (14.0 * 0.25 + 5.35 * 0.67) / 0.67;
    assert!((0.2 * weight..1.5 * weight).contains(&force), "{force} N of {weight}");
}

#[test]
fn runs_in_a_scene_do_not_depend_on_how_the_world_is_advanced() {
    let run = |micros: u64| {
        let (mut world, robot, probe) = world();
        let end = Instant::ZERO + Duration::from_millis(500);
        let mut now = Instant::ZERO;
        while now < end {
            now = (now + Duration::from_micros(micros)).min(end);
            world.advance(now);
        }
        let flange = world.scene().unwrap().flange(robot).to_homogeneous().map(f64::to_bits);
        (flange, probe.last().map(f64::to_bits))
    };
    let once = run(500_000);
    for micros in [500_000, 2_000, 1_370, 100, 33] {
        assert!(run(micros) == once, "advanced by {micros} µs");
    }
}

#[test]
fn motor_of_a_conveyor_carries_a_box() {
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let axis = AxisConfig { brake: 0.0, ..AxisConfig::irp6(Irp6Axis::Column) };
    let mut motor = Turning { axis: PlantAxis::new(&axis, 1), reached: Instant::ZERO };
    let shaft = motor.axis.probe();
    world.add_device(bus, Box::new(motor));
    let mut scene = Scene::new();
    let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.5 };
    let floor = WallConfig { shape: Shape::HalfSpace, pose: Isometry3::identity(), material };
    let belt = scene.add_wall(&floor).unwrap();
    // 1 rad of the motor moves the belt by 1/250 m: 0.2 m/s at 50 rad/s.
    let start = shaft.angle();
    scene.drive_belt(belt, shaft.clone(), [0.0, 0.004, 0.0]);
    let pose = Isometry3::translation(0.0, 0.0, 0.05);
    let still = [0.0; 3];
    let cube = BodyConfig { mass: 1.0, half: [0.05; 3], material, pose, velocity: still, spin: still };
    let cube = scene.add_body(&cube).unwrap();
    let probe = scene.watch(cube);
    world.set_scene(scene);
    world.advance(Instant::ZERO + Duration::from_millis(2_000));
    let state = probe.state();
    assert!((state.velocity.y - 0.2).abs() < 2e-3, "{}", state.velocity);
    // The box stays behind while it is accelerated with 4.9 m/s², and then stands on the belt.
    let behind = 0.004 * (shaft.angle() - start) - state.pose.translation.y;
    assert!((0.0..0.01).contains(&behind), "{behind} m");
}

/// A motor that turns at 50 rad/s by itself.
struct Turning {
    axis: PlantAxis,
    reached: Instant,
}

impl Device for Turning {
    fn handle(&mut self, _frame: &Frame, _now: Instant) {}

    fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        None
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }

    fn handle_timeout(&mut self, _now: Instant) {}

    fn advance_mechanics(&mut self, now: Instant) -> bool {
        while self.reached < now {
            self.reached += STEP;
            self.axis.advance(1, Demand::Velocity(50.0 * 4000.0 / std::f64::consts::TAU));
        }
        false
    }
}
