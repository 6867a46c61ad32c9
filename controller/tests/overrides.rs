//! Speed override, pause and resume of an IRb-6, judged on the set-points that leave the servo.
//!
//! Each case runs one motion of five motors with different gears three times: without an override, at a constant one, and with
//! pauses and overrides at random moments. All motors must pass the same points of the path at the same motion time.
//! `MRROC_RANDOM_TIMES` multiplies the number of cases.

#![allow(clippy::disallowed_methods, reason = "the number of cases is read from the environment")]

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Duration;

use mrroc_controller::ecp::Task;
use mrroc_controller::generator::{
    Axes, AxesState, EffectorImage, Generator, GeneratorError, JerkLimited, LineLimits, MotionLimits, Newsmooth, Next,
    Pace, Polynomial, Pose, Setpoint, SmoothPose, StraightLine, TimeOptimal,
};
use mrroc_controller::robot::{Arm, Irb6, Irb6Parameters, Space};
use servo::Phase;

use crate::bench::{Bench, DT};
use crate::random::Random;

const AXES: usize = 5;
const CASES: u64 = 150;
/// Servo periods of a macrostep of the cell.
const MACROSTEP: usize = 10;
/// The constant override, a power of two: motion time then has no rounding errors.
const SLOW: f64 = 0.125;
/// Set-points at this override that determine the quintic of a period.
const NODES: [usize; 6] = [0, 1, 3, 5, 7, 8];
/// Limits of the servo for each motor, rad/s and rad/s².
const SERVO: [f64; 2] = [250.0, 1500.0];
/// The middle of the workspace, rad.
const START: [f64; AXES] = [0.0, -FRAC_PI_2, 0.1, 0.6, 0.0];

fn arm() -> Arm {
    let robot = Irb6::new(&Irb6Parameters::irb6()).expect("its parameters are consistent");
    Arm::new(Arc::new(robot), Pose::identity())
}

/// A generator in macrosteps of the cell, which the servo interpolates.
struct Coarse<G>(G);

impl<G: Generator<Every = ()>> Generator for Coarse<G> {
    type First = G::First;
    type Every = ();
    type Out = G::Out;
    type Memory = G::Memory;

    fn first_step(
        &mut self,
        images: &G::First,
        macrostep: Duration,
    ) -> Result<Next<G::Memory, G::Out>, GeneratorError> {
        self.0.first_step(images, macrostep)
    }

    fn terminal(&self, memory: &G::Memory, (): &()) -> bool {
        self.0.terminal(memory, &())
    }

    fn next_step(&self, memory: &G::Memory, (): &()) -> Result<Next<G::Memory, G::Out>, GeneratorError> {
        self.0.next_step(memory, &())
    }
}

/// A task of one motion, in macrosteps of the cell or of the generator.
fn alone(motion: impl Generator<Every = ()>, coarse: bool) -> Task {
    let task = Task::new();
    if coarse { task.run(Coarse(motion)) } else { task.run(motion) }
}

/// A motion in joints, or along a line of the tool, in macrosteps of this number of periods.
fn task(random: &mut Random, start: &Axes) -> (Task, usize) {
    let limits = MotionLimits::uniform(0.8, 1.5, 30.0);
    let mut pose =
        || std::array::from_fn(|axis| if axis < AXES { START[axis] + random.within(-0.3, 0.3) } else { 0.0 });
    let poses: [Axes; 3] = [pose(), pose(), pose()];
    let coarse = random.next().is_multiple_of(2);
    let task = match random.next() % 5 {
        0 => {
            let poses = poses.map(SmoothPose::fast).to_vec();
            alone(Newsmooth::new(Space::Joint, AXES, limits, poses).expect("a sound motion"), coarse)
        }
        1 => alone(Polynomial::quintic(Space::Joint, AXES, limits, poses[0]).expect("a sound motion"), coarse),
        2 => {
            let motion = TimeOptimal::through(Space::Joint, AXES, limits, poses.to_vec());
            alone(motion.expect("a sound motion"), coarse)
        }
        3 => alone(JerkLimited::new(Space::Joint, AXES, limits, &poses[..1]).expect("a sound motion"), coarse),
        _ => {
            let mut target = arm().forward(start).expect("the arm stands there");
            // The tool of an arm with five axes stays in the plane of the arm.
            target.translation.vector.x += random.within(-0.08, 0.08);
            target.translation.vector.z += random.within(-0.08, 0.08);
            let tool = LineLimits {
                max_velocity: 0.25,
                max_acceleration: 1.0,
                max_jerk: 10.0,
                max_angular_velocity: 1.0,
                max_angular_acceleration: 4.0,
                max_angular_jerk: 40.0,
            };
            alone(StraightLine::new(arm(), target, tool, limits).expect("a sound motion"), coarse)
        }
    };
    (task, if coarse { MACROSTEP } else { 1 })
}

/// Set-points of one motion, rad, with their motion times in periods.
struct Passed {
    points: Vec<(f64, [f64; AXES])>,
    /// Periods of a macrostep.
    macrostep: usize,
}

/// Executes the motion of `seed`, which begins at this override. `act` is called after each cycle with the number of cycles
/// since the motion began.
fn passed(seed: u64, speed: f64, mut act: impl FnMut(&Bench<AXES>, usize)) -> Passed {
    let mut random = Random(seed);
    let mut start = Axes::default();
    start[..AXES].copy_from_slice(&START);
    let motors = arm().motors(&start).expect("the arm stands there");
    let mut bench = Bench::<AXES>::new(arm(), &motors, SERVO, 8);
    let (task, macrostep) = task(&mut random, &start);
    bench.servo.speed_override().set(speed).expect("a fraction");
    bench.execute(Task::new().enable(), |_, _| {});
    bench.settle(speed);
    let (mut time, mut rate, mut cycles) = (0.0, speed, 0);
    let mut points = vec![(0.0, std::array::from_fn(|axis| motors[axis]))];
    bench.execute(task, |bench, latest| {
        if latest.phase == Phase::Moving {
            time += 0.5 * (rate + latest.rate);
            points.push((time, std::array::from_fn(|axis| latest.commanded[axis])));
            act(bench, cycles);
            cycles += 1;
        }
        rate = latest.rate;
    });
    check_limits(&bench.sent(), seed);
    Passed { points, macrostep }
}

fn check_limits(sent: &[[f64; AXES]], seed: u64) {
    for three in sent.windows(3) {
        let [first, second, third] = three else { continue };
        for (axis, ((a, b), c)) in first.iter().zip(second).zip(third).enumerate() {
            let (velocity, acceleration) = ((c - b) / DT, (c - 2.0 * b + a) / (DT * DT));
            let kept = velocity.abs() <= SERVO[0] * 1.001 && acceleration.abs() <= SERVO[1] * 1.001;
            assert!(kept, "seed {seed}, axis {axis}: {velocity} rad/s, {acceleration} rad/s²");
        }
    }
}

/// Position at a motion time, or at the end, by the set-points at the override [`SLOW`]. In each macrostep they lie on a
/// quintic, which six of them determine.
fn on_path(slow: &Passed, time: f64, axis: usize) -> f64 {
    let last = slow.points.len() - 1;
    let at = (time / SLOW).min(last as f64);
    let length = NODES[5] * slow.macrostep;
    let first = ((at / length as f64) as usize).min(last / length - 1) * length;
    let nodes = NODES.map(|node| (first + node * slow.macrostep) as f64);
    let weight = |node: f64| {
        let others = nodes.iter().filter(|other| **other != node);
        others.map(|other| (at - other) / (node - other)).product::<f64>()
    };
    nodes.iter().map(|node| weight(*node) * slow.points[*node as usize].1[axis]).sum()
}

#[test]
fn a_motion_with_pauses_and_overrides_at_random_moments_passes_the_same_points() {
    let times = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    let mut moments = 0;
    let mut farthest: f64 = 0.0;
    for seed in 0..CASES * times {
        let slow = passed(seed, SLOW, |_, _| {});
        let whole = passed(seed, 1.0, |_, _| {});
        let last = whole.points.len() - 1;
        assert_eq!(last % whole.macrostep, 0, "seed {seed}: whole macrosteps");
        let mut random = Random(!seed);
        let pause = (random.next() % last as u64) as usize;
        let held = 30 + (random.next() % 200) as usize;
        let mut slowed_by: Option<usize> = None;
        let slowed = passed(seed, 1.0, |bench, cycle| {
            let speed = bench.servo.speed_override();
            let rate = bench.ecp.latest().rate;
            match cycle {
                _ if cycle == pause => speed.pause(),
                _ if cycle == pause + held => speed.resume(),
                // Half of the cases only pause.
                _ if seed.is_multiple_of(2) && random.next().is_multiple_of(40) => {
                    moments += 1;
                    speed.set(random.within(0.0, 1.0).max(0.02)).expect("a fraction");
                }
                _ => {}
            }
            if cycle > pause && rate < 1.0 {
                slowed_by.get_or_insert(cycle - pause);
            }
        });
        moments += 1;
        let ended = pause + MACROSTEP >= last;
        assert!(ended || slowed_by.is_some_and(|by| by <= MACROSTEP), "seed {seed}: {slowed_by:?} periods");
        let end = |passed: &Passed| passed.points.last().map(|it| it.1);
        assert_eq!(end(&slowed), end(&whole), "seed {seed}: the same end");
        for (time, positions) in whole.points.iter().chain(&slowed.points) {
            for (axis, position) in positions.iter().enumerate() {
                let aside = (position - on_path(&slow, *time, axis)).abs();
                farthest = farthest.max(aside);
                assert!(aside < 1e-9, "seed {seed}, motion time {time}, axis {axis}: {aside} rad from the path");
            }
        }
    }
    println!("{moments} moments of {} motions: at most {farthest:.1e} rad from the path", CASES * times);
}

/// Swings the column by continuous feedback. Each next step reads the report of the macrostep before.
struct Swing(Pace);

/// Macrosteps of a swing, and its amplitude, rad.
const SWING: u32 = 400;
const AMPLITUDE: f64 = 0.02;

impl Generator for Swing {
    type First = ();
    type Every = EffectorImage;
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        self.0
    }

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &EffectorImage) -> bool {
        *done == SWING
    }

    fn next_step(&self, done: &u32, _: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        let done = done + 1;
        let turn = std::f64::consts::TAU * f64::from(done) / f64::from(SWING);
        let rate = std::f64::consts::TAU / (f64::from(SWING) * f64::from(self.0.periods) * DT);
        let (mut position, mut velocity) = (Axes::default(), Axes::default());
        position[..AXES].copy_from_slice(&START);
        position[0] += AMPLITUDE * (1.0 - turn.cos());
        velocity[0] = if done == SWING { 0.0 } else { AMPLITUDE * rate * turn.sin() };
        Ok(Next::command(Setpoint::Joints(AxesState::new(position, velocity)), done))
    }
}

#[test]
fn continuous_feedback_up_to_the_last_period_of_a_macrostep_goes_on_under_any_override() {
    for seed in 0..100 {
        let mut random = Random(seed);
        let periods = 1 + (random.next() % 4) as u16;
        let mut start = Axes::default();
        start[..AXES].copy_from_slice(&START);
        let motors = arm().motors(&start).expect("the arm stands there");
        let mut bench = Bench::<AXES>::new(arm(), &motors, SERVO, 8);
        let swing = Swing(Pace { periods, read_at: periods });
        bench.execute(Task::new().enable().run(swing), |bench, _| {
            if random.next().is_multiple_of(30) {
                let speed = bench.servo.speed_override();
                speed.set(random.within(0.1, 1.5).min(1.0)).expect("a fraction");
            }
        });
        let sent = bench.sent();
        assert_eq!(sent.last().map(|at| at[0]), sent.first().map(|at| at[0]), "seed {seed}: the column is back");
    }
}
