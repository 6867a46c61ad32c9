//! Computing time of a whole step of the effector control process of the seven-axis Polycrank, with its quantiles.
//!
//! `cargo bench -p mrroc-controller --bench ecp_step` prints a table and one JSON object. The command fails if a step takes
//! 20 µs or more at the 99th percentile. `MRROC_STEPS` is the number of steps, 100,000 by default.
//!
//! A step is one call of [`Ecp::poll`] with a new report of the servo. The generator has class 3: it reads effector and
//! sensor, and commands a pose of the tool with velocity and acceleration. The step contains inverse kinematics, drive
//! train and weight, and ends with the order to the servo. The clock is read around each call.

#![allow(clippy::disallowed_methods, reason = "a benchmark reads the clock and the environment")]

use std::f64::consts::TAU;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use can::{Instant, clock};
use hdrhistogram::Histogram;
use mrroc_controller::ecp::{Ecp, EcpConfig, Task};
use mrroc_controller::generator::{
    Axes, EffectorImage, Generator, GeneratorError, Next, Pace, Pose, SensorReading, Setpoint, V,
};
use mrroc_controller::path::PoseState;
use mrroc_controller::robot::{Arm, Mass, Polycrank, PolycrankParameters, Robot, Weight};
use mrroc_controller::sensor::{Shell, VirtualSensor};
use nalgebra::Vector3;
use serde_json::json;
use servo::{EffectorLink, Order, Phase, ServoReport};

/// Greatest time of a step at the 99th percentile, µs.
const WITHIN: f64 = 20.0;
/// Joints in the middle of the workspace, rad.
const START: Axes = [0.3, 1.2, -0.7, 0.4, 1.3, -0.6, 0.2, 0.0];
/// Radius of the circle, m, and macrosteps of a turn.
const RADIUS: f64 = 0.02;
const TURN: f64 = 500.0;
const PERIOD: Duration = Duration::from_millis(2);
const MACROSTEP: Pace = Pace { periods: 10, read_at: 8 };

/// A force, N.
#[derive(Clone, Copy)]
struct Force(f64);

impl SensorReading for Force {}

struct ForceSensor;

impl VirtualSensor for ForceSensor {
    type Reading = Force;
    type Command = ();

    fn poll(&mut self, now: Instant) -> Option<(Instant, Force)> {
        Some((now, Force(0.0)))
    }
}

/// Leads the tool round a circle until a force acts.
struct Circle {
    steps: u64,
    centre: Pose,
}

impl Generator for Circle {
    type First = EffectorImage;
    type Every = (EffectorImage, V<Force>);
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u64;

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<u64>, GeneratorError> {
        self.centre = e.commanded.pose;
        self.centre.translation.vector.x -= RADIUS;
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u64, (_, v): &Self::Every) -> bool {
        *done == self.steps || v.0.sample().is_some_and(|sample| sample.value.0 > 5.0)
    }

    fn next_step(&self, done: &u64, (e, _): &Self::Every) -> Result<Next<u64>, GeneratorError> {
        let done = done + 1;
        let (sin, cos) = (TAU * done as f64 / TURN).sin_cos();
        let rate = TAU / (TURN * PERIOD.as_secs_f64() * f64::from(MACROSTEP.periods));
        let mut pose = self.centre;
        pose.translation.vector += Vector3::new(cos, sin, 0.0) * RADIUS;
        pose.rotation = e.commanded.pose.rotation;
        let state = PoseState {
            pose,
            linear: Vector3::new(-sin, cos, 0.0) * RADIUS * rate,
            angular: Vector3::zeros(),
            linear_acceleration: Vector3::new(-cos, -sin, 0.0) * RADIUS * rate * rate,
            angular_acceleration: Vector3::zeros(),
        };
        Ok(Next::command(Setpoint::Tool(state), done))
    }
}

fn arm() -> Arm {
    let robot = Polycrank::new(&PolycrankParameters::polycrank()).expect("its parameters are consistent");
    let masses = vec![Mass { mass: 5.0, centre: [0.1; 3] }; robot.axes()];
    let weight = Weight::new(&robot, &masses, Mass::default(), [0.0, 0.0, 1.0]).expect("one mass per link");
    Arm::new(Arc::new(robot), Pose::identity()).weighing(weight)
}

fn main() -> ExitCode {
    let steps = std::env::var("MRROC_STEPS").map_or(100_000, |steps| steps.parse().expect("a number"));
    let motors = arm().motors(&START).expect("the arm stands there");
    let (orders, mut servo_orders) = rtrb::RingBuffer::new(16);
    let (mut servo_reports, reports) = rtrb::RingBuffer::new(16);
    let config = EcpConfig {
        period: PERIOD,
        pace: MACROSTEP,
        macrosteps_ahead: 4,
        silence: Duration::from_secs(1),
        switching: Duration::from_secs(5),
        planning: Duration::from_secs(60),
        homing: Duration::from_secs(120),
        meeting: Duration::from_secs(600),
    };
    let (mut publisher, latest) = servo::latest(servo::MAX_AXES);
    let mut ecp = Ecp::new(arm(), EffectorLink { orders, reports, latest }, config);
    ecp.sensors().install(ForceSensor, Shell::NonInteractive, 1).expect("the only sensor");
    let mut report = ServoReport { reached: true, ..ServoReport::default() };
    (report.snapshot.phase, report.snapshot.homed, report.snapshot.axes) = (Phase::Standing, true, 7);
    (report.snapshot.commanded, report.snapshot.measured) = (motors, motors);
    publisher.publish(&report.snapshot);
    servo_reports.push(report).expect("there is room");
    let mut now = Instant::ZERO;
    ecp.poll(now);
    ecp.execute(Task::new().run(Circle { steps, centre: Pose::identity() })).expect("nothing is under way");
    ecp.poll(now);

    let mut times = Histogram::<u64>::new(3).expect("three digits");
    report.snapshot.phase = Phase::Moving;
    for step in 1..steps {
        while let Ok(Order::Move(macrostep)) = servo_orders.pop() {
            report.snapshot.macrostep = macrostep.number;
            (report.snapshot.commanded, report.snapshot.measured) = (macrostep.position, macrostep.position);
        }
        assert_eq!(report.snapshot.macrostep, step, "one macrostep per step");
        now += PERIOD * u32::from(MACROSTEP.periods);
        (report.snapshot.at, report.snapshot.cycle) = (now, report.snapshot.cycle + u64::from(MACROSTEP.periods));
        publisher.publish(&report.snapshot);
        servo_reports.push(report).expect("the ECP reads reports");
        let begin = clock::now();
        let event = ecp.poll(now);
        times.record(clock::now().since(begin).as_nanos() as u64).expect("the histogram grows");
        assert_eq!(event, None, "step {step}");
    }
    let quantile = |quantile| times.value_at_quantile(quantile) as f64 / 1e3;
    let [median, p99, p999] = [0.5, 0.99, 0.999].map(quantile);
    let longest = times.max() as f64 / 1e3;
    println!(
        "{steps} steps of a Polycrank, µs: median {median:.2}, p99 {p99:.2}, p99.9 {p999:.2}, longest {longest:.1}"
    );
    println!("{}", json!({ "steps": steps, "median_us": median, "p99_us": p99, "p999_us": p999, "within": WITHIN }));
    ExitCode::from(u8::from(p99 >= WITHIN))
}
