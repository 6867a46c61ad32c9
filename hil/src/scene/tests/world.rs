//! A robot whose drives are on a bus and on lines, in a world with a scene.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use can::{Frame, Instant, timing::Bitrate};
use canopen::NodeId;
use nalgebra::{Isometry3, Point3, Vector3};
use serial::{Line, Settings};

use crate::plant::{AxisConfig, Demand, FrictionConfig, Irp6Axis, Mechanism, MechanismConfig, PlantAxis, PlantConfig};
use crate::scene::{
    BodyConfig, CutterConfig, Material, RobotId, STEP, Scene, SceneError, SensorConfig, SensorProbe, Shape, TipConfig,
    WallConfig, WorkpieceConfig,
};
use crate::{
    AxisController, AxisControllerConfig, Device, Epos4, Epos4Config, InputProbe, SerialForceSensor,
    SerialForceSensorConfig, TransducerConfig, World,
};

/// An IRb-6 without power or brakes: two drives on one bus, one on another, two on lines. Its tip hangs 5 mm over a
/// floor.
fn world() -> (World, RobotId, SensorProbe) {
    world_with(|_, _| ())
}

/// The same with parts that `add` adds to the scene.
fn world_with(add: impl FnOnce(&mut Scene, RobotId)) -> (World, RobotId, SensorProbe) {
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
    add(&mut scene, robot);
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
fn touch_probe_is_actuated_at_its_threshold() {
    let (mut world, robot, sensor) = world();
    let scene = world.scene_mut().unwrap();
    let [switch, opener] = [true, false].map(|touched| {
        let input = InputProbe::default();
        scene.add_touch(robot, 5.0, touched, &input).unwrap();
        input
    });
    assert!(opener.level() && !switch.level());
    let mut has_closed = false;
    for step in 1..=5_000 {
        world.advance(Instant::ZERO + STEP * step);
        // The sensor has no mass beyond it: it measures the force on the tip only.
        let [x, y, z, ..] = sensor.last();
        assert_eq!(switch.level(), Vector3::new(x, y, z).norm() >= 5.0, "step {step}");
        assert_eq!(opener.level(), !switch.level());
        has_closed |= switch.level();
    }
    assert!(has_closed);
}

#[test]
fn touch_probe_without_a_threshold_is_refused() {
    let (mut world, robot, _) = world();
    for threshold in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refused = world.scene_mut().unwrap().add_touch(robot, threshold, true, &InputProbe::default()).err();
        assert!(matches!(refused, Some(SceneError::Threshold { .. })), "{threshold}: {refused:?}");
    }
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
fn cuts_do_not_depend_on_how_the_world_is_advanced() {
    let run = |micros: u64| {
        let mut board = None;
        let (mut world, robot, probe) = world_with(|scene, robot| {
            // The face is 2 mm below the end of the tool, which falls into the board.
            let end = scene.flange(robot) * Point3::new(0.0, 0.0, 0.2);
            let config = WorkpieceConfig {
                pose: Isometry3::translation(end.x, end.y, end.z - 2e-3),
                size: [0.02, 0.02, 0.01],
                cell: 2e-4,
                specific_force: WorkpieceConfig::FIBREBOARD_SPECIFIC_FORCE,
                edge_force: WorkpieceConfig::FIBREBOARD_EDGE_FORCE,
                material: Material::NOMINAL,
            };
            board = Some(scene.add_workpiece(&config).unwrap());
            let pose = Isometry3::translation(0.0, 0.0, 0.2);
            scene.add_cutter(robot, &CutterConfig { pose, diameter: 4e-3, turning_at: true }, None).unwrap();
        });
        let end = Instant::ZERO + Duration::from_millis(500);
        let mut now = Instant::ZERO;
        while now < end {
            now = (now + Duration::from_micros(micros)).min(end);
            world.advance(now);
        }
        let field = board.unwrap().field();
        assert!(field.removed() > 1e-9, "{} m³", field.removed());
        let flange = world.scene().unwrap().flange(robot).to_homogeneous().map(f64::to_bits);
        (flange, probe.last().map(f64::to_bits), field)
    };
    let once = run(500_000);
    for micros in [500_000, 1_370, 33] {
        assert!(run(micros) == once, "advanced by {micros} µs");
    }
}

#[test]
fn bodies_of_a_scene_that_is_set_later_begin_then() {
    let mut world = World::new();
    let at = |micros| Instant::ZERO + Duration::from_micros(micros);
    world.advance(at(1_000_030));
    let mut scene = Scene::new();
    let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.5 };
    let (pose, still) = (Isometry3::identity(), [0.0; 3]);
    let cube = BodyConfig { mass: 1.0, half: [0.05; 3], material, pose, velocity: still, spin: still };
    let cube = scene.add_body(&cube).unwrap();
    world.set_scene(scene);
    assert_eq!(world.scene().unwrap().now(), at(1_000_000));
    world.advance(at(1_100_000));
    let scene = world.scene().unwrap();
    assert_eq!(scene.now(), at(1_100_000));
    let height = scene.body(cube).pose.translation.z;
    assert!((height + 0.5 * 9.81 * 0.01).abs() < 1e-9, "{height}");
}

#[test]
fn motor_of_a_conveyor_carries_a_box() {
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let axis = AxisConfig { brake: 0.0, ..AxisConfig::irp6(Irp6Axis::Column) };
    let demand = Demand::Velocity(50.0 * 4000.0 / std::f64::consts::TAU);
    let mut motor = Driven { axis: PlantAxis::new(&axis, 1), demand, reached: Instant::ZERO };
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

#[test]
fn motor_advances_with_the_scene_until_its_last_belt_has_ended() {
    let axis = AxisConfig { brake: 0.0, ..AxisConfig::irp6(Irp6Axis::Column) };
    let shaft = PlantAxis::new(&axis, 1).probe();
    let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.5 };
    let wall = WallConfig { shape: Shape::HalfSpace, pose: Isometry3::identity(), material };
    let belts = || {
        let mut scene = Scene::new();
        let belts = [(); 2].map(|()| scene.add_wall(&wall).unwrap());
        belts.iter().for_each(|&belt| scene.drive_belt(belt, shaft.clone(), [0.0, 0.004, 0.0]));
        (scene, belts)
    };
    assert!(!shaft.in_scene());
    let (mut scene, [one, other]) = belts();
    scene.drive_belt(one, shaft.clone(), [0.0, 0.002, 0.0]);
    scene.set_belt(one, [0.0; 3]);
    assert!(shaft.in_scene(), "the other belt");
    // The next scene exists before the previous scene ends.
    let (next, _) = belts();
    scene.set_belt(other, [0.0; 3]);
    drop(scene);
    assert!(shaft.in_scene(), "the next scene");
    drop(next);
    assert!(!shaft.in_scene());
}

#[test]
fn force_sensor_at_a_line_sends_the_force_of_the_contact() {
    // The upper arm of an IRb-6 is level, and the other axes stand. Gears have no friction.
    let mechanism = Mechanism::new(MechanismConfig::Irb6);
    let mut axis = AxisConfig { start_angle: 0.0, brake: 0.0, ..AxisConfig::irp6(Irp6Axis::UpperArm).with_home(0.0) };
    let PlantConfig::Physical(plant) = &mut axis.plant else { unreachable!("the presets are physical") };
    plant.friction = FrictionConfig::NONE;
    plant.viscous = 0.0;
    plant.torque_ripple = 0.0;
    let axis = PlantAxis::mounted(&axis, 1, mechanism.mount(2, 0.0).as_ref());
    // 0.2 N·m more than the weight needs.
    let demand = Demand::Torque(0.2 - mechanism.load(2).torque);
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    world.add_device(bus, Box::new(Driven { axis, demand, reached: Instant::ZERO }));

    let mut scene = Scene::new();
    let robot = scene.add_robot(&mechanism, &Isometry3::identity()).unwrap();
    let tool = Vector3::new(0.0, 0.0, 0.1);
    scene.add_tip(robot, &TipConfig { centre: tool.into(), radius: 0.0 }).unwrap();
    let start = (scene.flange(robot) * Point3::from(tool)).z;
    let plane = start - 1e-3;
    let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.0 };
    let pose = Isometry3::translation(0.0, 0.0, plane);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material }).unwrap();
    let sensor = SensorConfig { pose: Isometry3::identity(), mass: 0.0, centre: [0.0; 3], inertia: [0.0; 3] };
    let probe = scene.add_sensor(robot, &sensor).unwrap();
    world.set_scene(scene);
    let config = SerialForceSensorConfig {
        greeting: "",
        ..SerialForceSensorConfig::new(TransducerConfig { range: [400.0; 6], ..TransducerConfig::default() })
    };
    let sensor = SerialForceSensor::new(config, Box::new(probe)).unwrap();
    let line = world.add_line(SerialForceSensor::SETTINGS, None, Box::new(sensor));
    let mut host = world.host_line(line, 64);

    let query = Instant::ZERO + Duration::from_millis(3_000);
    world.advance(query);
    host.write(query, b"q").unwrap();
    let end = query + Duration::from_millis(2);
    world.advance(end);
    let mut reply = [0; 64];
    assert_eq!(host.read(end, &mut reply), Ok(14));
    let count = |channel: usize| f64::from(i16::from_be_bytes([reply[2 * channel], reply[2 * channel + 1]]));
    let force = Vector3::new(count(0), count(1), count(2)) * (10.0 / 115.0);
    let torque = Vector3::new(count(3), count(4), count(5)) * (5.0 / 940.0);
    // Half a count of each channel.
    let near = |found: Vector3<f64>, expected: Vector3<f64>, count: f64| (found - expected).amax() < 0.51 * count;
    let flange = world.scene().unwrap().flange(robot);
    // The gear of 175.126:1 and the arm of 0.67 m turn 0.2 N·m into 52.3 N. The spring gives the same force.
    let pressed = 0.2 * 175.126 / 0.67;
    let depth = plane - (flange * Point3::from(tool)).z;
    assert!((1e5 * depth - pressed).abs() < 0.05, "{} N for {pressed}", 1e5 * depth);
    let expected = flange.rotation.inverse() * Vector3::new(0.0, 0.0, 1e5 * depth);
    assert!(near(force, expected, 10.0 / 115.0), "{force} for {expected}");
    let expected = tool.cross(&expected);
    assert!(near(torque, expected, 5.0 / 940.0), "{torque} for {expected}");
}

/// A motor with one demand and without a drive.
struct Driven {
    axis: PlantAxis,
    demand: Demand,
    reached: Instant,
}

impl Device for Driven {
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
            self.axis.advance(1, self.demand);
        }
        false
    }
}
