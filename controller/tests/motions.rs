//! Random motions of seven axes, judged on the set-points that leave the servo.
//!
//! Each case runs the real servo and the real effector control process on ideal drives, in virtual time. The motions are
//! trapezoidal and jerk-limited ones, chains at speed, and motions that are replaced under way. In half of the cases the
//! speed override changes at random. `MRROC_RANDOM_TIMES` multiplies the number of cases.

#![allow(clippy::disallowed_methods, reason = "the number of cases is read from the environment")]

mod ideal;
#[path = "../src/random.rs"]
mod random;

use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use mrroc_controller::ecp::{Ecp, EcpConfig, Task};
use mrroc_controller::generator::{Axes, JerkLimited, MotionLimits, Newsmooth, Pace, Pose, SmoothPose, TimeOptimal};
use mrroc_controller::robot::{Arm, Polycrank, PolycrankParameters, Space};

use ideal::{PERIOD, Sent, servo};
use random::Random;

const AXES: usize = 7;
const DT: f64 = 0.002;
const CASES: u64 = 1000;

/// Limits of velocity, acceleration and jerk of each motor, rad and s, for planning. A stop from the greatest velocity takes
/// longer than the shortest pause, so that the acceleration limits bound the pause.
const LIMITS: [f64; 3] = [250.0, 500.0, 5000.0];

/// Acceleration limit of the servo, relative to that of the plan.
const ROOM: f64 = 2.0;

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

/// A time-optimal motion through two to six way-points, its end, and that no generator replaces it.
fn time_optimal(random: &mut Random) -> (Task, Axes, bool) {
    let points: Vec<Axes> = (0..2 + random.below(5)).map(|_| random.axes(100.0)).collect();
    let end = points[points.len() - 1];
    let motion = TimeOptimal::through(Space::Motor, AXES, limits(), points).expect("a sound motion");
    (Task::new().enable().run(motion), end, true)
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
fn run(seed: u64, task: fn(&mut Random) -> (Task, Axes, bool)) -> (Peaks, bool, bool) {
    let mut random = Random(seed);
    let sent = Sent::default();
    let (mut servo, link) = servo([0.0; AXES], LIMITS[0] * 1.2, LIMITS[1] * ROOM, &sent);
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
        let (peaks, trapezoids, slowed) = run(seed, task);
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

#[test]
fn time_optimal_motions_keep_the_limits_of_the_servo_and_reach_the_end() {
    let mut worst = [Peaks::default(); 2];
    for seed in 0..CASES / 5 {
        let (peaks, _, slowed) = run(seed, time_optimal);
        let worst = &mut worst[usize::from(slowed)].0;
        for (worst, peak) in worst.iter_mut().zip(peaks.0) {
            *worst = worst.max(peak);
        }
    }
    let [unslowed, slowed] = worst.map(|peaks| peaks.0);
    println!("velocity, acceleration, jerk relative to the plan's limits: {unslowed:?}, with overrides {slowed:?}");
    assert!(unslowed[0] < 1.05 && unslowed[1] < 1.9, "{unslowed:?}");
    assert!(slowed[0] < 1.06 && slowed[1] < ROOM * 1.001, "{slowed:?}");
}
