//! Speed of the emulation of a robot of six axes on one bus of 1 Mbit/s, in cyclic position mode every 2 ms.
//!
//! One iteration simulates one second, so the reciprocal of its duration is the number of simulated seconds per
//! second.

use std::hint::black_box;
use std::time::Duration;

use can::timing::Bitrate;
use can::{Frame, Instant, Port, Received, VirtualPort};
use canopen::objects as named;
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoNumber};
use canopen::sdo::{Expedited, Initiate, Request};
use canopen::{NodeId, Object, cob, nmt};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_hil::scene::{BodyConfig, GripConfig, Holder, Material, RobotId, Scene, Shape, TipConfig, WallConfig};
use mrroc_hil::{AxisConfig, Epos4, Epos4Config, Irp6Axis, Mechanism, MechanismConfig, World};
use nalgebra::{Isometry3, Point3};

const PERIOD: Duration = Duration::from_millis(2);

type Axes = fn(Irp6Axis) -> AxisConfig;

struct Robot {
    world: World,
    port: VirtualPort,
    nodes: Vec<NodeId>,
    now: Instant,
    cycle: u32,
    /// Amplitude of the set-points, counts.
    amplitude: f64,
}

/// The surroundings of the robot.
#[derive(Clone, Copy)]
enum Around {
    /// Each motor carries its own load.
    NoMechanism,
    Mechanism,
    /// The robot is in a scene and touches nothing.
    Scene,
    /// The tip presses on a floor.
    Floor,
    /// The gripper holds a bar, whose other end a clamp holds.
    Bar,
}

fn scene(mechanism: &Mechanism, around: Around) -> Scene {
    let mut scene = Scene::new();
    let metal = Material::NOMINAL;
    let robot: RobotId = scene.add_robot(mechanism, &Isometry3::identity()).expect("it stands");
    let tip = scene.flange(robot) * Point3::new(0.0, 0.0, 0.25);
    match around {
        Around::Floor => {
            scene.add_tip(robot, &TipConfig { centre: [0.0, 0.0, 0.25], radius: 5e-3 }).expect("it is a tip");
            let pose = Isometry3::translation(0.0, 0.0, tip.z - 5e-3 + 1e-4);
            scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material: metal }).expect("it is a floor");
        }
        Around::Bar => {
            let pose = Isometry3::translation(tip.x, tip.y, tip.z);
            let still = [0.0; 3];
            let bar =
                BodyConfig { mass: 3.0, half: [0.3, 0.02, 0.02], material: metal, pose, velocity: still, spin: still };
            let bar = scene.add_body(&bar).expect("it is a bar");
            let gripper = Isometry3::translation(0.0, 0.0, 0.25);
            let grip = GripConfig::NOMINAL;
            scene.hold(&grip, Holder::Robot(robot), &gripper, bar, None).expect("it holds");
            scene.hold(&grip, Holder::World, &pose, bar, None).expect("it holds");
        }
        Around::NoMechanism | Around::Mechanism | Around::Scene => {}
    }
    scene
}

impl Robot {
    fn new(axis: Axes, around: Around) -> Self {
        let mut world = World::new();
        let mechanism = Mechanism::new(MechanismConfig::Irp6);
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let nodes: Vec<_> = NodeId::all().take(Irp6Axis::ALL.len()).collect();
        for (number, (&node, which)) in nodes.iter().zip(Irp6Axis::ALL).enumerate() {
            let axis = axis(which);
            let mount = match around {
                Around::NoMechanism => None,
                _ => mechanism.mount(number, axis.start_angle),
            };
            let device = Epos4::new(Epos4Config { mount, ..Epos4Config::new(node, axis) });
            world.add_device(bus, Box::new(device));
        }
        if matches!(around, Around::Scene | Around::Floor | Around::Bar) {
            world.set_scene(scene(&mechanism, around));
        }
        // 1000 counts move the gripper by some millimetres, against springs of 1e5 N/m.
        let amplitude = if matches!(around, Around::Bar) { 20.0 } else { 1000.0 };
        let mut robot = Self { world, port, nodes, now: Instant::ZERO, cycle: 0, amplitude };
        robot.run(Duration::from_millis(100));
        for node in robot.nodes.clone() {
            robot.configure(node);
        }
        robot.send(&[nmt::Command::Start.to_all().encode()]);
        robot
    }

    fn configure(&mut self, node: NodeId) {
        let one = PdoNumber::One;
        let map = |kind: PdoKind, sub| kind.mapping(one, sub);
        let (rx, tx) = (PdoKind::Rpdo, PdoKind::Tpdo);
        let cob = |kind: PdoKind| kind.communication(one, 1);
        let received = PdoCobId::new(cob::rpdo(one, node));
        let transmitted = PdoCobId::new(cob::tpdo(one, node)).without_rtr();
        let entry = |object, bits| Entry::new(object, bits).raw();
        let writes: [(Object, u32, usize); 22] = [
            (cob(rx), received.invalid().0, 4),
            (map(rx, 0), 0, 1),
            (map(rx, 1), entry(named::CONTROLWORD, 16), 4),
            (map(rx, 2), entry(named::TARGET_POSITION, 32), 4),
            (map(rx, 0), 2, 1),
            (rx.communication(one, 2), 1, 1),
            (cob(rx), received.0, 4),
            (cob(tx), transmitted.invalid().0, 4),
            (map(tx, 0), 0, 1),
            (map(tx, 1), entry(named::STATUSWORD, 16), 4),
            (map(tx, 2), entry(named::POSITION_ACTUAL, 32), 4),
            (map(tx, 3), entry(named::TORQUE_ACTUAL, 16), 4),
            (map(tx, 0), 3, 1),
            (tx.communication(one, 2), 1, 1),
            (cob(tx), transmitted.0, 4),
            (named::INTERPOLATION_PERIOD_VALUE, 2, 1),
            (named::FOLLOWING_ERROR_WINDOW, 1_000_000, 4),
            (named::MODE_OF_OPERATION, 8, 1),
            (named::CONTROLWORD, 0x06, 2),
            (named::CONTROLWORD, 0x07, 2),
            (named::CONTROLWORD, 0x0F, 2),
            (named::PRODUCER_HEARTBEAT, 100, 2),
        ];
        for (object, value, bytes) in writes {
            let data = Expedited::new(&value.to_le_bytes()[..bytes]).expect("1 to 4 bytes");
            let initiate = Initiate::Expedited(data);
            self.send(&[Request::InitiateDownload { object, initiate }.encode(node)]);
        }
    }

    fn send(&mut self, frames: &[Frame]) {
        self.port.send(self.now, frames).expect("the bus is there");
        self.run(PERIOD);
    }

    /// Returns the number of axes whose answers report them enabled.
    fn run(&mut self, duration: Duration) -> usize {
        self.now += duration;
        self.world.advance(self.now);
        let nothing = Received { frame: Frame::new(cob::SYNC, &[]).expect("no bytes"), at: self.now };
        let mut into = [nothing; 64];
        let count = self.port.receive(self.now, &mut into).expect("the bus is there");
        let enabled = |received: &&Received| match received.frame.data() {
            &[low, _, _, _, _, _, _, _] => low & 0x6F == 0x27,
            _ => false,
        };
        into[..count].iter().filter(enabled).count()
    }

    /// One cycle: SYNC, six set-points on a slow sine, six answers.
    fn step(&mut self) -> usize {
        self.cycle += 1;
        let angle = f64::from(self.cycle) * PERIOD.as_secs_f64();
        let target = (self.amplitude * angle.sin()) as i32;
        let mut frames = [Frame::new(cob::SYNC, &[]).expect("no bytes"); 7];
        for (frame, &node) in frames[1..].iter_mut().zip(&self.nodes) {
            let [a, b, c, d] = target.to_le_bytes();
            let data = [0x0F, 0x00, a, b, c, d];
            *frame = Frame::new(cob::rpdo(PdoNumber::One, node), &data).expect("six bytes");
        }
        self.port.send(self.now, &frames).expect("the bus is there");
        self.run(PERIOD)
    }
}

fn second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("six axes, 2 ms, one simulated second");
    group.throughput(Throughput::Elements(500));
    let robots: [(&str, Axes, Around); 6] = [
        ("motors", AxisConfig::irp6, Around::NoMechanism),
        ("regression model", AxisConfig::wut, Around::NoMechanism),
        ("mechanism", AxisConfig::irp6, Around::Mechanism),
        ("scene", AxisConfig::irp6, Around::Scene),
        ("tip on a floor", AxisConfig::irp6, Around::Floor),
        ("bar in a gripper and a clamp", AxisConfig::irp6, Around::Bar),
    ];
    for (name, axis, around) in robots {
        let mut robot = Robot::new(axis, around);
        for _ in 0..3 {
            robot.step();
        }
        assert_eq!(robot.step(), robot.nodes.len(), "every axis is enabled");
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                for _ in 0..500 {
                    black_box(robot.step());
                }
            });
        });
        assert_eq!(robot.step(), robot.nodes.len(), "every axis still is");
    }
    group.finish();
}

criterion_group!(benches, second);
criterion_main!(benches);
