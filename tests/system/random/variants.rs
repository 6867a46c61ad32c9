//! Example cells with short programs, and with every key that a cell file can have.

use ::mrroc::cell::{
    Cell, Direction, DriveControl, EmergencyContact, EmulatedPayload, EmulatedTemperature, EmulatedTip, FieldContent,
    Frame, Instruction, JointGenerator, Joints, Law, LineInstruction, Parameter, Parameters, Protocol, SensorField,
    Weights,
};
use controller::robot::{Limits, LinkKind, Mass};
use hil::plant::Irp6Axis;
use kit::mrroc::{examples, shorten, text};
use servo::regulator::{IRP6, IRP6_DUTY, IncrementalConfig};

use super::verdict::{DCF, URDF};
use crate::host_closed::closed_by_host;

/// Examples of which every variant has further keys.
const WITH_KEYS: [&str; 9] = [
    "irb6-camera",
    "irb6",
    "irb6-serial",
    "irb6-hi-moxa",
    "irb6-wrist",
    "irb6-can-wrist",
    "irb6-milling",
    "irb6-sonar",
    "puma560",
];

/// The cells that are altered: examples with further keys, and all other examples.
pub(super) fn all() -> Vec<String> {
    let with_keys = [
        written("irb6", on_can),
        written("irb6", by_torque),
        written("irb6-serial", on_lines),
        written("irb6-hi-moxa", other_law),
        written("irb6-wrist", by_touch),
        written("irb6-can-wrist", by_frames),
        written("irb6-milling", by_spindle),
        written("irb6-sonar", by_echoes),
        written("irb6-camera", by_sight),
        written("lab", two_that_meet),
        written("puma560", by_frames_of_joints),
        written("puma560", by_coupled_motors),
        written("puma560", by_description),
    ];
    let others = examples().into_iter().filter(|name| !WITH_KEYS.contains(&name.as_str()));
    with_keys.into_iter().chain(others.map(|name| written(&name, |_| {}))).collect()
}

/// An example cell with a short program, changed by `change`, as text.
fn written(example: &str, change: impl FnOnce(&mut Cell)) -> String {
    let mut cell = Cell::parse(&text(example)).expect("the example cells are sound");
    shorten(&mut cell);
    for robot in &mut cell.robot {
        let arm = robot.arm().expect("the example cells are sound");
        let mut pose = arm.joints(&arm.robot().home().padded()).expect("home is a posture");
        pose[0] += if arm.axes() > 1 { 0.002 } else { 0.0001 };
        if robot.chain.is_none() {
            robot.parameters = Some(finite(robot.numbers()));
        }
        robot.program = vec![Instruction::Joints(Joints {
            poses: vec![pose[..arm.axes()].to_vec()],
            generator: JointGenerator::JerkLimited,
            velocity: 1.0,
            acceleration: 1.0,
            duration: Some(0.5),
        })];
    }
    change(&mut cell);
    toml::to_string(&cell).expect("a cell is TOML")
}

/// An arm by the frames of its joints, with a linear joint at its end.
fn by_frames_of_joints(cell: &mut Cell) {
    let chain = cell.robot[0].chain.as_mut().expect("the arm is a chain");
    chain.up = Some([0.0, 0.0, 1.0]);
    chain.free_axis = Some([0.0, 0.0, 1.0]);
    chain.link_from_flange = Some(Frame { xyz: [0.0, 0.0, 0.05], rpy: [0.0, 0.1, 0.0] });
    let first = &mut chain.joint[0];
    (first.dh, first.axis) = (None, Some([0.0, 0.0, 1.0]));
    first.origin = Some(Frame { xyz: [0.0, 0.0, 0.1], rpy: [0.0, 0.0, 0.1] });
    (first.joint_at_home, first.motor_at_home) = (Some(0.001), Some(0.1));
    let last = &mut chain.joint[5];
    (last.kind, last.limits) = (Some(LinkKind::Prismatic), Some(Limits { low: -0.1, high: 0.1 }));
    (last.ratio, last.lead) = (None, Some(0.01));
    (last.velocity, last.effort) = (Some(0.5), Some(200.0));
}

/// An arm whose motors are coupled.
fn by_coupled_motors(cell: &mut Cell) {
    let chain = cell.robot[0].chain.as_mut().expect("the arm is a chain");
    let ratios: Vec<f64> = chain.joint.iter_mut().map(|joint| joint.ratio.take().expect("a gear")).collect();
    let row = |number: usize| (0..6).map(|column| if column == number { ratios[number] } else { 0.0 }).collect();
    chain.motors_from_joints = Some((0..6).map(row).collect());
}

/// An arm from a description.
fn by_description(cell: &mut Cell) {
    let chain = cell.robot[0].chain.as_mut().expect("the arm is a chain");
    chain.urdf = Some(URDF.into());
    (chain.base, chain.flange) = (Some("base".into()), Some("flange".into()));
    for joint in &mut chain.joint {
        (joint.kind, joint.dh, joint.body) = (None, None, None);
    }
}

/// Adds every key that an arm on CAN may have.
fn on_can(cell: &mut Cell) {
    cell.realtime.margin = Some(std::time::Duration::from_micros(100));
    cell.bus[0].guarded = true;
    cell.realtime.cpu = Some(0);
    cell.realtime.spin_share = Some(0.2);
    let robot = &mut cell.robot[0];
    robot.tool = [0.0, 0.0, 0.1];
    let axis = &mut robot.axis[2];
    (axis.min_position, axis.max_position) = (Some(-70.0), Some(90.0));
    axis.homing.start_timeout_ms = Some(1_000);
    axis.emulator.vendor = Some(0xFB);
    axis.emulator.counts_per_revolution = Some(4000);
    axis.emulator.rated_torque = Some(0.42);
    let drive = axis.drive.as_mut().expect("a drive on CAN");
    (drive.product, drive.revision) = (Some(0x6150_0000), Some(0x0170_0000));
    drive.plausible_acceleration = Some(1e5);
    drive.max_torque = Some(2.0);
    drive.dcf = Some(DCF.into());
    drive.parameter = vec![Parameter { index: 0x6081, subindex: 0, value: 1_000, bytes: 4 }];
    drive.emergency_stop = Some(EmergencyContact { input: 16, emulated_edges_s: vec![1e5] });
    axis.emulator.revision = Some(0x0170_0000);
    robot.program.push(Instruction::Joints(Joints {
        poses: vec![vec![0.01, -1.57, 0.01, 0.0, 0.0], vec![0.0, -1.58, 0.0, 0.01, 0.01]],
        generator: JointGenerator::Newsmooth,
        velocity: 1.0,
        acceleration: 1.0,
        duration: None,
    }));
    let arm = robot.arm().expect("the example cells are sound");
    let there = [0.0, -1.6, 0.01, 0.01, 0.01, 0.0, 0.0, 0.0];
    let pose = arm.forward(&there).expect("a posture has a pose");
    let rotation = pose.rotation.quaternion();
    robot.program.push(Instruction::Line(LineInstruction {
        position: pose.translation.vector.into(),
        quaternion: Some([rotation.w, rotation.i, rotation.j, rotation.k]),
        velocity: 0.2,
        acceleration: 1.0,
        constant_speed: true,
    }));
    let payload = EmulatedPayload { at_s: 0.5, mass: 1.0, centre: [0.0, 0.0, 0.1] };
    robot.emulated_payload = vec![payload, EmulatedPayload { mass: 0.0, ..payload }];
}

/// Adds every key that a force sensor may have.
fn by_touch(cell: &mut Cell) {
    let sensor = &mut cell.force_sensor[0];
    sensor.quaternion = Some([1.0, 0.0, 0.0, 0.0]);
    (sensor.tool_inertia, sensor.tool_lag_s) = ([0.01, 0.01, 0.005], 0.003);
    sensor.max_offset = Some([20.0, 20.0, 20.0, 1.0, 1.0, 1.0]);
    (sensor.force_per_count, sensor.torque_per_count) = (Some(10.0 / 115.0), Some(5.0 / 940.0));
    sensor.emulator.silent_from_s = Some(1e5);
    (sensor.baud, sensor.rate_hz) = (Some(115_200), Some(1_000));
    sensor.emulator.drift = [0.1, 0.1, 0.1, 0.001, 0.001, 0.001];
    sensor.emulator.temperature = Some(EmulatedTemperature { start: 20.0, end: 30.0, time_constant_s: 60.0 });
    let scene = cell.scene.as_mut().expect("the cell has a table under the tool");
    scene.tip = vec![EmulatedTip { robot: scene.robot.take().expect("a robot touches the table"), radius: 0.0 }];
    cell.robot[0].axis[0].emulator.trips_at_s = Some(1e5);
}

/// Adds every key that a force sensor on a CAN bus may have.
fn by_frames(cell: &mut Cell) {
    let can = cell.force_sensor[0].can.as_mut().expect("a sensor on a CAN bus");
    (can.revision, can.device_type, can.event_timer_ms) = (Some(0x0001_0000), Some(0), Some(2));
    can.parameter = vec![Parameter { index: 0x2003, subindex: 0, value: 0, bytes: 1 }];
    can.pdo[0].cob_id = Some(0x190);
    let status = SensorField { index: 0x2002, subindex: 0, content: FieldContent::Status, bytes: 2, errors: Some(0) };
    can.pdo[0].field.push(status);
}

/// Adds every key that an emulated ultrasonic matrix may have.
fn by_echoes(cell: &mut Cell) {
    let matrix = &mut cell.ultrasonic[0];
    let emulator = &mut matrix.emulator;
    (emulator.noise, emulator.silent_from_s, emulator.size) = (Some(1e-3), Some(1e5), Some(matrix.size));
}

/// Adds every key that an emulated camera may have.
fn by_sight(cell: &mut Cell) {
    let camera = &mut cell.camera[0];
    let emulator = &mut camera.emulator;
    (emulator.silent_from_s, emulator.width, emulator.period_ms) =
        (Some(1e5), Some(camera.width), Some(camera.period_ms));
}

/// Adds every key that a cutting tool may have.
fn by_spindle(cell: &mut Cell) {
    let touch = Cell::parse(&text("irb6-touch")).expect("the example cells are sound");
    cell.io = touch.io;
    let scene = cell.scene.as_mut().expect("the example has a scene");
    scene.cutter[0].spindle = Some(cell.io[0].output[0].name.clone());
}

/// The parameters with finite joint limits, because a cell file cannot contain infinite limits.
fn finite(mut parameters: Parameters) -> Parameters {
    if let Parameters::Polycrank(polycrank) = &mut parameters {
        for axis in &mut polycrank.axes {
            (axis.joint_limits.low, axis.joint_limits.high) = (-10.0, 10.0);
            (axis.motor_limits.low, axis.motor_limits.high) = (-2_000.0, 2_000.0);
        }
    }
    parameters
}

/// Makes the host close the loops over CAN by torque.
fn by_torque(cell: &mut Cell) {
    cell.robot[0].weight = Some(Weights::default());
    for (number, kind) in Irp6Axis::ALL.into_iter().take(5).enumerate() {
        let axis = &mut cell.robot[0].axis[number];
        closed_by_host(axis, kind, DriveControl::Torque);
        let drive = axis.drive.as_mut().expect("a drive on CAN");
        let closed = drive.r#loop.as_mut().expect("a loop of the host");
        if number == 1 {
            closed.feed_forward.weight = Some(1.0);
            closed.feed_forward.stiction = Some(closed.feed_forward.coulomb);
            closed.feed_forward.stribeck_velocity = Some(1.0);
        }
        if number == 4 {
            let limit = drive.rated_torque;
            closed.law = incremental(&IRP6[4], limit);
        }
    }
}

/// Replaces the law of an axis controller by another than that of the example.
fn other_law(cell: &mut Cell) {
    let controller = cell.robot[0].axis[4].controller.as_mut();
    let controller = controller.expect("an axis controller");
    controller.r#loop.law = incremental(&IRP6_DUTY[4], 1.0);
}

/// The law of an IRp-6, with a smaller limit if necessary.
fn incremental(law: &IncrementalConfig, limit: f64) -> Law {
    Law::Incremental(IncrementalConfig { limit: law.limit.min(limit), ..*law })
}

/// Adds every key that an arm on serial lines may have.
fn on_lines(cell: &mut Cell) {
    cell.serial[0].emulated_latency_ms = Some(1);
    cell.guardian_ms = Some(9);
    cell.watchdog = Some("/dev/watchdog".into());
    let robot = &mut cell.robot[0];
    let load = Mass { mass: 1.0, centre: [0.0, 0.0, 0.1] };
    let numbers = robot.numbers();
    robot.weight = Some(Weights { masses: Some(numbers.masses()), load, up: Some(numbers.up()) });
    robot.axis[0].homing.direction = Some(Direction::Negative);
    robot.axis[0].homing.reverse_at_limit = Some(true);
    robot.axis[1].emulator.address = Some(robot.axis[1].node);
    robot.axis[1].emulator.protocol = Some(Protocol::Nfv2);
    let controller = robot.axis[4].controller.as_mut();
    let controller = controller.expect("an axis controller");
    controller.plausible_velocity = Some(1000.0);
    controller.plausible_acceleration = Some(1e6);
    controller.r#loop.runaway_velocity = Some(1000.0);
    let feed_forward = &mut controller.r#loop.feed_forward;
    feed_forward.weight = Some(1.0);
    feed_forward.stiction = Some(feed_forward.coulomb);
    feed_forward.stribeck_velocity = Some(1.0);
}

/// The gripper and the conveyor alone, which meet.
fn two_that_meet(cell: &mut Cell) {
    cell.robot.retain(|robot| robot.axis.len() == 1);
    let used = |bus: &str| cell.robot.iter().any(|robot| robot.axis[0].bus == bus);
    cell.bus.retain(|bus| used(&bus.name));
    cell.serial.clear();
    for robot in &mut cell.robot {
        robot.program.insert(0, Instruction::Meet("start".into()));
    }
}
