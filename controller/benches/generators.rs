//! Computing time of planning and of one step, for the six axes of the IRp-6 at macrosteps of 20 ms.

use std::f64::consts::FRAC_PI_2;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use mrroc_controller::generator::{
    Axes, AxesState, Contour, EffectorImage, EffectorState, FeedLimits, Generator, JerkLimited, LineLimits,
    MotionLimits, Newsmooth, Next, Pose, SmoothPose, StraightLine,
};
use mrroc_controller::path::{BSpline, Curve, Path, SplineEnds};
use mrroc_controller::robot::{Arm, Irp6, Irp6Parameters, Space};

const MACROSTEP: Duration = Duration::from_millis(20);
const START: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];

fn image(arm: &Arm) -> EffectorImage {
    let joints = AxesState::at_rest(START);
    let state = EffectorState { motors: joints, joints, pose: arm.forward(&START).expect("the arm stands there") };
    EffectorImage::standing(state)
}

/// Measures the first step and the next steps separately, each repeatedly.
fn measure<G: Generator>(c: &mut Criterion, name: &str, mut generator: G, first: &G::First, every: &G::Every) {
    c.bench_function(&format!("{name}/plan"), |b| {
        b.iter(|| generator.first_step(black_box(first), MACROSTEP).expect("it can be planned"));
    });
    let Next { memory: begin, .. } = generator.first_step(first, MACROSTEP).expect("it can be planned");
    let mut memory = begin;
    c.bench_function(&format!("{name}/step"), |b| {
        b.iter(|| {
            if generator.terminal(&memory, every) {
                memory = begin;
            }
            let next = generator.next_step(black_box(&memory), every).expect("it was planned");
            memory = next.memory;
            next.effector
        });
    });
}

fn generators(c: &mut Criterion) {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).expect("its parameters are consistent");
    let arm = Arm::new(Arc::new(robot), Pose::translation(0.0, 0.0, 0.25));
    let e = image(&arm);
    let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
    let poses: Vec<Axes> =
        (1..=5).map(|k| std::array::from_fn(|axis| START[axis] + 0.1 * f64::from(k) * (axis as f64 - 2.5))).collect();

    let smooth = poses.iter().map(|position| SmoothPose::fast(*position)).collect();
    let newsmooth = Newsmooth::new(Space::Joint, 6, limits, smooth).expect("limits are positive");
    measure(c, "newsmooth, 5 poses", newsmooth, &e, &());
    let direct = JerkLimited::new(Space::Joint, 6, limits, &poses[4..]).expect("limits are positive");
    measure(c, "jerk-limited, 1 pose", direct, &e, &());
    let through = JerkLimited::new(Space::Joint, 6, limits, &poses).expect("limits are positive");
    measure(c, "jerk-limited, 5 poses", through, &e, &());

    let mut target = e.commanded.pose;
    target.translation.vector += nalgebra::Vector3::new(0.1, -0.15, 0.05);
    let line_limits = LineLimits {
        max_velocity: 0.25,
        max_acceleration: 1.0,
        max_jerk: 10.0,
        max_angular_velocity: 1.0,
        max_angular_acceleration: 4.0,
        max_angular_jerk: 40.0,
    };
    let line = StraightLine::new(arm.clone(), target, line_limits, limits).expect("limits are positive");
    measure(c, "line of 187 mm", line, &e, &());

    let letter = [(0, 0), (5, 12), (10, 0), (15, 12), (20, 0), (30, 6), (36, 0), (30, -6), (24, 0)];
    let start = e.commanded.pose;
    let point = |(x, y)| start.translation.vector + nalgebra::Vector3::new(f64::from(x), f64::from(y), 0.0) * 1e-3;
    let spline = BSpline::through(&letter.map(point), SplineEnds::NotAKnot).expect("the points differ");
    let curve = Curve::spline(spline).expect("the letter has no cusp");
    let path = Path::keeping(curve, start.rotation).expect("the orientation is finite");
    let feed_limits = FeedLimits {
        max_velocity: 0.02,
        max_acceleration: 0.1,
        max_jerk: 1.0,
        max_normal_acceleration: 0.1,
        max_angular_velocity: 1.0,
        max_angular_acceleration: 4.0,
    };
    let contour = Contour::along(arm, path, feed_limits, limits).expect("limits are positive");
    measure(c, "contour of 99 mm", contour, &e, &());
}

criterion_group!(benches, generators);
criterion_main!(benches);
