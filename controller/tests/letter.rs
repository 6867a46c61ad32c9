//! The reference letter of an IRp-6, judged on the set-points that leave the servo.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use mrroc_controller::ecp::Task;
use mrroc_controller::generator::{Axes, Contour, Feed, FeedLimits, MotionLimits, Pose};
use mrroc_controller::path::{BSpline, Curve, Path, SplineEnds};
use mrroc_controller::robot::{Arm, Irp6, Irp6Parameters};
use nalgebra::Vector3;

use crate::bench::{Bench, DT};
use crate::ideal::PERIOD;

const AXES: usize = 6;
/// Joints in the middle of the workspace, the wrist bent, rad.
const START: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];
/// Points of the letter, mm.
const LETTER: [(i32, i32); 9] = [(0, 0), (5, 12), (10, 0), (15, 12), (20, 0), (30, 6), (36, 0), (30, -6), (24, 0)];

fn arm() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).expect("its parameters are consistent");
    Arm::new(Arc::new(robot), Pose::translation(0.0, 0.0, 0.25))
}

/// Distance of a position from a path, near the arc length `s`, m.
fn aside(path: &Path, position: &Vector3<f64>, mut s: f64) -> f64 {
    for _ in 0..20 {
        let near = path.at(s);
        let offset = position - near.pose.translation.vector;
        let slope = 1.0 - offset.dot(&near.linear_acceleration);
        s = (s + offset.dot(&near.linear) / slope.max(0.5)).clamp(0.0, path.length());
    }
    (position - path.at(s).pose.translation.vector).norm()
}

#[test]
fn the_set_points_of_the_reference_letter_keep_the_path_within_1_um_and_the_feed_within_0_1_percent() {
    let start = arm().forward(&START).expect("the arm stands there");
    let point = |(x, y)| start.translation.vector + Vector3::new(f64::from(x), f64::from(y), 0.0) * 1e-3;
    let spline = BSpline::through(&LETTER.map(point), SplineEnds::NotAKnot).expect("the points differ");
    let curve = Curve::spline(spline).expect("the letter has no cusp");
    let path = Path::keeping(curve, start.rotation).expect("the orientation is finite");
    for (velocity, acceleration, jerk) in [(0.010, 0.05, 0.5), (0.020, 0.1, 1.0), (0.050, 0.5, 25.0)] {
        let limits = FeedLimits {
            max_velocity: velocity,
            max_acceleration: acceleration,
            max_jerk: jerk,
            max_normal_acceleration: acceleration,
            max_angular_velocity: 1.0,
            max_angular_acceleration: 4.0,
        };
        let contour = Contour::along(arm(), path.clone(), limits, MotionLimits::uniform(1.5, 7.0, 70.0));
        let motors = arm().motors(&START).expect("the arm stands there");
        let mut bench = Bench::<AXES>::new(arm(), &motors, [600.0, 6000.0], 8);
        bench.execute(Task::new().enable().run(contour.expect("sound limits")), |_, _| {});
        let sent = bench.sent();
        let begin = sent.iter().rposition(|at| *at == sent[0]).expect("the arm stood");
        let tool = |motors: &[f64; AXES]| {
            let mut all = Axes::default();
            all[..AXES].copy_from_slice(motors);
            let joints = arm().joints(&all).expect("the arm was there");
            arm().forward(&joints).expect("the arm was there").translation.vector
        };
        let tool: Vec<_> = sent[begin..].iter().map(tool).collect();
        let feed = Feed::in_steps(&path, &limits, PERIOD).expect("a sound profile");
        let (mut error, mut beyond_chord, mut fluctuation): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for (period, pair) in tool.windows(2).enumerate() {
            let [from, to] = [period, period + 1].map(|period| feed.at(period as f64 * DT).distance);
            error = error.max(aside(&path, &pair[1], to));
            // Between two set-points the drives move on a chord.
            let curvature = |part: i32| path.at(from + (to - from) * f64::from(part) / 8.0).linear_acceleration.norm();
            let sharpest = (0..=8).map(curvature);
            let chord = sharpest.fold(0.0, f64::max) * (to - from).powi(2) / 8.0;
            let off = aside(&path, &((pair[0] + pair[1]) / 2.0), (from + to) / 2.0);
            beyond_chord = beyond_chord.max(off - chord);
            let moved = (pair[1] - pair[0]).norm();
            fluctuation = fluctuation.max((moved - (to - from)).abs() / (velocity * DT));
        }
        println!(
            "{:.0} mm/s: contour error {:.4} µm, beyond the chord {:.4} µm, feed fluctuation {:.4} %",
            velocity * 1e3,
            error * 1e6,
            beyond_chord * 1e6,
            fluctuation * 1e2
        );
        assert!(tool.len() > 1000, "the arm wrote");
        assert!(error < 1e-6 && beyond_chord < 1e-6 && fluctuation < 1e-3, "{velocity}");
    }
}
