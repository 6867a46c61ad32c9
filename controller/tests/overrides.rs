//! Speed override, pause and resume of an IRb-6, judged on the set-points that leave the servo.
//!
//! Each case runs one motion of five motors with different gears twice: without an override, and with pauses and overrides at
//! random moments. All motors must pass the same points of the path at the same motion time.

mod bench;
mod ideal;
#[path = "../src/random.rs"]
mod random;

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Duration;

use mrroc_controller::ecp::Task;
use mrroc_controller::generator::{
    Axes, AxesState, EffectorImage, Generator, GeneratorError, LineLimits, MotionLimits, Newsmooth, Next, Pace,
    Polynomial, Pose, Setpoint, SmoothPose, StraightLine, TimeOptimal,
};
use mrroc_controller::robot::{Arm, Irb6, Irb6Parameters, Space};
use servo::Phase;

use bench::{Bench, DT};
use random::Random;

const AXES: usize = 5;
const CASES: u64 = 600;
/// Servo periods of a macrostep.
const MACROSTEP: usize = 10;
/// Limits of the servo for each motor, rad/s and rad/s².
const SERVO: [f64; 2] = [250.0, 1500.0];
/// The middle of the workspace, rad.
const START: [f64; AXES] = [0.0, -FRAC_PI_2, 0.1, 0.6, 0.0];

fn arm() -> Arm {
    let robot = Irb6::new(&Irb6Parameters::irb6()).expect("its parameters are consistent");
    Arm::new(Arc::new(robot), Pose::identity())
}

/// A motion in joints, or along a line of the tool.
fn task(random: &mut Random, start: &Axes) -> Task {
    let limits = MotionLimits::uniform(0.8, 1.5, 30.0);
    let mut pose =
        || std::array::from_fn(|axis| if axis < AXES { START[axis] + random.within(-0.3, 0.3) } else { 0.0 });
    let poses: [Axes; 3] = [pose(), pose(), pose()];
    let task = Task::new().enable();
    match random.next() % 4 {
        0 => {
            let poses = poses.map(SmoothPose::fast).to_vec();
            task.run(Newsmooth::new(Space::Joint, AXES, limits, poses).expect("a sound motion"))
        }
        1 => task.run(Polynomial::quintic(Space::Joint, AXES, limits, poses[0]).expect("a sound motion")),
        2 => task.run(TimeOptimal::through(Space::Joint, AXES, limits, poses.to_vec()).expect("a sound motion")),
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
            task.run(StraightLine::new(arm(), target, tool, limits).expect("a sound motion"))
        }
    }
}

/// Set-points of one motion, rad, with their motion times in periods.
type Passed = Vec<(f64, [f64; AXES])>;

/// Executes the motion of `seed`. `act` is called after each cycle with the number of cycles since the motion began.
fn passed(seed: u64, mut act: impl FnMut(&Bench<AXES>, usize)) -> Passed {
    let mut random = Random(seed);
    let mut start = Axes::default();
    start[..AXES].copy_from_slice(&START);
    let motors = arm().motors(&start).expect("the arm stands there");
    let mut bench = Bench::<AXES>::new(arm(), &motors, SERVO, 8);
    let task = task(&mut random, &start);
    let (mut time, mut rate, mut cycles) = (0.0, 1.0, 0);
    let mut passed = vec![(0.0, std::array::from_fn(|axis| motors[axis]))];
    bench.execute(task, |bench, latest| {
        if latest.phase == Phase::Moving {
            time += 0.5 * (rate + latest.rate);
            passed.push((time, std::array::from_fn(|axis| latest.commanded[axis])));
            act(bench, cycles);
            cycles += 1;
        }
        rate = latest.rate;
    });
    check_limits(&bench.sent(), seed);
    passed
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

/// Position at a motion time, or at the end. In each macrostep the set-points lie on a quintic, which six of them determine.
fn on_path(whole: &[(f64, [f64; AXES])], time: f64, axis: usize) -> f64 {
    let time = time.min((whole.len() - 1) as f64);
    let macrostep = ((time / MACROSTEP as f64) as usize).min((whole.len() - 1) / MACROSTEP - 1);
    let nodes: [f64; 6] = std::array::from_fn(|node| 2.0 * node as f64);
    let within = time - (macrostep * MACROSTEP) as f64;
    let weight = |node: f64| {
        let others = nodes.iter().filter(|other| **other != node);
        others.map(|other| (within - other) / (node - other)).product::<f64>()
    };
    let at = |node: f64| whole[macrostep * MACROSTEP + node as usize].1[axis];
    nodes.iter().map(|node| weight(*node) * at(*node)).sum()
}

#[test]
fn a_motion_with_pauses_and_overrides_at_random_moments_passes_the_same_points() {
    let mut moments = 0;
    let mut farthest: f64 = 0.0;
    for seed in 0..CASES {
        let whole = passed(seed, |_, _| {});
        assert_eq!((whole.len() - 1) % MACROSTEP, 0, "seed {seed}: whole macrosteps");
        let mut random = Random(!seed);
        let pause = (random.next() % (whole.len() as u64 - 1)) as usize;
        let held = 30 + (random.next() % 200) as usize;
        let mut slowed_by: Option<usize> = None;
        let slowed = passed(seed, |bench, cycle| {
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
        let ended = pause + MACROSTEP >= whole.len() - 1;
        assert!(ended || slowed_by.is_some_and(|by| by <= MACROSTEP), "seed {seed}: {slowed_by:?} periods");
        assert_eq!(slowed.last().map(|it| it.1), whole.last().map(|it| it.1), "seed {seed}: the same end");
        for (time, positions) in &slowed {
            for (axis, position) in positions.iter().enumerate() {
                let aside = (position - on_path(&whole, *time, axis)).abs();
                farthest = farthest.max(aside);
                assert!(aside < 1e-9, "seed {seed}, motion time {time}, axis {axis}: {aside} rad from the path");
            }
        }
    }
    println!("{moments} moments of {CASES} motions: at most {farthest:.1e} rad from the path");
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
