//! Random motions of seven axes, judged on the set-points that leave the servo.
//!
//! Each case runs the real servo and the real effector control process on ideal drives, in virtual time. The motions are
//! trapezoidal and jerk-limited ones, chains at speed, and motions that are replaced under way. In half of the cases the
//! speed override changes at random. `MRROC_RANDOM_TIMES` multiplies the number of cases.

#![allow(clippy::disallowed_methods, reason = "the number of cases is read from the environment")]

#[path = "../src/random.rs"]
mod random;

use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint};
use mrroc_controller::ecp::{Ecp, EcpConfig, Task};
use mrroc_controller::generator::{Axes, JerkLimited, MotionLimits, Newsmooth, Pace, Pose, SmoothPose};
use mrroc_controller::robot::{Arm, Polycrank, PolycrankParameters, Space};
use random::Random;
use servo::{EffectorConfig, PositionLoop, Servo, ServoAxisConfig, ServoConfig};

const AXES: usize = 7;
const PERIOD: Duration = Duration::from_millis(2);
const DT: f64 = 0.002;
const CASES: u64 = 1000;

/// Limits of velocity, acceleration and jerk of each motor, rad and s, for planning. A stop from the greatest velocity takes
/// longer than the shortest pause, so that the acceleration limits bound the pause.
const LIMITS: [f64; 3] = [250.0, 500.0, 5000.0];

/// Acceleration limit of the servo, relative to that of the plan.
const ROOM: f64 = 2.0;

/// Ideal drives of one robot.
struct Ideal {
    commands: Vec<AxisCommand>,
    latched: Vec<AxisCommand>,
    position: [f64; AXES],
    now: Instant,
    /// Set-points sent, cycle by cycle.
    sent: Arc<Mutex<Vec<[f64; AXES]>>>,
}

impl DriveGroup for Ideal {
    fn axes(&self) -> usize {
        AXES
    }
    fn delay(&self) -> usize {
        2
    }
    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }
    fn read(&mut self, _: Instant, states: &mut [AxisState]) {
        for (axis, state) in states.iter_mut().enumerate() {
            let on = !matches!(self.latched[axis], AxisCommand::Off | AxisCommand::ResetFault);
            *state = AxisState {
                sampled: self.now,
                position: self.position[axis],
                power: if on { Power::On } else { Power::Off },
                homing: Homing::Attained,
                following: on,
                ..AxisState::default()
            };
        }
    }
    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        self.commands.copy_from_slice(commands);
    }
    fn send(&mut self, now: Instant) -> bool {
        self.now = now;
        for (axis, command) in self.latched.iter().enumerate() {
            if let AxisCommand::Follow(Setpoint::Position(position)) = command {
                self.position[axis] = position.get();
            }
        }
        self.latched.copy_from_slice(&self.commands);
        let asked = |axis: usize| match self.commands[axis] {
            AxisCommand::Follow(Setpoint::Position(position)) => position.get(),
            _ => self.position[axis],
        };
        self.sent.lock().expect("one thread").push(std::array::from_fn(asked));
        true
    }
    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.within(0.0, bound as f64) as u64
    }
    fn axes(&mut self, most: f64) -> Axes {
        std::array::from_fn(|axis| if axis < AXES { self.within(-most, most) } else { 0.0 })
    }
}

fn limits() -> MotionLimits {
    MotionLimits::uniform(LIMITS[0], LIMITS[1], LIMITS[2])
}

fn jerk_limited(random: &mut Random, last: bool) -> (JerkLimited, Axes) {
    let target = random.axes(100.0);
    let motion = JerkLimited::new(Space::Motor, AXES, limits(), &[target]).expect("a sound motion");
    if last {
        return (motion, target);
    }
    let velocity = random.axes(150.0);
    (motion.ending_at(velocity).expect("a sound velocity"), target)
}

/// A task, its end, and whether it consists of trapezoids.
fn task(random: &mut Random) -> (Task, Axes, bool) {
    let task = Task::new().enable();
    match random.below(3) {
        0 => {
            let poses: Vec<SmoothPose> = (0..=random.below(3)).map(|_| SmoothPose::fast(random.axes(100.0))).collect();
            let end = poses[poses.len() - 1].position;
            let motion = Newsmooth::new(Space::Motor, AXES, limits(), poses).expect("a sound motion");
            (task.run(motion), end, true)
        }
        1 => {
            let (motion, end) = jerk_limited(random, true);
            (task.run(motion), end, false)
        }
        _ => {
            let (one, _) = jerk_limited(random, false);
            let (two, _) = jerk_limited(random, false);
            let (three, end) = jerk_limited(random, true);
            (task.run(one).run(two).run(three), end, false)
        }
    }
}

fn servo(sent: &Arc<Mutex<Vec<[f64; AXES]>>>) -> (Servo, servo::EffectorLink) {
    let axis = |index_in_group| ServoAxisConfig {
        group: 0,
        index_in_group,
        min_position: -1e3,
        max_position: 1e3,
        max_velocity: LIMITS[0] * 1.2,
        max_acceleration: LIMITS[1] * ROOM,
        following_error: 10.0,
        homing_order: 1,
        increments_per_radian: 1000.0,
        position_loop: PositionLoop::Drive,
        torque_offset: None,
        homing: None,
    };
    let effector = EffectorConfig {
        name: "polycrank".into(),
        axes: (0..AXES).map(axis).collect(),
        queue: 32,
        enabling_timeout: Duration::from_secs(1),
        homing_timeout: Duration::from_secs(1),
    };
    let off = vec![AxisCommand::Off; AXES];
    let ideal = Ideal {
        commands: off.clone(),
        latched: off,
        position: [0.0; AXES],
        now: Instant::ZERO,
        sent: Arc::clone(sent),
    };
    let config = ServoConfig { period: PERIOD, max_missed_in_row: 1, effectors: vec![effector] };
    let (servo, mut links) = Servo::new(&config, vec![Box::new(ideal)]).expect("a sound servo");
    (servo, links.remove(0))
}

/// Greatest excess over the planned limits, as factors of velocity, acceleration and jerk.
#[derive(Clone, Copy, Debug, Default)]
struct Peaks([f64; 3]);

impl Peaks {
    fn take(&mut self, positions: &[[f64; AXES]]) {
        for four in positions.windows(4) {
            let [first, second, third, fourth] = four else { continue };
            for (((a, b), c), d) in first.iter().zip(second).zip(third).zip(fourth) {
                let derivatives =
                    [(d - c) / DT, (d - 2.0 * c + b) / DT.powi(2), (d - 3.0 * c + 3.0 * b - a) / DT.powi(3)];
                for (peak, (value, limit)) in self.0.iter_mut().zip(derivatives.into_iter().zip(LIMITS)) {
                    *peak = peak.max(value.abs() / limit);
                }
            }
        }
    }
}

/// Runs one case to its end and returns its peaks, and whether it has trapezoids or an override.
fn run(seed: u64) -> (Peaks, bool, bool) {
    let mut random = Random(seed);
    let sent = Arc::default();
    let (mut servo, link) = servo(&sent);
    let robot = Polycrank::new(&PolycrankParameters::polycrank()).expect("its parameters are consistent");
    let config = EcpConfig {
        period: PERIOD,
        pace: Pace { periods: 10, read_at: 8 },
        macrosteps_ahead: 1 + random.below(8) as u16,
        silence: Duration::from_secs(1),
        switching: Duration::from_secs(2),
        planning: Duration::from_secs(60),
        homing: Duration::from_secs(2),
        meeting: Duration::from_secs(1),
    };
    let mut ecp = Ecp::new(Arm::new(Arc::new(robot), Pose::identity()), link, config);
    let (task, mut end, trapezoids) = task(&mut random);
    let mut last_instruction = task.len() - 1;
    ecp.execute(task).expect("nothing is under way");
    let slowed = random.below(2) == 0;
    let mut replaced = if trapezoids { 0 } else { random.below(3) };
    let mut now = Instant::ZERO;
    let mut done = false;
    for cycle in 0..20_000_u64 {
        while let Some(event) = ecp.poll(now) {
            assert_eq!(event.outcome, Ok(()), "seed {seed}, cycle {cycle}, instruction {}", event.instruction);
        }
        if ecp.status().instruction.is_none() && cycle > 50 {
            done = true;
            break;
        }
        if replaced > 0 && random.below(100) == 0 {
            let (motion, target) = jerk_limited(&mut random, true);
            if ecp.replace(motion).is_ok() {
                replaced -= 1;
                if ecp.status().instruction == Some(last_instruction) {
                    end = target;
                }
                last_instruction += 1;
            }
        }
        if slowed && random.below(100) == 0 {
            let speed = servo.speed_override();
            match random.below(4) {
                0 if cycle < 5000 => speed.pause(),
                1 => speed.set(random.within(0.05, 1.0)).expect("a fraction"),
                _ => speed.resume(),
            }
        }
        servo.step(now);
        now += PERIOD;
        assert_eq!(servo.fault(0), None, "seed {seed}, cycle {cycle}");
    }
    assert!(done, "seed {seed} never ends");
    let positions = sent.lock().expect("one thread");
    let last = positions.last().expect("it moved");
    for axis in 0..AXES {
        assert!((last[axis] - end[axis]).abs() < 1e-9, "seed {seed}, axis {axis}: {} for {}", last[axis], end[axis]);
    }
    let mut peaks = Peaks::default();
    peaks.take(&positions);
    (peaks, trapezoids, slowed)
}

#[test]
fn set_points_keep_their_limits_and_reach_the_end() {
    let times = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    let mut worst = [[Peaks::default(); 2]; 2];
    for seed in 0..CASES * times {
        let (peaks, trapezoids, slowed) = run(seed);
        let worst = &mut worst[usize::from(trapezoids)][usize::from(slowed)].0;
        for (worst, peak) in worst.iter_mut().zip(peaks.0) {
            *worst = worst.max(peak);
        }
    }
    println!("{} motions; velocity, acceleration, jerk relative to the plan's limits: {worst:?}", CASES * times);
    let [[jerk_limited, slowed], [trapezoid, slowed_trapezoid]] = worst.map(|pair| pair.map(|peaks| peaks.0));
    assert!(jerk_limited[0] < 1.001 && jerk_limited[1] < 1.05 && jerk_limited[2] < 2.0, "{jerk_limited:?}");
    assert!(trapezoid[0] < 1.02 && trapezoid[1] < 1.9, "{trapezoid:?}");
    // The override uses the room of the servo's limits, and changes the acceleration over some periods.
    for [velocity, acceleration, _] in [slowed, slowed_trapezoid] {
        assert!(velocity < 1.06 && acceleration < ROOM * 1.001, "{velocity} {acceleration}");
    }
    assert!(slowed[2] < 12.0, "{slowed:?}");
}
