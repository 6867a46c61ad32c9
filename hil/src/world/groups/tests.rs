//! Tests of robots that a world advances one after the other, or by several threads.

use std::f64::consts::PI;
use std::time::Duration;

use can::{Instant, timing::Bitrate};
use canopen::NodeId;
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use serial::nfv2::{Command, FrameBuilder, Mode};
use serial::{Line, Settings, VirtualLine};

use crate::plant::{AxisConfig, Irp6Axis, Mechanism, MechanismConfig};
use crate::scene::{BodyConfig, Material, RobotId, Scene, SensorConfig, Shape, TipConfig, WallConfig};
use crate::{
    AxisController, AxisControllerConfig, Cabinet, Device, DigitalIo, DigitalIoConfig, DriveId, Epos4, Epos4Config,
    Helpers, LightGate, LineId, SerialForceSensor, SerialForceSensorConfig, TransducerConfig, World,
};

/// An IRb-6 and a second robot without power or brakes over a floor, each with a force sensor at a line. The drives of
/// the first are on two buses. The second bus has the drives of both robots if `shared`.
struct Fallen {
    world: World,
    robots: [RobotId; 2],
    lines: [VirtualLine; 2],
}

const RNT: MechanismConfig = MechanismConfig::Rnt { home_lengths: [AxisConfig::RNT_HOME_LENGTH; 3] };

impl Fallen {
    fn new(second: MechanismConfig, shared: bool, add: impl FnOnce(&mut Scene)) -> Self {
        let mut world = World::new();
        let buses = [(); 3].map(|()| world.add_bus(Bitrate::KBPS_1000));
        let mut scene = Scene::new();
        scene.add_wall(&floor()).unwrap();
        let arms = [MechanismConfig::Irb6, second].map(|config| (config.clone(), Mechanism::new(config)));
        let arms = [0, 1].map(|arm: usize| {
            let (config, mechanism) = &arms[arm];
            for number in 0..mechanism.axes() {
                let axis = match config {
                    MechanismConfig::Irb6 => irb6_axis(number),
                    _ => AxisConfig { brake: 0.0, ..AxisConfig::rnt(number).unwrap() },
                };
                let bus = if arm == 0 { number % 2 } else { 2 - usize::from(shared && number == 3) };
                let node = NodeId::new((10 * arm + number + 1) as u8).unwrap();
                let mount = mechanism.mount(number, 0.0);
                let drive = Epos4::new(Epos4Config { mount, ..Epos4Config::new(node, axis) });
                assert!(drive.plant().is_some_and(|plant| plant.mechanism().is_some_and(|it| it.is(mechanism))));
                world.add_device(buses[bus], Box::new(drive));
            }
            let mut base = Isometry3::translation(0.0, 3.0 * arm as f64, 0.0);
            if *config == RNT {
                // The platform hangs, and a load beside its axis inclines the platform.
                base = Isometry3::from_parts(
                    Translation3::new(0.0, 3.0, 1.5),
                    UnitQuaternion::from_euler_angles(PI, 0.0, 0.0),
                );
                mechanism.set_payload(60.0, [0.1, 0.05, 0.1]);
            }
            let robot = scene.add_robot(mechanism, &base).unwrap();
            scene.add_tip(robot, &TipConfig { centre: [0.0, 0.0, 0.2], radius: 0.01 }).unwrap();
            let config = SensorConfig { pose: Isometry3::identity(), mass: 1.0, centre: [0.0; 3], inertia: [0.1; 3] };
            (robot, scene.add_sensor(robot, &config).unwrap())
        });
        add(&mut scene);
        world.set_scene(scene);
        let robots = [0, 1].map(|arm| arms[arm].0);
        let lines = arms.map(|(_, probe)| {
            let transducer = TransducerConfig { range: [4000.0; 6], ..TransducerConfig::default() };
            let sensor = SerialForceSensor::new(SerialForceSensorConfig::new(transducer), Box::new(probe)).unwrap();
            let line = world.add_line(SerialForceSensor::SETTINGS, None, Box::new(sensor));
            world.host_line(line, 256)
        });
        Self { world, robots, lines }
    }

    /// Falls for some seconds in intervals of 2 ms: the bytes of the sensors, the bits of the flanges, and the number of
    /// groups.
    fn run(mut self) -> (Vec<u8>, Vec<u64>, usize) {
        let (mut bytes, mut bits) = (Vec::new(), Vec::new());
        for cycle in 0..1_500_u32 {
            let now = Instant::ZERO + cycle * Duration::from_millis(2);
            self.world.advance(now);
            for line in &mut self.lines {
                let mut reply = [0; 64];
                let count = line.read(now, &mut reply).unwrap();
                bytes.extend(&reply[..count]);
                line.write(now, b"q").unwrap();
            }
            let scene = self.world.scene().unwrap();
            let flanges = self.robots.map(|robot| scene.flange(robot).to_homogeneous().map(f64::to_bits));
            bits.extend(flanges.iter().flatten());
        }
        (bytes, bits, groups_of(&self.world))
    }
}

fn groups_of(world: &World) -> usize {
    world.groups.as_ref().map_or(0, |groups| groups.groups.len())
}

fn floor() -> WallConfig {
    let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.3 };
    WallConfig { shape: Shape::HalfSpace, pose: Isometry3::translation(0.0, 0.0, 0.1), material }
}

/// An axis without a brake, at home.
fn irb6_axis(number: usize) -> AxisConfig {
    AxisConfig { start_angle: 0.0, brake: 0.0, ..AxisConfig::irp6(Irp6Axis::ALL[number]).with_home(0.0) }
}

/// A body that no robot reaches. It makes the world advance all devices together.
fn distant_body() -> BodyConfig {
    BodyConfig {
        mass: 1.0,
        half: [0.1; 3],
        material: Material { stiffness: 1e5, damping: 300.0, friction: 0.3 },
        pose: Isometry3::translation(50.0, 0.0, 5e3),
        velocity: [0.0; 3],
        spin: [0.0; 3],
    }
}

#[test]
fn robots_that_do_not_meet_move_as_if_all_devices_advanced_together() {
    let cases = [(MechanismConfig::Irb6, false), (MechanismConfig::Irb6, true), (RNT, false)];
    for (second, shared) in cases {
        let separate = Fallen::new(second.clone(), shared, |_| ());
        let (bytes, bits, groups) = separate.run();
        // A bus with drives of both robots joins their groups.
        assert_eq!(groups, if shared { 1 } else { 2 }, "shared: {shared}");
        let together = Fallen::new(second.clone(), shared, |scene| _ = scene.add_body(&distant_body()).unwrap());
        assert!(bytes.len() > 2 * 1_000 * 14, "{} bytes", bytes.len());
        let (together_bytes, together_bits, groups) = together.run();
        assert_eq!(groups, 1);
        let first = bits.iter().zip(&together_bits).position(|(one, other)| one != other);
        assert_eq!(first.map(|bit| bit / 32), None, "cycle in which a flange differs, {second:?}, shared: {shared}");
        assert!(bytes == together_bytes, "{second:?}, shared: {shared}");
    }
}

#[test]
fn threads_that_share_the_work_change_nothing() {
    let alone = Fallen::new(RNT, false, |_| ()).run();
    let mut helped = Fallen::new(RNT, false, |_| ());
    helped.world.set_helpers(Helpers::of_this_thread(2).unwrap());
    helped.world.advance(Instant::ZERO);
    let groups = helped.world.groups.as_ref().unwrap().groups.iter();
    assert!(groups.map(|group| group.thread).eq([2, 1]), "each robot has a thread");
    assert!(helped.run() == alone);
    assert!(Helpers::of_this_thread(1).is_err(), "a thread has helpers once");
    // Another thread has no helpers.
    let mut moved = Fallen::new(RNT, false, |_| ());
    let run = std::thread::spawn(|| {
        let other = std::thread::spawn(|| Helpers::of_this_thread(2).unwrap()).join().unwrap();
        moved.world.set_helpers(other);
        moved.run()
    });
    assert!(run.join().unwrap() == alone);
}

/// Two robots in a scene, of one motor each. Their axis controllers are on two lines, in one cabinet.
fn cabinet_of_two_robots(with_body: bool) -> (World, [LineId; 2], [VirtualLine; 2]) {
    let mut world = World::new();
    let mut scene = Scene::new();
    let cabinet = Cabinet::default();
    let lines = [0, 1].map(|arm| {
        let mechanism = Mechanism::new(MechanismConfig::Irb6);
        let mount = mechanism.mount(0, 0.0);
        let config =
            AxisControllerConfig { mount, cabinet: cabinet.clone(), ..AxisControllerConfig::new(irb6_axis(0)) };
        scene.add_robot(&mechanism, &Isometry3::translation(0.0, 3.0 * f64::from(arm), 0.0)).unwrap();
        world.add_line(Settings::AXIS_CONTROLLER, None, Box::new(AxisController::nfv2(ADDRESS, &config)))
    });
    if with_body {
        scene.add_body(&distant_body()).unwrap();
    }
    world.set_scene(scene);
    let hosts = lines.map(|line| world.host_line(line, 256));
    (world, lines, hosts)
}

const ADDRESS: u8 = 8;

#[test]
fn emergency_stop_of_a_cabinet_of_two_robots_is_as_if_all_devices_advanced_together() {
    let command = |host: &mut VirtualLine, at: Instant, commands: &[Command]| {
        let mut frame = FrameBuilder::new(ADDRESS);
        commands.iter().for_each(|command| _ = frame.command(*command));
        host.write(at, frame.finish().unwrap()).unwrap();
    };
    let ms = |count| Instant::ZERO + Duration::from_millis(count);
    let run = |with_body, closes| {
        let (mut world, lines, [mut first, mut second]) = cabinet_of_two_robots(with_body);
        command(&mut first, ms(0), &[Command::SetMode(Mode::Pwm), Command::SetPwm(30)]);
        world.advance(ms(200));
        let angle = |world: &World| world.plant(DriveId::Line(lines[0])).unwrap().angle();
        let start = angle(&world);
        // The second drive opens the stop, and closes the stop in the same interval.
        command(&mut second, ms(203), &[Command::SetMode(Mode::Error)]);
        if closes {
            command(&mut second, ms(208), &[Command::SetMode(Mode::Manual)]);
        }
        let angles = [220, 1_000, 1_100].map(|end| {
            world.advance(ms(end));
            angle(&world)
        });
        assert!(start > 0.1, "{start} rad");
        (angles, groups_of(&world))
    };
    for closes in [false, true] {
        let (separate, groups) = run(false, closes);
        let (together, _) = run(true, closes);
        assert!(together[2] - together[1] < 1e-3, "the motor has no power: {together:?}, closes: {closes}");
        assert_eq!(separate.map(f64::to_bits), together.map(f64::to_bits), "{separate:?} {together:?}");
        assert_eq!(groups, 1);
    }
}

#[test]
fn robot_outside_the_scene_with_drives_on_buses_and_a_line_moves_as_if_all_devices_advanced_together() {
    let run = |with_body| {
        let mut world = World::new();
        let buses = [(); 2].map(|()| world.add_bus(Bitrate::KBPS_1000));
        let mechanism = Mechanism::new(MechanismConfig::Irb6);
        // Lower arm, upper arm and wrist fall.
        let drives = [1, 2, 3].map(|number| {
            let (axis, mount) = (irb6_axis(number), mechanism.mount(number, 0.0));
            if number == 3 {
                let config = AxisControllerConfig { mount, ..AxisControllerConfig::new(axis) };
                let device = Box::new(AxisController::nfv2(ADDRESS, &config));
                return DriveId::Line(world.add_line(Settings::AXIS_CONTROLLER, None, device));
            }
            let config = Epos4Config { mount, ..Epos4Config::new(NodeId::new(1).unwrap(), axis) };
            DriveId::Node(world.add_device(buses[number - 1], Box::new(Epos4::new(config))))
        });
        let mut scene = Scene::new();
        if with_body {
            scene.add_body(&distant_body()).unwrap();
        }
        world.set_scene(scene);
        let mut angles = Vec::new();
        for cycle in 1..=20_u32 {
            world.advance(Instant::ZERO + cycle * Duration::from_millis(100));
            angles.extend(drives.map(|drive| world.plant(drive).unwrap().angle()));
        }
        (angles, groups_of(&world))
    };
    let ((separate, groups), (together, _)) = (run(false), run(true));
    assert!(together[together.len() - 2].abs() > 0.1, "{together:?}");
    assert_eq!(separate, together);
    assert_eq!(groups, 1);
}

#[test]
fn light_gate_that_reads_a_shaft_on_another_bus_lets_all_devices_advance_together() {
    let mut world = World::new();
    let buses = [(); 2].map(|()| world.add_bus(Bitrate::KBPS_1000));
    let mut drive = Epos4::new(Epos4Config::new(NodeId::new(1).unwrap(), irb6_axis(0)));
    let gate = LightGate { index: 0, probe: drive.probe(), zero_angle: 0.0, ratio: 1.0, interval: 1.0..=2.0 };
    let config = DigitalIoConfig { light_gates: vec![gate], ..DigitalIoConfig::new(NodeId::new(2).unwrap()) };
    world.add_device(buses[0], Box::new(drive));
    world.add_device(buses[1], Box::new(DigitalIo::new(config).unwrap()));
    world.set_scene(Scene::new());
    world.advance(Instant::ZERO + Duration::from_millis(1));
    assert_eq!(groups_of(&world), 1);
}

#[test]
fn a_scene_without_robots_and_buses_keeps_the_time_of_its_world() {
    let mut world = World::new();
    world.set_scene(Scene::new());
    let start = Instant::ZERO + Duration::from_secs(10);
    world.advance(start);
    assert_eq!(world.scene().unwrap().now(), start);
    let body = world.scene_mut().unwrap().add_body(&distant_body()).unwrap();
    world.advance(start + Duration::from_millis(1));
    let velocity = world.scene().unwrap().body(body).velocity;
    assert!((velocity.z + 9.81e-3).abs() < 1e-9, "{velocity}");
}
