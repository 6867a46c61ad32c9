//! Random lines of the tool of an IRp-6, judged on the set-points that leave the servo. `MRROC_RANDOM_TIMES` multiplies the
//! number of lines.

#![allow(clippy::disallowed_methods, reason = "the number of cases is read from the environment")]

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use mrroc_controller::ecp::Task;
use mrroc_controller::generator::{Axes, LineLimits, MotionLimits, Pose, StraightLine};
use mrroc_controller::robot::{Arm, Irp6, Irp6Parameters};
use nalgebra::Vector3;

use crate::bench::{Bench, DT};
use crate::random::Random;

const AXES: usize = 6;
const CASES: u64 = 100;
/// Joints in the middle of the workspace, the wrist bent, rad.
const START: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];
/// Limits of the tool: velocity, acceleration and jerk, m and s.
const LIMITS: [f64; 3] = [0.25, 1.0, 10.0];
/// Accepted excess over a limit, relative: rounding errors of kinematics over the cube of a period.
const ROUNDING: f64 = 2e-3;

fn arm() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).expect("its parameters are consistent");
    Arm::new(Arc::new(robot), Pose::translation(0.0, 0.0, 0.25))
}

/// Position of the tool with its motors here, m.
fn tool(arm: &Arm, motors: &[f64; AXES]) -> Vector3<f64> {
    let mut all = Axes::default();
    all[..AXES].copy_from_slice(motors);
    let joints = arm.joints(&all).expect("the arm was there");
    arm.forward(&joints).expect("the arm was there").translation.vector
}

#[test]
fn the_tool_keeps_its_limits_and_its_line_and_reaches_the_end() {
    let times = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    let arm = arm();
    let (mut worst, mut farthest) = ([0.0_f64; 3], 0.0_f64);
    for seed in 0..CASES * times {
        let mut random = Random(seed);
        let start = arm.forward(&START).expect("the arm stands there");
        let mut target = start;
        target.translation.vector += Vector3::from_fn(|_, _| random.within(-0.12, 0.12));
        let limits = LineLimits {
            max_velocity: LIMITS[0],
            max_acceleration: LIMITS[1],
            max_jerk: LIMITS[2],
            max_angular_velocity: 1.0,
            max_angular_acceleration: 4.0,
            max_angular_jerk: 40.0,
        };
        let line = StraightLine::new(arm.clone(), target, limits, MotionLimits::uniform(1.5, 7.0, 70.0));
        let motors = arm.motors(&START).expect("the arm stands there");
        let mut bench = Bench::<AXES>::new(arm.clone(), &motors, [600.0, 6000.0], 8);
        bench.execute(Task::new().enable().run(line.expect("sound limits")), |_, _| {});
        let path: Vec<_> = bench.sent().iter().map(|motors| tool(&arm, motors)).collect();
        let along = (target.translation.vector - start.translation.vector).normalize();
        for position in &path {
            let offset = position - start.translation.vector;
            farthest = farthest.max((offset - along * along.dot(&offset)).norm());
        }
        let left = (path[path.len() - 1] - target.translation.vector).norm();
        assert!(left < 1e-9, "seed {seed}: {left} m from the target");
        for four in path.windows(4) {
            let [a, b, c, d] = [four[0], four[1], four[2], four[3]];
            let derivatives = [(d - c) / DT, (d - 2.0 * c + b) / DT.powi(2), (d - 3.0 * c + 3.0 * b - a) / DT.powi(3)];
            for (worst, (value, limit)) in worst.iter_mut().zip(derivatives.into_iter().zip(LIMITS)) {
                *worst = worst.max(value.norm() / limit);
            }
        }
    }
    println!("{} lines: velocity, acceleration, jerk relative to their limits: {worst:.4?}", CASES * times);
    println!("at most {farthest:.1e} m from the line");
    assert!(worst.into_iter().all(|peak| peak <= 1.0 + ROUNDING), "{worst:?}");
    assert!(farthest < 1e-9, "{farthest}");
}
