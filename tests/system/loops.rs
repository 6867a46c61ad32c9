//! Complete position loops that the servo closes: a servo with one axis on a motor, with every sample at its exact
//! time. The tests measure the properties of each loop from outside.
//!
//! A test sequence is added to the output of the servo. [`servo::identify`] computes the open loop.

use std::f64::consts::TAU;
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Increments, Power, Setpoint};
use hil::AxisConfig;
use hil::plant::{Irp6Axis, WutConfig};
use motors::{Motor, Regression};
use servo::identify::{self, Run, Trace};
use servo::regulator::IRP6;
use servo::{
    EffectorConfig, FeedForward, HostLoop, Law, MAX_AXES, Macrostep, Order, Output, Phase, PositionLoop, Record, Servo,
    ServoAxisConfig, ServoConfig,
};

use crate::regression::{LARGE, MOTION, SMALL, Trapezoid};

mod cascades;

mod homing;

mod letter;

mod motors;

mod tracking;

const PERIOD: Duration = Duration::from_millis(2);

const DT: f64 = 0.002;

/// Length of the test sequence, cycles.
const LENGTH: usize = 500;

/// Capacity for recorded cycles of a run.
const RECORDS: usize = 8000;

/// A drive group of one motor. Its samples are taken when they are read (delay 1). Over a serial line, they are taken
/// when the previous telegram is sent (delay 2).
struct Group {
    motor: Box<dyn Motor>,
    counts: f64,
    delay: usize,
    sample: i32,
    last: i32,
    command: AxisCommand,
}

impl DriveGroup for Group {
    fn axes(&self) -> usize {
        1
    }

    fn delay(&self) -> usize {
        self.delay
    }

    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        if self.delay == 1 {
            self.sample = self.count();
        }
        let radians = TAU / self.counts;
        let moved = self.sample - std::mem::replace(&mut self.last, self.sample);
        let asked = !matches!(self.command, AxisCommand::Off | AxisCommand::ResetFault);
        states[0] = AxisState {
            at: now,
            position: f64::from(self.sample) * radians,
            increments: Increments(self.sample),
            velocity: f64::from(moved) * radians / DT,
            power: if asked { Power::On } else { Power::Off },
            homing: Homing::Attained,
            following: matches!(self.command, AxisCommand::Follow(_)),
            ..AxisState::default()
        };
    }

    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        self.command = commands[0];
    }

    fn send(&mut self, _: Instant) -> bool {
        self.sample = self.count();
        let output = match self.command {
            AxisCommand::Follow(Setpoint::Torque(output) | Setpoint::Duty(output)) => output.get(),
            _ => 0.0,
        };
        self.motor.run(output);
        true
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

impl Group {
    fn count(&self) -> i32 {
        (self.motor.angle() * self.counts / TAU).floor() as i32
    }
}

/// An axis under test.
#[derive(Clone, Copy)]
struct Rig {
    host: HostLoop,
    counts: f64,
    delay: usize,
    motor: MakeMotor,
    axis: Irp6Axis,
}

type MakeMotor = fn(Irp6Axis) -> Box<dyn Motor>;

/// The servo while it runs.
struct Running {
    servo: Servo,
    link: servo::EffectorLink,
    records: rtrb::Consumer<Record>,
    now: Instant,
    /// Motor position at power-on, rad.
    start: f64,
}

/// A servo with one effector that has `axes`.
fn servo(axes: Vec<ServoAxisConfig>, groups: Vec<Box<dyn DriveGroup>>) -> (Servo, servo::EffectorLink) {
    let config = ServoConfig {
        period: PERIOD,
        max_missed_in_row: 0,
        effectors: vec![EffectorConfig {
            name: "arm".into(),
            axes,
            queue: 1000,
            enabling_timeout: Duration::from_secs(1),
            homing_timeout: Duration::from_secs(20),
        }],
    };
    let (servo, mut links) = Servo::new(&config, groups).unwrap();
    (servo, links.remove(0))
}

impl Rig {
    fn axis_config(&self) -> ServoAxisConfig {
        ServoAxisConfig {
            group: 0,
            index_in_group: 0,
            min_position: -5000.0,
            max_position: 5000.0,
            max_velocity: 260.0,
            max_acceleration: 2500.0,
            planned_jerk: 12_500.0,
            following_error: 5.0,
            homing_order: 0,
            increments_per_radian: self.counts / TAU,
            position_loop: PositionLoop::Host(self.host),
            torque_offset: None,
            homing: None,
            frozen: servo::FrozenWatch::Always,
            brake_watch: true,
        }
    }

    fn enable(&self) -> Running {
        let group = Group {
            motor: (self.motor)(self.axis),
            counts: self.counts,
            delay: self.delay,
            sample: 0,
            last: 0,
            command: AxisCommand::Off,
        };
        let start = group.motor.angle();
        let (mut servo, link) = servo(vec![self.axis_config()], vec![Box::new(group)]);
        let records = servo.record(RECORDS);
        let mut running = Running { servo, link, records, now: Instant::ZERO, start };
        running.link.orders.push(Order::Enable).unwrap();
        running.run(500);
        assert_eq!(running.phase(), Phase::Standing);
        running
    }

    /// Crossover, Hz, and phase margin, degrees, while the motor runs at `velocity`.
    fn margin(&self, velocity: f64) -> (f64, f64) {
        let mut running = self.enable();
        let lines = identify::lines(LENGTH, DT, [3.0, 120.0], 30);
        let run = Run {
            axis: 0,
            start: [running.start; MAX_AXES],
            velocity,
            acceleration: 100.0,
            excitation: identify::multisine(LENGTH, &lines, self.host.law.limit() / 8.0),
            periods: 3,
            steps: 10,
            dt: DT,
            drive_period: 0.0,
        };
        running.servo.excite(0, 0, run.excitation()).unwrap();
        let macrosteps = (1..).map_while(|number| run.macrostep(number));
        macrosteps.for_each(|step| running.link.orders.push(Order::Move(step)).unwrap());
        while running.records.pop().is_ok() {}
        running.run(run.macrosteps() as usize * 10 + 10);
        assert_eq!(running.servo.fault(0), None);
        let mut trace = Trace::default();
        while let Ok(record) = running.records.pop() {
            trace.take(&record, 0);
        }
        let (_, points) =
            trace.response(&run, &self.axis_config(), self.delay, &lines).expect("the run came to its end");
        let margin = identify::margin(&points).expect("it crosses over");
        (margin.crossover, margin.phase.to_degrees())
    }
}

impl Running {
    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.servo.step(self.now);
            self.now += PERIOD;
            while self.link.reports.pop().is_ok() {}
        }
    }

    fn phase(&self) -> Phase {
        self.servo.state(0).unwrap().phase()
    }

    /// Queues a motion in macrosteps of 10 periods.
    fn follow(&mut self, motion: Trapezoid) {
        let steps = (motion.duration() / (10.0 * DT)).ceil() as u64;
        for number in 1..=steps {
            let t = number as f64 * 10.0 * DT;
            let velocity = if number == steps { 0.0 } else { motion.velocity_at(t) };
            let macrostep = Macrostep {
                number,
                steps: 10,
                report_at: 10,
                position: [self.start + motion.at(t); MAX_AXES],
                velocity: [velocity; MAX_AXES],
                acceleration: None,
                torque: [0.0; MAX_AXES],
                law: None,
                continues_law: false,
            };
            self.link.orders.push(Order::Move(macrostep)).unwrap();
        }
    }
}

/// The regression motor under the robot's own control law, in the exact order of the original emulator.
fn original(axis: Irp6Axis, motor: MakeMotor) -> Rig {
    Rig {
        host: HostLoop {
            law: Law::Incremental(IRP6[axis as usize]),
            output: Output::Torque,
            feed_forward: FeedForward::default(),
            runaway_velocity: 1e4,
        },
        counts: f64::from(AxisConfig::irp6(axis).counts_per_revolution),
        delay: 1,
        motor,
        axis,
    }
}

/// The motor as integrated by the original emulator.
fn coarse(axis: Irp6Axis) -> Box<dyn Motor> {
    Box::new(Regression::new(regression_motor(axis), 1, 0.0))
}

/// The motor as a continuous system.
fn fine(axis: Irp6Axis) -> Box<dyn Motor> {
    Box::new(Regression::new(regression_motor(axis), 200, 0.0))
}

fn regression_motor(axis: Irp6Axis) -> &'static WutConfig {
    match axis {
        Irp6Axis::Roll | Irp6Axis::Flange => &SMALL,
        _ => &LARGE,
    }
}

#[test]
fn the_robots_own_loops_have_the_margins_of_their_table() {
    let table = [(53.6, 47.7), (22.9, 78.1), (34.8, 77.5), (21.9, 82.3), (74.6, 8.4), (7.3, 52.9)];
    println!("axis       crossover, Hz   margin, degrees");
    for (axis, (crossover, margin)) in Irp6Axis::ALL.into_iter().zip(table) {
        let found = original(axis, fine).margin(0.0);
        println!("{axis:10?} {:8.1} {crossover:6.1} {:8.1} {margin:6.1}", found.0, found.1);
        assert!((found.0 / crossover - 1.0).abs() < 0.1, "{axis:?}: {} Hz", found.0);
        assert!((found.1 / margin - 1.0).abs() < 0.1, "{axis:?}: {} degrees", found.1);
    }
}

#[test]
fn one_more_sample_of_delay_leaves_the_column_nine_degrees() {
    let rig = Rig { delay: 2, ..original(Irp6Axis::Column, fine) };
    let (crossover, margin) = rig.margin(0.0);
    println!("column with one more sample: {crossover:.1} Hz, {margin:.1} degrees");
    assert!((crossover / 53.6 - 1.0).abs() < 0.1, "{crossover} Hz");
    assert!((margin / 9.1 - 1.0).abs() < 0.1, "{margin} degrees");
}

#[test]
fn every_axis_follows_by_the_servo_as_it_does_by_the_bare_law() {
    // Largest errors in counts, as in the table of the regulator alone.
    let table = [147.0, 287.0, 224.0, 172.0, 3.0, 81.0];
    for (axis, expected) in Irp6Axis::ALL.into_iter().zip(table) {
        let rig = original(axis, coarse);
        let mut running = rig.enable();
        running.follow(MOTION);
        running.run(2000);
        assert_eq!(running.phase(), Phase::Standing, "{:?}", running.servo.fault(0));
        let peak = running.servo.tracking(0).next().unwrap().peak * rig.counts / TAU;
        assert!((peak - expected).abs() < 3.0, "{axis:?}: {peak} counts");
    }
}
