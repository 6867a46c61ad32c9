//! Random motions of seven axes of every planned kind, judged on the set-points that leave the servo.
//!
//! Each case runs the real servo and the real effector control process on ideal drives, in virtual time. In half of the
//! cases the speed override changes at random, down to a pause. `MRROC_RANDOM_TIMES` multiplies the number of cases: with
//! 100 there are 105,000.

#![allow(clippy::disallowed_methods, reason = "the number of cases is read from the environment")]

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

use mrroc_controller::ecp::Task;
use mrroc_controller::generator::{
    Axes, JerkLimited, MotionLimits, Newsmooth, Polynomial, Pose, SmoothPose, TimeOptimal,
};
use mrroc_controller::robot::{Arm, Polycrank, PolycrankParameters, Space};
use rsruckig::prelude::{InputParameter, Ruckig, ThrowErrorHandler, Trajectory};

use crate::bench::{Bench, DT};
use crate::random::Random;

const AXES: usize = 7;
const CASES: u64 = 150;

/// Limits of velocity, acceleration and jerk of each motor, rad and s, for planning. A stop from the greatest velocity takes
/// longer than the shortest pause, so that the acceleration limits bound the pause.
const LIMITS: [f64; 3] = [250.0, 500.0, 5000.0];

/// Limits of velocity and acceleration of the servo, relative to those of the plan.
const ROOM: [f64; 2] = [1.2, 2.0];

/// Greatest jerk with overrides, relative to the limit of the plan: an override adds at most as much as is planned.
const SLOWED_JERK: f64 = 2.0;

/// Accepted excess over a limit, relative: rounding errors of finite differences. The solver meets positions within
/// 10⁻⁸ rad, which is up to 10 rad/s³ over the cube of a period.
const ROUNDING: f64 = 1e-6;
const JERK_ROUNDING: f64 = 2e-3;

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

/// Kind of the motions of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    JerkLimited,
    /// Three jerk-limited motions, of which two end at speed.
    Chain,
    /// Jerk-limited motions that are replaced under way.
    Replaced,
    Quintic,
    Cubic,
    Trapezoids,
    TimeOptimal,
}

impl Kind {
    const ALL: [Self; 7] = [
        Self::JerkLimited,
        Self::Chain,
        Self::Replaced,
        Self::Quintic,
        Self::Cubic,
        Self::Trapezoids,
        Self::TimeOptimal,
    ];

    /// Greatest velocity, acceleration and jerk of the set-points without an override, relative to the limits of the
    /// plan. The acceleration of the last three kinds jumps, so that they have no limit of jerk.
    fn bounds(self) -> [f64; 3] {
        let jerk = match self {
            Self::JerkLimited | Self::Chain | Self::Replaced | Self::Quintic => 1.0 + JERK_ROUNDING,
            Self::Cubic | Self::Trapezoids | Self::TimeOptimal => f64::INFINITY,
        };
        [1.0 + ROUNDING, 1.0 + ROUNDING, jerk]
    }
}

/// The motions of one case.
struct Case {
    task: Task,
    end: Axes,
    /// Duration of the motion by a closed form or by Ruckig, s, and the step by whose multiple it is rounded up.
    duration: Option<(f64, f64)>,
}

fn jerk_limited(random: &mut Random, last: bool) -> (JerkLimited, Axes) {
    let target = random.axes(200.0);
    let motion = JerkLimited::new(Space::Motor, AXES, limits(), &[target]).expect("a sound motion");
    if last {
        return (motion, target);
    }
    let velocity = random.axes(150.0);
    (motion.ending_at(velocity).expect("a sound velocity"), target)
}

/// Duration of the time-optimal jerk-limited motion from zero to `target`, s.
fn ruckig(target: &Axes) -> f64 {
    let mut input = InputParameter::<AXES>::new(None);
    for (axis, target) in target.iter().enumerate().take(AXES) {
        input.target_position[axis] = *target;
        (input.max_velocity[axis], input.max_acceleration[axis]) = (LIMITS[0], LIMITS[1]);
        input.max_jerk[axis] = LIMITS[2];
    }
    let mut trajectory = Trajectory::new(None);
    Ruckig::<AXES, ThrowErrorHandler>::new(None, 1.0).calculate(&input, &mut trajectory).expect("a sound motion");
    trajectory.get_duration()
}

impl Case {
    fn of(kind: Kind, random: &mut Random) -> Self {
        let task = Task::new().enable();
        let farthest = |target: &Axes| target.iter().fold(0.0_f64, |farthest, it| farthest.max(it.abs()));
        let [v, a, j] = LIMITS;
        match kind {
            Kind::JerkLimited => {
                let (motion, end) = jerk_limited(random, true);
                Self { task: task.run(motion), end, duration: Some((ruckig(&end), DT)) }
            }
            Kind::Replaced => {
                let (motion, end) = jerk_limited(random, true);
                Self { task: task.run(motion), end, duration: None }
            }
            Kind::Chain => {
                let (one, _) = jerk_limited(random, false);
                let (two, _) = jerk_limited(random, false);
                let (three, end) = jerk_limited(random, true);
                Self { task: task.run(one).run(two).run(three), end, duration: None }
            }
            Kind::Cubic => {
                let end = random.axes(200.0);
                let motion = Polynomial::cubic(Space::Motor, AXES, limits(), end).expect("a sound motion");
                let d = farthest(&end);
                let shortest = (1.5 * d / v).max((6.0 * d / a).sqrt()).max((12.0 * d / j).cbrt());
                Self { task: task.run(motion), end, duration: Some((shortest, DT)) }
            }
            Kind::Quintic => {
                let end = random.axes(200.0);
                let motion = Polynomial::quintic(Space::Motor, AXES, limits(), end).expect("a sound motion");
                let d = farthest(&end);
                let by_acceleration = (10.0 * d / (3.0_f64.sqrt() * a)).sqrt();
                let shortest = (1.875 * d / v).max(by_acceleration).max((60.0 * d / j).cbrt());
                Self { task: task.run(motion), end, duration: Some((shortest, DT)) }
            }
            Kind::Trapezoids => {
                let poses: Vec<SmoothPose> =
                    (0..=random.below(3)).map(|_| SmoothPose::fast(random.axes(200.0))).collect();
                let end = poses[poses.len() - 1].position;
                let d = farthest(&end);
                let shortest = if d > v * v / a { d / v + v / a } else { 2.0 * (d / a).sqrt() };
                let duration = (poses.len() == 1).then_some((shortest, DT));
                let motion = Newsmooth::new(Space::Motor, AXES, limits(), poses).expect("a sound motion");
                Self { task: task.run(motion), end, duration }
            }
            Kind::TimeOptimal => {
                let points: Vec<Axes> = (0..2 + random.below(5)).map(|_| random.axes(200.0)).collect();
                let end = points[points.len() - 1];
                let motion = TimeOptimal::through(Space::Motor, AXES, limits(), points).expect("a sound motion");
                Self { task: task.run(motion), end, duration: None }
            }
        }
    }
}

/// Greatest velocity, acceleration and jerk, relative to the limits of the plan.
type Peaks = [f64; 3];

fn peaks(positions: &[[f64; AXES]]) -> Peaks {
    let mut peaks = Peaks::default();
    for four in positions.windows(4) {
        let [first, second, third, fourth] = four else { continue };
        for (((a, b), c), d) in first.iter().zip(second).zip(third).zip(fourth) {
            let derivatives = [(d - c) / DT, (d - 2.0 * c + b) / DT.powi(2), (d - 3.0 * c + 3.0 * b - a) / DT.powi(3)];
            for (peak, (value, limit)) in peaks.iter_mut().zip(derivatives.into_iter().zip(LIMITS)) {
                *peak = peak.max(value.abs() / limit);
            }
        }
    }
    peaks
}

/// Number of periods from the last set-point at the start to the first one at the end.
fn periods(positions: &[[f64; AXES]]) -> usize {
    let [start, end] = [0, positions.len() - 1].map(|at| positions[at]);
    let begin = positions.iter().rposition(|at| *at == start).unwrap_or(0);
    let arrived = positions.iter().position(|at| *at == end).unwrap_or(0);
    arrived - begin
}

/// Runs one case to its end and returns its peaks.
fn run(kind: Kind, random: &mut Random, slowed: bool) -> Peaks {
    let robot = Polycrank::new(&PolycrankParameters::polycrank()).expect("its parameters are consistent");
    let arm = Arm::new(Arc::new(robot), Pose::identity());
    let servo = [LIMITS[0] * ROOM[0], LIMITS[1] * ROOM[1]];
    let mut bench = Bench::<AXES>::new(arm, &Axes::default(), servo, 1 + random.below(8) as u16);
    let Case { task, mut end, duration } = Case::of(kind, random);
    let mut last_instruction = task.len() - 1;
    let mut replaced = if kind == Kind::Replaced { 1 + random.below(3) } else { 0 };
    let mut cycle = 0;
    bench.execute(task, |bench, _| {
        cycle += 1;
        if replaced > 0 && random.below(100) == 0 {
            let (motion, target) = jerk_limited(random, true);
            if bench.ecp.replace(motion).is_ok() {
                replaced -= 1;
                if bench.ecp.status().instruction == Some(last_instruction) {
                    end = target;
                }
                last_instruction += 1;
            }
        }
        if slowed && random.below(100) == 0 {
            let speed = bench.servo.speed_override();
            match random.below(4) {
                0 if cycle < 5000 => speed.pause(),
                1 => speed.set(random.within(0.05, 1.0)).expect("a fraction"),
                _ => speed.resume(),
            }
        }
    });
    let positions = bench.sent();
    let last = positions.last().expect("it moved");
    for axis in 0..AXES {
        assert!((last[axis] - end[axis]).abs() < 1e-9, "axis {axis}: {} for {}", last[axis], end[axis]);
    }
    if let Some((shortest, step)) = duration.filter(|_| !slowed) {
        let lasting = periods(&positions) as f64 * DT;
        assert!(lasting > shortest - 1e-6 && lasting < shortest + step + 1e-6, "{lasting} s for {shortest} s");
        if kind == Kind::JerkLimited {
            assert!(lasting < 1.01 * shortest, "{lasting} s, Ruckig {shortest} s");
        }
    }
    peaks(&positions)
}

#[test]
fn set_points_of_every_kind_keep_their_limits_and_reach_the_end_in_the_known_time() {
    let times = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    println!("kind, motions, greatest velocity, acceleration and jerk relative to the plan's limits");
    for kind in Kind::ALL {
        let mut worst = [Peaks::default(); 2];
        for seed in 0..CASES * times {
            let slowed = seed % 2 == 1;
            let case = || run(kind, &mut Random(seed), slowed);
            let peaks = catch_unwind(AssertUnwindSafe(case)).unwrap_or_else(|panic| {
                eprintln!("{kind:?}, seed {seed}");
                resume_unwind(panic)
            });
            for (worst, peak) in worst[usize::from(slowed)].iter_mut().zip(peaks) {
                *worst = worst.max(peak);
            }
        }
        let [unslowed, slowed] = worst;
        println!("{kind:?}, {}, {unslowed:.4?}, with overrides {slowed:.3?}", CASES * times);
        let kept = unslowed.iter().zip(kind.bounds()).all(|(peak, bound)| *peak <= bound);
        assert!(kept, "{kind:?}: {unslowed:?}");
        // An override never speeds a motion up, and changes the acceleration within the limits of the servo.
        assert!(slowed[0] <= kind.bounds()[0] && slowed[1] <= ROOM[1] * 1.001, "{kind:?}: {slowed:?}");
        assert!(slowed[2] <= SLOWED_JERK * kind.bounds()[2], "{kind:?}: {slowed:?}");
    }
}
