//! The ECP with a scripted servo, in virtual time.

mod chaining;
mod endings;
mod failures;
mod images;
mod laws;
mod links;
mod pace;
mod planning;
pub(crate) mod teams;
mod weight;

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Vector3;
use servo::{MAX_AXES, Macrostep, Publisher, ServoFault, StopCause};

use super::*;
use crate::generator::{
    Axes, AxesState, EffectorImage, Generator, GeneratorError, JerkLimited, MotionLimits, Newsmooth, Next, Pose,
    Setpoint, SmoothPose, Wait,
};
use crate::robot::{Arm, Jacobian, Joints, KinematicsError, Limits, Link, Motors, Robot, Solutions, Space};

const PERIOD: Duration = Duration::from_millis(2);
const CONFIG: EcpConfig = EcpConfig {
    period: PERIOD,
    pace: Pace { periods: 10, read_at: 8 },
    macrosteps_ahead: 4,
    silence: Duration::from_millis(500),
    switching: Duration::from_secs(5),
    planning: Duration::from_secs(60),
    homing: Duration::from_secs(10),
    meeting: Duration::from_secs(600),
};

/// Three linear joints along x, y and z with motors geared 100:1. The second joint is driven by a bent lever.
#[derive(Debug)]
pub(crate) struct Gantry;

const RANGE: [Limits; 3] = [Limits { low: -5.0, high: 5.0 }; 3];
const MOTOR_RANGE: [Limits; 3] = [Limits { low: -8_000.0, high: 8_000.0 }; 3];

impl Robot for Gantry {
    fn axes(&self) -> usize {
        3
    }
    fn joint_limits(&self) -> &[Limits] {
        &RANGE
    }
    fn motor_limits(&self) -> &[Limits] {
        &MOTOR_RANGE
    }
    fn home(&self) -> Motors {
        Motors::from([0.0; 3])
    }
    fn forward(&self, q: &Joints) -> Result<Pose, KinematicsError> {
        Ok(Pose::translation(q[0], q[1], q[2]))
    }
    fn inverse(&self, pose: &Pose, _: &Joints) -> Result<Solutions, KinematicsError> {
        let q = Joints::from([pose.translation.x, pose.translation.y, pose.translation.z]);
        self.motors_from_joints(&q)?;
        Ok(Solutions::from(q))
    }
    fn motors_from_joints(&self, q: &Joints) -> Result<Motors, KinematicsError> {
        for (axis, (value, range)) in q.iter().zip(&RANGE).enumerate() {
            if let Some(limit) = range.exceeded_by(*value) {
                return Err(beyond(axis as u8, *value, limit));
            }
        }
        Ok(Motors::from([100.0 * q[0], 100.0 * q[1].sinh(), 100.0 * q[2]]))
    }
    fn joints_from_motors(&self, m: &Motors) -> Result<Joints, KinematicsError> {
        Ok(Joints::from([m[0] / 100.0, (m[1] / 100.0).asinh(), m[2] / 100.0]))
    }
    fn jacobian(&self, _: &Joints) -> Result<Jacobian, KinematicsError> {
        Ok(Jacobian::identity())
    }
    fn links(&self) -> Vec<Link> {
        weight::links()
    }
}

fn beyond(axis: u8, value: f64, limit: f64) -> KinematicsError {
    KinematicsError::BeyondLimit { space: Space::Joint, axis, value, limit }
}

/// The servo's end of the link: executes orders one period at a time, and jumps to the end of each macrostep.
struct Script {
    orders: rtrb::Consumer<Order>,
    reports: rtrb::Producer<ServoReport>,
    latest: Publisher,
    report: ServoReport,
    queue: VecDeque<Macrostep>,
    done: u16,
    moving: [f64; MAX_AXES],
    log: Vec<Order>,
    /// Whether the script ignores all orders.
    deaf: bool,
    /// Whether homing never ends.
    lost: bool,
    /// Whether motion time stands still.
    paused: bool,
    fault: Option<ServoFault>,
    /// Number of the next resets that fail.
    failing_resets: u32,
}

impl Script {
    fn phase(&mut self, phase: Phase) {
        self.report.snapshot.phase = phase;
        self.say();
    }

    fn say(&mut self) {
        self.publish();
        let due = self.queue.front().is_none_or(|macrostep| self.done >= macrostep.report_at);
        self.report.reached = due || self.report.snapshot.phase != Phase::Moving;
        self.reports.push(self.report).expect("the ECP reads reports");
    }

    fn publish(&mut self) {
        self.report.snapshot.measured = self.report.snapshot.commanded;
        self.latest.publish(&self.report.snapshot);
    }

    /// Publishes another measured position of motor 0.
    fn latest_measured(&mut self, motor: f64) {
        let mut snapshot = self.report.snapshot;
        snapshot.measured[0] = motor;
        self.latest.publish(&snapshot);
    }

    fn fail(&mut self, fault: ServoFault) {
        self.queue.clear();
        self.done = 0;
        self.moving = [0.0; MAX_AXES];
        self.report.fault = Some(fault);
        self.phase(Phase::Faulted);
    }

    /// Ends the motion at a touch, as a cycle law does.
    fn touch(&mut self) {
        self.queue.clear();
        self.done = 0;
        self.moving = [0.0; MAX_AXES];
        self.report.fault = Some(ServoFault::new(None, StopCause::Touched));
        self.phase(Phase::Stopping);
        self.phase(Phase::Standing);
    }

    fn period(&mut self, now: Instant) {
        self.report.snapshot.at = now;
        self.report.snapshot.cycle += 1;
        self.report.snapshot.sampled = [now - PERIOD; MAX_AXES];
        if let Some(fault) = self.fault.take() {
            self.fail(fault);
        }
        while !self.deaf
            && let Ok(order) = self.orders.pop()
        {
            self.log.push(order);
            match order {
                Order::Enable => self.phase(Phase::Standing),
                Order::Home => {
                    self.phase(Phase::Homing);
                    if !self.lost {
                        self.report.snapshot.homed = true;
                        self.phase(Phase::Standing);
                    }
                }
                Order::Move(_) if !matches!(self.report.snapshot.phase, Phase::Standing | Phase::Moving) => {}
                Order::Move(macrostep) => self.queue.push_back(macrostep),
                Order::Stop => {
                    self.queue.clear();
                    self.done = 0;
                    self.moving = [0.0; MAX_AXES];
                    if self.report.fault.take_if(|fault| fault.cause.needs_acknowledgement()).is_some() {
                        self.say();
                    }
                    if matches!(self.report.snapshot.phase, Phase::Moving | Phase::Homing) {
                        self.phase(Phase::Stopping);
                        self.phase(Phase::Standing);
                    }
                }
                // The partners of this script are always there.
                Order::Meet { .. } | Order::Tie { .. } | Order::Untie => {}
                Order::Disable => self.phase(Phase::Off),
                Order::ResetFault if self.failing_resets > 0 => {
                    self.failing_resets -= 1;
                    for resetting in [true, false] {
                        self.report.resetting = resetting;
                        self.say();
                    }
                }
                Order::ResetFault => {
                    self.report.fault = None;
                    self.phase(Phase::Off);
                }
            }
        }
        self.report.snapshot.rate = if self.paused { 0.0 } else { 1.0 };
        if self.paused {
            return;
        }
        let Some(macrostep) = self.queue.front().copied() else {
            if self.moving != [0.0; MAX_AXES] {
                let last = self.report.snapshot.macrostep;
                self.fail(ServoFault::new(Some(0), StopCause::Starved { last }));
            } else if self.report.snapshot.phase == Phase::Moving {
                self.phase(Phase::Standing);
            }
            return;
        };
        if self.done == 0 {
            self.report.snapshot.macrostep = macrostep.number;
            if self.report.snapshot.phase != Phase::Moving {
                self.phase(Phase::Moving);
            }
        }
        self.done += 1;
        if self.done == macrostep.report_at {
            self.say();
        }
        if self.done == macrostep.steps {
            self.report.snapshot.commanded = macrostep.position;
            self.moving = macrostep.velocity;
            self.queue.pop_front();
            self.done = 0;
        }
    }

    fn moves(&self) -> impl Iterator<Item = &Macrostep> {
        self.log.iter().filter_map(|order| if let Order::Move(macrostep) = order { Some(macrostep) } else { None })
    }
}

struct Bench {
    ecp: Ecp,
    servo: Script,
    now: Instant,
    /// Number of periods between two polls of the ECP.
    poll_every: u32,
}

impl Bench {
    fn new(room: usize) -> Self {
        Self::of(Arm::new(Arc::new(Gantry), Pose::identity()), room)
    }

    fn of(arm: Arm, room: usize) -> Self {
        let (orders, servo_orders) = rtrb::RingBuffer::new(room);
        let (servo_reports, reports) = rtrb::RingBuffer::new(64);
        let (publisher, latest) = servo::latest(MAX_AXES);
        let snapshot = Snapshot { axes: 3, rate: 1.0, ..Snapshot::default() };
        let servo = Script {
            orders: servo_orders,
            reports: servo_reports,
            latest: publisher,
            report: ServoReport { snapshot, ..ServoReport::default() },
            queue: VecDeque::new(),
            done: 0,
            moving: [0.0; MAX_AXES],
            log: Vec::new(),
            deaf: false,
            lost: false,
            paused: false,
            fault: None,
            failing_resets: 0,
        };
        let ecp = Ecp::new(arm, EffectorLink { orders, reports, latest }, CONFIG);
        Self { ecp, servo, now: Instant::ZERO, poll_every: 1 }
    }

    /// Runs until the end of the task, 100 s at most, and returns its events.
    fn run(&mut self, task: Task) -> Vec<EcpEvent> {
        self.ecp.execute(task).unwrap();
        self.go_on(|_| {})
    }

    fn go_on(&mut self, mut each_period: impl FnMut(&mut Self)) -> Vec<EcpEvent> {
        let mut events = Vec::new();
        for period in 0..50_000 {
            if period % self.poll_every == 0 {
                while let Some(event) = self.ecp.poll(self.now) {
                    events.push(event);
                }
                if self.ecp.status().instruction.is_none() {
                    return events;
                }
            }
            each_period(self);
            self.servo.period(self.now);
            self.servo.publish();
            self.now += PERIOD;
        }
        panic!("still busy: {:?} after {events:?}", self.ecp.status());
    }

    fn ready() -> Self {
        let mut bench = Self::new(16);
        assert_eq!(bench.run(Task::new().enable().home()), finished(2));
        bench
    }
}

fn finished(count: usize) -> Vec<EcpEvent> {
    (0..count).map(|instruction| ended(instruction, Ok(()))).collect()
}

/// The end of an instruction that was not replaced.
fn ended(instruction: usize, outcome: Result<(), EcpError>) -> EcpEvent {
    EcpEvent { instruction, outcome, replaced: false }
}

fn failed(error: EcpError) -> Vec<EcpEvent> {
    vec![ended(0, Err(error))]
}

fn limits() -> MotionLimits {
    MotionLimits::uniform(1.0, 5.0, 50.0)
}

/// A trapezoid in macrosteps of the cell.
#[derive(Clone)]
struct Coarse(Newsmooth);

impl Generator for Coarse {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    type Memory = <Newsmooth as Generator>::Memory;

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<Self::Memory>, GeneratorError> {
        self.0.first_step(e, macrostep)
    }

    fn terminal(&self, memory: &Self::Memory, (): &()) -> bool {
        self.0.terminal(memory, &())
    }

    fn next_step(&self, memory: &Self::Memory, (): &()) -> Result<Next<Self::Memory>, GeneratorError> {
        self.0.next_step(memory, &())
    }
}

fn to(x: f64, y: f64, z: f64) -> Coarse {
    let pose = SmoothPose::fast([x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0]);
    Coarse(Newsmooth::new(Space::Joint, 3, limits(), vec![pose]).unwrap())
}

/// Moves axis 0 at 0.5 m/s until the measured joint is past `until`. Class 1, continuous feedback.
struct Push {
    until: f64,
}

impl Generator for Push {
    type First = ();
    type Every = EffectorImage;
    type Out = ();
    type Memory = u32;
    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, _: &u32, e: &EffectorImage) -> bool {
        e.measured.joints.position[0] > self.until
    }
    fn next_step(&self, steps: &u32, _: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        let by = AxesState::new(axis_0(0.01), axis_0(0.5));
        Ok(Next::command(Setpoint::JointsBy(by), steps + 1))
    }
}

/// Requests the same set-point three times, then gives up.
struct Ask(Setpoint);

impl Generator for Ask {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = u16;
    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<u16>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, _: &u16, _: &()) -> bool {
        false
    }
    fn next_step(&self, step: &u16, _: &()) -> Result<Next<u16>, GeneratorError> {
        if *step == 3 { Err(GeneratorError::User(7)) } else { Ok(Next::command(self.0, step + 1)) }
    }
}

fn axis_0(value: f64) -> Axes {
    [value, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
}

#[test]
fn a_task_runs_in_order_and_each_motion_begins_where_the_last_one_ended() {
    let mut bench = Bench::new(16);
    let back = JerkLimited::new(Space::Joint, 3, limits(), &[[0.0; MAX_AXES]]).unwrap();
    let wait = Wait { duration: Duration::from_millis(50) };
    let task = Task::new().enable().home().run(to(0.5, 0.3, -0.2)).run(wait).run(back).disable();
    assert_eq!(bench.run(task), finished(6));

    let moves: Vec<_> = bench.servo.moves().copied().collect();
    assert!(moves.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
    let turn = moves.iter().position(|m| (m.position[0] - 50.0).abs() < 1e-9).unwrap();
    for standing in &moves[turn..turn + 4] {
        assert_eq!((standing.position, standing.velocity), (moves[turn].position, [0.0; MAX_AXES]));
    }
    assert_eq!(moves.last().unwrap().position, [0.0; MAX_AXES]);
    assert_eq!(bench.ecp.status().phase, Phase::Off);
}

#[test]
fn homing_is_skipped_when_every_axis_is_homed() {
    let mut bench = Bench::ready();
    bench.servo.log.clear();
    assert_eq!(bench.run(Task::new().enable().home()), finished(2));
    assert_eq!(bench.servo.log, []);
}

#[test]
fn motor_velocities_are_the_derivative_of_motor_positions() {
    let mut bench = Bench::ready();
    assert_eq!(bench.run(Task::new().run(to(0.1, 1.5, 1.5))), finished(1));
    for macrostep in bench.servo.moves() {
        // d/dt 100 sinh y = 100 cosh y · dy/dt, and y moves together with z.
        let ratio = (macrostep.position[1] / 100.0).hypot(1.0);
        let (y, z) = (macrostep.velocity[1], macrostep.velocity[2]);
        assert!((y - ratio * z).abs() < 1e-8 * y.abs() + 1e-9, "{y} {z} {ratio}");
    }
}

#[test]
fn an_open_loop_generator_survives_a_controller_that_is_three_macrosteps_late() {
    let mut bench = Bench::ready();
    bench.poll_every = 30;
    assert_eq!(bench.run(Task::new().run(to(1.0, 0.0, 0.0))), finished(1));
}

#[test]
fn nothing_is_sent_further_ahead_than_configured() {
    let mut bench = Bench::ready();
    bench.ecp.execute(Task::new().run(to(1.0, 0.0, 0.0))).unwrap();
    let mut most = 0;
    let events = bench.go_on(|bench| {
        most = most.max(bench.ecp.sent - bench.ecp.executed);
    });
    assert_eq!(events, finished(1));
    assert_eq!(most, 4);
}

#[test]
fn a_generator_that_reads_the_effector_gets_one_macrostep_per_report_and_stops_on_it() {
    let mut bench = Bench::ready();
    bench.ecp.execute(Task::new().run(Push { until: 0.1 })).unwrap();
    let mut most = 0;
    let events = bench.go_on(|bench| {
        most = most.max(bench.ecp.sent - bench.ecp.executed);
    });
    assert_eq!(events, finished(1));
    assert_eq!(most, 1);
    assert_eq!(bench.servo.log.last(), Some(&Order::Stop), "it ended in motion, so it was braked");
    let measured = bench.ecp.effector.read().unwrap().measured.joints.position[0];
    assert!((0.1..0.13).contains(&measured), "{measured}");
}

#[test]
fn a_full_queue_delays_orders_and_loses_none() {
    let mut bench = Bench::new(1);
    assert_eq!(bench.run(Task::new().enable().home().run(to(1.0, 0.0, 0.0))), finished(3));
    let numbers: Vec<u64> = bench.servo.moves().map(|m| m.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>());
    assert_eq!(bench.servo.report.snapshot.commanded[0], 100.0);
}

#[test]
fn a_second_task_is_refused_while_one_is_under_way() {
    let mut bench = Bench::new(16);
    bench.ecp.execute(Task::new().enable()).unwrap();
    assert_eq!(bench.ecp.execute(Task::new().disable()), Err(Busy { instruction: 0 }));
}

#[test]
fn a_held_process_waits_before_its_motion_and_executes_everything_else() {
    let mut bench = Bench::new(16);
    bench.ecp.hold(true);
    bench.ecp.execute(Task::new().enable().home().run(to(1.0, 0.0, 0.0)).disable()).unwrap();
    let mut waited = 0;
    let events = bench.go_on(|bench| {
        if bench.ecp.is_held() {
            waited += 1;
            assert_eq!(bench.ecp.status(), Status { phase: Phase::Standing, instruction: Some(2) });
            bench.ecp.hold(waited < 10);
        }
    });
    assert_eq!((events, waited), (finished(4), 10));
}

#[test]
fn an_ecp_can_be_given_to_a_thread() {
    fn given<T: Send>() {}
    given::<Ecp>();
}

#[test]
fn the_first_macrosteps_of_a_motion_reach_the_servo_at_once() {
    let mut bench = Bench::ready();
    bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0))).unwrap();
    assert_eq!(bench.ecp.poll(bench.now), None);
    assert_eq!(bench.servo.orders.slots(), usize::from(CONFIG.macrosteps_ahead));
    assert_eq!(bench.go_on(|_| {}), finished(1));
}

/// Lets two benches meet. The second bench comes `late` periods after the first. Returns the periods in which each
/// bench sent its first macrostep.
fn meet(late: u64) -> [u64; 2] {
    let mut benches = [Bench::ready(), Bench::ready()];
    let meetings = Meetings::new([vec![0, 1]]);
    for (bench, wait) in benches.iter_mut().zip([0, late]) {
        let mut task = Task::new();
        for _ in 0..wait {
            task = task.enable();
        }
        bench.ecp.execute(task.meet(0).run(to(0.1, 0.0, 0.0))).unwrap();
    }
    let mut began = [None; 2];
    for period in 0..200 {
        let now = benches[0].now;
        // Each enabling of an already enabled effector takes one poll.
        for bench in &mut benches {
            bench.ecp.poll(now);
        }
        let [one, other] = benches;
        let mut ecps = [one.ecp, other.ecp];
        meetings.poll(&mut ecps);
        let [first, second] = ecps;
        benches = [Bench { ecp: first, ..one }, Bench { ecp: second, ..other }];
        for (bench, began) in benches.iter_mut().zip(&mut began) {
            bench.servo.period(now);
            bench.servo.publish();
            bench.now += PERIOD;
            if bench.servo.moves().next().is_some() {
                began.get_or_insert(period);
            }
        }
    }
    began.map(|began| began.expect("it never went on"))
}

#[test]
fn nobody_goes_on_from_a_meeting_before_the_last_has_come() {
    for late in [0, 1, 40] {
        let [first, second] = meet(late);
        assert_eq!(first, second, "{late}");
        assert!(first >= late, "{late}: {first}");
    }
}

#[test]
fn who_waits_in_vain_at_a_meeting_fails_in_time() {
    let mut bench = Bench::ready();
    let task = Task::new().meet(0).run(to(0.1, 0.0, 0.0));
    let mut config = CONFIG;
    config.meeting = Duration::from_secs(3);
    bench.ecp.config = config;
    let events = bench.run(task);
    let [EcpEvent { outcome: Err(EcpError::Unmet { waited }), .. }] = events[..] else {
        panic!("{events:?}");
    };
    assert!(waited > config.meeting && waited < config.meeting + 2 * PERIOD, "{waited:?}");
    assert_eq!(bench.servo.moves().count(), 0);
}
