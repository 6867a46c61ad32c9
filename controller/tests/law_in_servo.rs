//! A force law in the servo: contact with a spring, and a path that ends at a touch.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::wrench::RehearsedWrench;
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint};
use mrroc_controller::force::Wrench;
use mrroc_controller::law::{
    Compliance, Direction, ForceLimits, ForceTask, Guard, PositionForce, PositionForceConfig, TaskAxes,
};
use mrroc_controller::robot::{Arm, Axes, Irb6, Irb6Parameters, Pose};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use servo::{
    EffectorConfig, EffectorLink, LawBound, MAX_AXES, Macrostep, Order, Phase, PositionLoop, Servo, ServoAxisConfig,
    ServoConfig, StopCause,
};

const PERIOD: Duration = Duration::from_millis(2);
const AXES: usize = 5;
const START: Axes = [0.3, -FRAC_PI_2, 0.1, FRAC_PI_2, 0.4, 0.0, 0.0, 0.0];

/// The force of the spring on the tool in the last cycle, N.
type Force = Arc<Mutex<f64>>;

/// Ideal drives of an IRb-6, and the force sensor in its wrist. A spring is below the height `z`.
struct Cell {
    arm: Arm,
    sensor: RehearsedWrench,
    force: Force,
    stiffness: f64,
    z: f64,
    seen: [AxisState; AXES],
    pending: [f64; AXES],
    actual: [f64; AXES],
}

impl DriveGroup for Cell {
    fn axes(&self) -> usize {
        AXES
    }
    fn delay(&self) -> usize {
        2
    }
    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }
    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        states.copy_from_slice(&self.seen);
        let mut motors = [0.0; MAX_AXES];
        motors.iter_mut().zip(&self.seen).for_each(|(motor, state)| *motor = state.position);
        let tool = self.arm.forward(&self.arm.joints(&motors).expect("a posture")).expect("a posture");
        let force = (self.stiffness * (self.z - tool.translation.z)).max(0.0);
        *self.force.lock().expect("no panic") = force;
        let push = Wrench { force: Vector3::z() * force, torque: Vector3::zeros() };
        let at_tool = Isometry3::from_parts(tool.translation, UnitQuaternion::identity());
        // Without a tool, the sensor is at the tool.
        self.sensor.advance(now, push.seen_from(&(tool.inverse() * at_tool)).components());
    }
    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        for (pending, command) in self.pending.iter_mut().zip(commands) {
            if let AxisCommand::Follow(Setpoint::Position(position)) = command {
                *pending = position.get();
            }
        }
    }
    fn send(&mut self, _: Instant) -> bool {
        self.seen.iter_mut().zip(self.actual).for_each(|(seen, actual)| seen.position = actual);
        self.actual = self.pending;
        true
    }
    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

struct Rig {
    servo: Servo,
    link: EffectorLink,
    arm: Arm,
    force: Force,
    now: Instant,
}

impl Rig {
    /// Standing with the tool at the given height above the spring.
    fn new(above: f64, stiffness: f64) -> Self {
        let arm = Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).expect("consistent")), Pose::identity());
        let axis = |index_in_group| ServoAxisConfig {
            group: 0,
            index_in_group,
            min_position: -500.0,
            max_position: 500.0,
            max_velocity: 250.0,
            max_acceleration: 1500.0,
            planned_jerk: 7500.0,
            following_error: 1.0,
            homing_order: 0,
            increments_per_radian: 4000.0 / TAU,
            position_loop: PositionLoop::Drive,
            torque_offset: None,
            homing: None,
            frozen: servo::FrozenWatch::Always,
            brake_watch: true,
        };
        let effector = EffectorConfig {
            name: "arm".into(),
            axes: (0..AXES).map(axis).collect(),
            queue: 64,
            enabling_timeout: Duration::from_secs(1),
            homing_timeout: Duration::from_secs(1),
        };
        let config = ServoConfig { period: PERIOD, max_missed_in_row: 3, effectors: vec![effector] };
        let motors = arm.motors(&START).expect("within the limits");
        let at = |motor: f64| AxisState {
            position: motor,
            power: Power::On,
            homing: Homing::Attained,
            following: true,
            ..AxisState::default()
        };
        let positions: [f64; AXES] = std::array::from_fn(|axis| motors[axis]);
        let (sensor, link) = RehearsedWrench::new();
        let force = Force::default();
        let z = arm.forward(&START).expect("a posture").translation.z - above;
        let cell = Cell {
            arm: arm.clone(),
            sensor,
            force: Arc::clone(&force),
            stiffness,
            z,
            seen: positions.map(at),
            pending: positions,
            actual: positions,
        };
        let limits = ForceLimits {
            wrench: [150.0; 6],
            age: 3 * PERIOD,
            speed: [50.0; MAX_AXES],
            acceleration: [700.0; MAX_AXES],
        };
        let law = PositionForceConfig {
            arm: arm.clone(),
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor: Pose::identity(),
            load: None,
            lag: Duration::ZERO,
            zeroed: None,
            payload: None,
            limits,
        };
        let law = PositionForce::new(law, link).expect("the limits are sound");
        let (mut servo, mut links) = Servo::new(&config, vec![Box::new(cell)]).expect("the configuration is sound");
        let bounds = [LawBound { displacement: 100.0, speed: 60.0 }; AXES];
        servo.install_law(0, Box::new(law), &bounds).expect("the bounds are sound");
        let mut rig = Self { servo, link: links.remove(0), arm, force, now: Instant::ZERO };
        rig.link.orders.push(Order::Enable).expect("the queue is empty");
        (0..10).for_each(|_| rig.cycle());
        assert_eq!(rig.phase(), Phase::Standing);
        rig
    }

    fn cycle(&mut self) {
        self.servo.step(self.now);
        self.now += PERIOD;
        while self.link.reports.pop().is_ok() {}
    }

    fn phase(&self) -> Phase {
        self.link.latest.read().phase
    }

    fn cause(&self) -> Option<StopCause> {
        self.servo.fault(0).map(|fault| fault.cause)
    }

    fn force(&self) -> f64 {
        *self.force.lock().expect("no panic")
    }

    fn commanded(&self) -> Pose {
        let motors = self.link.latest.read().commanded;
        self.arm.forward(&self.arm.joints(&motors).expect("a posture")).expect("a posture")
    }

    /// Queues a macrostep of 10 periods to these motor positions.
    fn order(&mut self, number: u64, position: Axes, velocity: Axes, task: ForceTask) {
        let macrostep = Macrostep {
            number,
            steps: 10,
            report_at: 8,
            position,
            velocity,
            acceleration: None,
            torque: [0.0; MAX_AXES],
            law: Some(task.into()),
            continues_law: false,
        };
        self.link.orders.push(Order::Move(macrostep)).expect("there is room");
    }
}

#[test]
fn the_servo_holds_a_force_on_a_stiff_spring_and_stands_there_at_the_end() {
    let mut rig = Rig::new(0.002, 1e4);
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[2] = Direction::Contact { force: -10.0, compliance: Compliance::LINEAR };
    let start = rig.link.latest.read().commanded;
    let above = rig.commanded();
    for number in 1..=150 {
        rig.order(number, start, [0.0; MAX_AXES], task);
        (0..10).for_each(|_| rig.cycle());
        assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None), "{number}");
    }
    assert!((rig.force() - 10.0).abs() < 0.1, "{} N", rig.force());
    let displaced = rig.link.latest.read();
    assert!(displaced.displacement[1].abs() > 0.1, "{displaced:?}");
    (0..20).for_each(|_| rig.cycle());
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
    assert!((rig.force() - 10.0).abs() < 0.1, "{} N", rig.force());
    let moved = rig.commanded().translation.vector - above.translation.vector;
    assert!((moved - Vector3::new(0.0, 0.0, -0.003)).norm() < 5e-5, "{moved}");
}

#[test]
fn a_path_ends_at_the_touch_with_the_force_of_its_stop() {
    let mut rig = Rig::new(0.01, 1e4);
    let task = ForceTask { guard: Some(Guard { force: 2.0, torque: 5.0, samples: 1 }), ..ForceTask::default() };
    let start = rig.link.latest.read().commanded;
    let pose = rig.commanded();
    let mut near = START;
    let mut at = |down: f64| {
        let below = Isometry3::from_parts((pose.translation.vector - Vector3::z() * down).into(), pose.rotation);
        near = rig.arm.inverse(&below, &near).expect("within reach");
        rig.arm.motors(&near).expect("within the limits")
    };
    // 20 mm at 50 mm/s, with an acceleration of 0.25 m/s² at the beginning.
    let way = |t: f64| if t < 0.2 { 0.125 * t * t } else { 0.005 + 0.05 * (t - 0.2) };
    let ends: Vec<(Axes, Axes)> = (1..=24)
        .map(|number| {
            let t = 0.02 * f64::from(number);
            let [before, here, after] = [at(way(t - 1e-4)), at(way(t)), at(way(t + 1e-4))];
            (here, std::array::from_fn(|axis| (after[axis] - before[axis]) / 2e-4))
        })
        .collect();
    for ((position, velocity), number) in ends.into_iter().zip(1..) {
        rig.order(number, position, velocity, task);
    }
    let mut peak = 0.0_f64;
    let mut last = rig.force();
    for _ in 0..300 {
        rig.cycle();
        peak = peak.max(rig.force());
        if last <= 2.0 && rig.force() > 2.0 {
            assert_eq!((rig.phase(), rig.cause()), (Phase::Stopping, Some(StopCause::Touched)));
        }
        last = rig.force();
    }
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, Some(StopCause::Touched)));
    assert_ne!(rig.link.latest.read().commanded, start);
    // At 50 mm/s, the tool moves 0.1 mm per period, which is 1 N. Two periods pass from the sample to its effect.
    assert!((2.0..8.0).contains(&peak), "{peak} N");
}
