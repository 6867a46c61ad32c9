//! Nothing allocates while a generator runs, and no sensor of the operator in its steps. Planning allocates only for
//! contours, time-optimal motions and jerk-limited motions through poses.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use mrroc_controller::ecp::{Ecp, EcpConfig, Task};
use mrroc_controller::generator::{
    Axes, AxesState, ConstantVelocity, Contour, EffectorImage, FeedLimits, Generator, GeneratorError, JerkLimited,
    LineLimits, MotionLimits, Newsmooth, Next, Pace, Polynomial, Pose, Selected, Selection, SensorReading, Setpoint,
    SmoothPose, StraightLine, TimeOptimal, V, WeightedSum, WithImages,
};
use mrroc_controller::path::{BSpline, Curve, Path, SplineEnds};
use mrroc_controller::robot::{
    Arm, Irb6, Irb6Parameters, Irp6, Irp6Parameters, Irp6Track, Irp6TrackParameters, Joints, Mass, Polycrank,
    PolycrankParameters, Rnt, RntParameters, Robot, Space, Weight,
};
use mrroc_controller::sensor::{
    Operator, OperatorCommand, OperatorError, OperatorLink, Question, Reaction, Shell, VirtualSensor,
};
use servo::{EffectorLink, Order, Phase, ServoReport};

use crate::counting;

/// The IRp-6 without a tool, with the masses of its links.
fn arm() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).expect("its parameters are consistent");
    let weight = Weight::new(&robot, &Mass::IRP6, Mass::default(), [0.0, 0.0, 1.0]);
    let weight = weight.expect("its masses are consistent");
    Arm::new(Arc::new(robot), Pose::identity()).weighing(weight)
}

const START: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];

/// A distance, m.
#[derive(Clone, Copy)]
struct Distance(f64);

impl SensorReading for Distance {}

struct DistanceSensor;

impl VirtualSensor for DistanceSensor {
    type Reading = Distance;
    type Command = ();

    fn poll(&mut self, now: Instant) -> Option<(Instant, Distance)> {
        Some((now, Distance(0.1)))
    }
}

/// Reads effector and sensor in every step, and moves joint 0 by a part of the distance.
struct Follow;

impl Generator for Follow {
    type First = ();
    type Every = (EffectorImage, V<Distance>);
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &Self::Every) -> bool {
        *done == 100
    }

    fn next_step(&self, done: &u32, (e, v): &Self::Every) -> Result<Next<u32>, GeneratorError> {
        let mut position = e.commanded.joints.position;
        position[0] += 0.001 * v.0.younger_than(Duration::from_secs(1))?.0;
        Ok(Next::command(Setpoint::Joints(AxesState::at_rest(position)), done + 1))
    }
}

/// Runs one generator to its end, with a servo that follows every command exactly. Counts the allocations of the
/// planning poll, and those of all other polls.
fn allocations(generator: Result<impl Generator, GeneratorError>) -> (u64, u64) {
    let motors = arm().motors(&START).expect("the arm stands there");
    let (orders, mut servo_orders) = rtrb::RingBuffer::new(16);
    let (mut servo_reports, reports) = rtrb::RingBuffer::new(16);
    let config = EcpConfig {
        period: Duration::from_millis(2),
        pace: Pace { periods: 10, read_at: 8 },
        macrosteps_ahead: 4,
        silence: Duration::from_millis(500),
        switching: Duration::from_secs(5),
        planning: Duration::from_secs(60),
        homing: Duration::from_secs(120),
        meeting: Duration::from_secs(600),
    };
    let (mut publisher, latest) = servo::latest(servo::MAX_AXES);
    let mut ecp = Ecp::new(arm(), EffectorLink { orders, reports, latest }, config);
    ecp.sensors().install(DistanceSensor, Shell::NonInteractive, 1).expect("the only sensor");
    let mut report = ServoReport { reached: true, ..ServoReport::default() };
    (report.snapshot.phase, report.snapshot.homed, report.snapshot.axes) = (Phase::Standing, true, 6);
    (report.snapshot.commanded, report.snapshot.measured) = (motors, motors);
    publisher.publish(&report.snapshot);
    servo_reports.push(report).expect("there is room");
    ecp.poll(Instant::ZERO);
    ecp.execute(Task::new().run(generator.expect("it can be made"))).expect("nothing is under way");

    let before = counting::allocations();
    assert_eq!(ecp.poll(Instant::ZERO), None);
    let planned = counting::allocations();
    let mut now = Instant::ZERO;
    for _ in 0..100_000 {
        now += Duration::from_millis(20);
        while let Ok(Order::Move(macrostep)) = servo_orders.pop() {
            report.snapshot.macrostep = macrostep.number;
            report.snapshot.measured = macrostep.position;
            report.snapshot.commanded = macrostep.position;
            servo_reports.push(report).expect("the ECP reads reports");
        }
        if let Some(event) = ecp.poll(now) {
            assert_eq!(event.outcome, Ok(()));
            assert!(report.snapshot.macrostep > 10, "it did move");
            return (planned - before, counting::allocations() - planned);
        }
    }
    panic!("the motion does not end");
}

#[test]
fn no_generator_allocates_once_it_was_made() {
    let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
    let pose = |k: f64| std::array::from_fn(|axis| START[axis] + 0.05 * k * (axis as f64 - 2.0));
    let poses: [Axes; 4] = [pose(1.0), pose(2.0), pose(3.0), pose(4.0)];
    let smooth = poses.map(SmoothPose::fast).to_vec();
    assert_eq!(allocations(Newsmooth::new(Space::Joint, 6, limits, smooth)), (0, 0), "newsmooth");
    assert_eq!(allocations(Polynomial::quintic(Space::Joint, 6, limits, poses[0])), (0, 0), "quintic");
    assert_eq!(allocations(Ok(Follow)), (0, 0), "feedback of effector and sensor");
    let direct = JerkLimited::new(Space::Joint, 6, limits, &poses[..1]);
    assert_eq!(allocations(direct), (0, 0), "jerk-limited");
    let constant =
        || ConstantVelocity::new(arm(), limits, [0.1; 8]).map(|motion| motion.lasting(Duration::from_secs(1)));
    assert_eq!(allocations(constant()), (0, 0), "constant velocity");
    let smooth = || Newsmooth::new(Space::Joint, 6, limits, vec![SmoothPose::fast(poses[1])]);
    let sum = WeightedSum::new(Space::Joint, constant().unwrap(), smooth().unwrap(), 0.5);
    assert_eq!(allocations(sum), (0, 0), "weighted sum");
    let read = WithImages::<_, EffectorImage, EffectorImage>::of;
    let parts = (read(constant().unwrap()), WithImages::of(smooth().unwrap()));
    let selection = Selection::between(arm(), limits, parts.0, parts.1, |_, _| Selected::First);
    assert_eq!(allocations(selection), (0, 0), "selection");
    let through = JerkLimited::new(Space::Joint, 6, limits, &poses);
    assert_eq!(allocations(through).1, 0, "jerk-limited through poses");
    let fastest = TimeOptimal::through(Space::Joint, 6, limits, poses.to_vec());
    assert_eq!(allocations(fastest).1, 0, "time-optimal");

    let mut target = arm().forward(&START).unwrap();
    target.translation.vector.z += 0.1;
    let line_limits = LineLimits {
        max_velocity: 0.25,
        max_acceleration: 1.0,
        max_jerk: 10.0,
        max_angular_velocity: 1.0,
        max_angular_acceleration: 4.0,
        max_angular_jerk: 40.0,
    };
    assert_eq!(allocations(StraightLine::new(arm(), target, line_limits, limits)), (0, 0), "line");

    let start = arm().forward(&START).unwrap();
    let points = [[0.0, 0.0], [0.05, 0.0], [0.05, 0.05], [0.0, 0.05]]
        .map(|[x, y]| start.translation.vector + nalgebra::Vector3::new(x, y, 0.0));
    let curve = Curve::spline(BSpline::through(&points, SplineEnds::Natural).unwrap()).unwrap();
    let feed_limits = FeedLimits {
        max_velocity: 0.1,
        max_acceleration: 1.0,
        max_jerk: 10.0,
        max_normal_acceleration: 1.0,
        max_angular_velocity: 1.0,
        max_angular_acceleration: 4.0,
    };
    let path = Path::keeping(curve, start.rotation).unwrap();
    let contour = Contour::along(arm(), path, feed_limits, limits);
    assert_eq!(allocations(contour).1, 0, "contour");
}

#[test]
fn no_question_of_a_step_uses_the_heap() {
    let limit = Duration::from_secs(1);
    let (link, panel) = OperatorLink::new(8);
    let question = Question::new("Next motion?", ["yes", "no"]).within(limit);
    let (mut sensor, answer) = Operator::new(&link, question);
    let mut now = Instant::ZERO;
    // Answers, a passed deadline with a late line, and a question that is asked in place of one under way.
    for (lines, reaction) in [
        (["perhaps", "YES"].as_slice(), Some(Reaction::Answered(0))),
        (&["no"], Some(Reaction::Answered(1))),
        (&["perhaps"], Some(Reaction::Late)),
        (&["no", "yes"], Some(Reaction::Answered(0))),
        (&[], None),
        (&[], Some(Reaction::Late)),
    ] {
        lines.iter().for_each(|line| panel.lines.try_send((*line).to_owned()).unwrap());
        let before = (counting::allocations(), counting::releases());
        sensor.configure(&OperatorCommand::Ask);
        let mut reading = None;
        for _ in 0..if reaction.is_some() { 3 } else { 1 } {
            now += limit;
            reading = sensor.poll(now);
            sensor.configure(&OperatorCommand::Wait);
        }
        assert_eq!((counting::allocations(), counting::releases()), before, "{lines:?}");
        assert_eq!(reading.map(|(_, reading)| reading), reaction, "{lines:?}");
        let answered = answer.get();
        match reaction {
            Some(Reaction::Answered(choice)) => {
                assert_eq!(answered, Some(Ok(["yes", "no"][usize::from(choice)].to_owned())));
            }
            Some(Reaction::Late) => assert_eq!(answered, Some(Err(OperatorError::Late { limit }))),
            _ => assert_eq!(answered, None),
        }
        // The panel frees the lines, and formats the texts.
        assert!(panel.texts.try_iter().count() > 0);
    }
    drop(panel.lines);
    sensor.configure(&OperatorCommand::Ask);
    assert_eq!(sensor.poll(now), Some((now, Reaction::Closed)));
}

#[test]
fn no_kinematics_allocates() {
    let track = Irp6Track::new(&Irp6TrackParameters::irp6ot()).expect("the preset is a robot");
    let seven = Polycrank::new(&PolycrankParameters::polycrank()).expect("the preset is a robot");
    let six = Irp6::new(&Irp6Parameters::irp6p()).expect("the preset is a robot");
    let five = Irb6::new(&Irb6Parameters::irb6()).expect("the preset is a robot");
    let legs = Rnt::new(&RntParameters::nominal()).expect("the preset is a robot");
    let robots: [(&dyn Robot, Joints); 5] = [
        (&five, Joints::from([0.3, -1.7, 0.07, -0.33, 1.1])),
        (&six, Joints::from([0.3, -1.7, 0.07, -0.33, 1.1, 0.6])),
        (&legs, Joints::from([0.2, -0.1, 0.9, 0.4, 1.1, 0.6])),
        (&track, Joints::from([0.4, 0.3, -1.7, 0.07, -0.33, 1.1, 0.6])),
        (&seven, Joints::from([0.3, 1.2, -0.7, 0.4, 1.3, -0.6, 0.2])),
    ];
    for (robot, joints) in robots {
        let pose = robot.forward(&joints).unwrap();
        let mut far = pose;
        far.translation.vector *= 9.0;
        let before = counting::allocations();
        robot.inverse(&pose, &joints).unwrap();
        robot.inverse(&far, &joints).unwrap_err();
        robot.jacobian(&joints).unwrap();
        robot.singularity(&joints).unwrap();
        let motors = robot.motors_from_joints(&joints).unwrap();
        robot.joints_from_motors(&motors).unwrap();
        assert_eq!(counting::allocations(), before, "{robot:?}");
    }
}
