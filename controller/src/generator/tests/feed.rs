//! Feed profiles: limits, durations, and speed where curvature limits it.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{UnitQuaternion, Vector3};
use rsruckig::prelude::{InputParameter, Ruckig, ThrowErrorHandler, Trajectory};

use super::*;
use crate::path::{BSpline, Curve, Path, SplineEnds};

const LIMITS: FeedLimits = FeedLimits {
    max_velocity: 0.1,
    max_acceleration: 1.0,
    max_jerk: 20.0,
    max_normal_acceleration: 0.5,
    max_angular_velocity: 1.0,
    max_angular_acceleration: 4.0,
};

fn at(x: f64, y: f64) -> Vector3<f64> {
    Vector3::new(x, y, 0.0)
}

fn keeping(curve: Curve) -> Path {
    Path::keeping(curve, UnitQuaternion::identity()).unwrap()
}

fn straight(length: f64) -> Path {
    keeping(Curve::line(at(0.0, 0.0), at(length, 0.0)).unwrap())
}

/// Duration of the time-optimal motion from rest to rest, s.
fn ruckig(length: f64, limits: &FeedLimits) -> f64 {
    let mut input = InputParameter::<1>::new(None);
    input.target_position[0] = length;
    input.max_velocity[0] = limits.max_velocity;
    input.max_acceleration[0] = limits.max_acceleration;
    input.max_jerk[0] = limits.max_jerk;
    let mut trajectory = Trajectory::new(None);
    Ruckig::<1, ThrowErrorHandler>::new(None, 1.0).calculate(&input, &mut trajectory).unwrap();
    trajectory.get_duration()
}

fn random_limits(random: &mut Random) -> FeedLimits {
    FeedLimits {
        max_velocity: random.within(0.01, 0.5),
        max_acceleration: random.within(0.05, 5.0),
        max_jerk: random.within(1.0, 200.0),
        max_normal_acceleration: random.within(0.05, 5.0),
        max_angular_velocity: random.within(0.1, 2.0),
        max_angular_acceleration: random.within(0.5, 10.0),
    }
}

/// A path of one of five kinds, with curvature between 2 and some 1000 1/m, and one of three kinds of orientation.
fn random_path(random: &mut Random) -> Path {
    let mut vector = |most: f64| Vector3::from_fn(|_, _| random.within(-most, most));
    let points: Vec<_> = (0..6).map(|_| vector(0.2)).collect();
    let [from, to, last] = [vector(1.0), vector(1.0), vector(1.0)].map(UnitQuaternion::from_scaled_axis);
    let curve = match random.below(5) {
        0 => Curve::line(points[0], points[1]).unwrap(),
        1 => Curve::arc(points[0], points[1], points[2]).unwrap(),
        2 => Curve::polyline(&points, 1e-3).unwrap(),
        3 => {
            // The curvature changes by a step at the double knot.
            let knots = vec![0.0, 0.0, 0.0, 0.0, 0.4, 0.4, 1.0, 1.0, 1.0, 1.0];
            Curve::spline(BSpline::new(knots, points).unwrap()).unwrap()
        }
        _ => Curve::spline(BSpline::through(&points, SplineEnds::Natural).unwrap()).unwrap(),
    };
    let length = curve.length();
    match random.below(3) {
        0 => Path::keeping(curve, from).unwrap(),
        1 => Path::turning(curve, from, to).unwrap(),
        _ => Path::turning_through(curve, &[(0.1 * length, from), (0.3 * length, to), (length, last)]).unwrap(),
    }
}

#[test]
fn a_path_whose_curvature_never_limits_takes_the_time_of_ruckig() {
    for seed in 0..400 {
        let mut random = Random(seed);
        let limits = random_limits(&mut random);
        let length = 10.0_f64.powf(random.within(-4.0, 0.5));
        let feed = Feed::along(&straight(length), &limits).unwrap();
        let (found, expected) = (feed.duration(), ruckig(length, &limits));
        assert!((found / expected - 1.0).abs() < 1e-6, "seed {seed}: {found} s, Ruckig {expected} s");
        if length > limits.max_velocity * expected / 2.0 {
            let middle = feed.at(found / 2.0);
            assert!((middle.velocity / limits.max_velocity - 1.0).abs() < 1e-9, "seed {seed} {middle:?}");
        }
    }
}

#[test]
fn the_limits_hold_on_every_path_at_every_time_and_the_profile_ends_exactly() {
    for seed in 0..120 {
        let mut random = Random(seed);
        let path = random_path(&mut random);
        let limits = random_limits(&mut random);
        let feed = match random.below(2) {
            0 => Feed::along(&path, &limits).unwrap(),
            _ => Feed::in_steps(&path, &limits, MACROSTEP).unwrap(),
        };
        assert_eq!(FeedState { jerk: 0.0, ..feed.at(0.0) }, FeedState::default(), "seed {seed}");
        let end = FeedState { distance: path.length(), ..FeedState::default() };
        assert_eq!(feed.at(feed.duration()), end, "seed {seed}");
        let dt = feed.duration() / 4_000.0;
        let mut last = FeedState::default();
        let mut before_end = last;
        for k in 1..4_000 {
            let now = feed.at(f64::from(k) * dt);
            let case = || format!("seed {seed} {k} {now:?} {limits:?}");
            let tool = path.moving_at(now.distance, now.velocity, now.acceleration);
            let normal = path.curve().at(now.distance).curvature.norm() * now.velocity.powi(2);
            assert!(now.velocity > -1e-12 && now.velocity <= limits.max_velocity * (1.0 + 1e-9), "{}", case());
            assert!(now.acceleration.abs() <= limits.max_acceleration * (1.0 + 1e-9), "{}", case());
            assert!(now.jerk.abs() <= limits.max_jerk * (1.0 + 1e-6), "{}", case());
            assert!(normal <= limits.max_normal_acceleration * 1.001, "{normal} {}", case());
            assert!(tool.angular.norm() <= limits.max_angular_velocity * 1.001, "{}", case());
            assert!(tool.angular_acceleration.norm() <= limits.max_angular_acceleration * 1.001, "{}", case());
            // The derivatives fit together.
            let jump = (now.acceleration - last.acceleration).abs();
            assert!(jump <= limits.max_jerk * dt * (1.0 + 1e-6) + 1e-12, "{}", case());
            let mean = (now.velocity + last.velocity) / 2.0;
            let slack = limits.max_jerk * dt.powi(3) + 1e-11;
            assert!((now.distance - last.distance - mean * dt).abs() <= slack, "{}", case());
            last = now;
            before_end = now;
        }
        assert!((path.length() - before_end.distance) < limits.max_jerk * dt.powi(3) + 1e-11, "seed {seed}");
    }
}

#[test]
fn a_section_of_constant_curvature_is_passed_at_the_speed_of_its_normal_acceleration() {
    // A half circle of 5 mm between two straight sides.
    let half = Curve::polyline(&[at(0.0, 0.0), at(0.1, 0.0), at(0.1, 0.01), at(0.0, 0.01)], 0.005).unwrap();
    let path = keeping(half);
    let feed = Feed::along(&path, &LIMITS).unwrap();
    let expected = (0.5_f64 * 0.005).sqrt();
    let arc = 0.095..0.095 + 0.005 * PI;
    let (mut within, mut slowest) = (0, f64::INFINITY);
    for k in 0..100_000 {
        let now = feed.at(feed.duration() * f64::from(k) / 1e5);
        if arc.contains(&now.distance) {
            assert!((now.velocity / expected - 1.0).abs() < 1e-9, "{now:?}");
            within += 1;
        }
        if (0.03..0.16).contains(&now.distance) {
            slowest = slowest.min(now.velocity);
        }
    }
    assert!(within > 5_000, "{within}");
    assert!((slowest / expected - 1.0).abs() < 1e-9, "{slowest}");

    // A whole path of one curvature is limited in the same way, and takes the time of that feed.
    let circle = keeping(Curve::arc_about(at(0.005, 0.0), at(0.0, 0.0), Vector3::z(), TAU).unwrap());
    let slow = FeedLimits { max_velocity: expected, ..LIMITS };
    let found = Feed::along(&circle, &LIMITS).unwrap().duration();
    assert!((found / ruckig(0.005 * TAU, &slow) - 1.0).abs() < 1e-6, "{found}");
}

#[test]
fn speed_follows_a_varying_bound_but_for_the_distance_of_the_moving_average() {
    // A parabola with a sharp vertex: the bound rises from 5 cm/s to the feed.
    let controls = vec![at(-0.04, 0.08), at(-0.04 / 3.0, -0.08 / 3.0), at(0.04 / 3.0, -0.08 / 3.0), at(0.04, 0.08)];
    let knots = vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
    let path = keeping(Curve::spline(BSpline::new(knots, controls).unwrap()).unwrap());
    let limits = FeedLimits { max_velocity: 1.0, max_acceleration: 20.0, max_jerk: 5_000.0, ..LIMITS };
    let feed = Feed::along(&path, &limits).unwrap();
    let bound = |s: f64| (0.5 / path.curve().at(s).curvature.norm()).sqrt().min(1.0);
    let middle = path.length() / 2.0;
    for k in 0..10_000 {
        let now = feed.at(feed.duration() * f64::from(k) / 1e4);
        let aside = (now.distance - middle).abs();
        if aside < 0.02 {
            let reach = 2.5 * now.velocity * limits.max_acceleration / limits.max_jerk;
            let lowest = bound(middle + (aside - reach).max(0.0));
            assert!(now.velocity >= 0.995 * lowest, "{now:?} {lowest}");
        }
    }
}

#[test]
fn a_duration_of_whole_steps_leaves_the_feed_exact() {
    for seed in 0..50 {
        let mut random = Random(seed);
        let length = random.within(0.05, 1.0);
        let path = straight(length);
        let feed = Feed::in_steps(&path, &LIMITS, MACROSTEP).unwrap();
        let steps = feed.duration() / MC;
        let shortest = ruckig(length, &LIMITS);
        assert!((steps - steps.round()).abs() < 1e-6, "seed {seed}: {steps}");
        assert!(feed.duration() >= shortest * (1.0 - 1e-9) && feed.duration() < shortest + MC * 1.01, "seed {seed}");
        let middle = feed.at(feed.duration() / 2.0);
        assert!((middle.velocity / LIMITS.max_velocity - 1.0).abs() < 1e-9, "seed {seed} {middle:?}");
    }
}

#[test]
fn a_turn_of_the_tool_limits_the_feed() {
    let line = Curve::line(at(0.0, 0.0), at(0.1, 0.0)).unwrap();
    let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * FRAC_PI_2);
    let path = Path::turning(line, UnitQuaternion::identity(), turned).unwrap();
    let feed = Feed::along(&path, &LIMITS).unwrap();
    // 90° on 0.1 m at 1 rad/s and 4 rad/s².
    let slow = FeedLimits { max_velocity: 0.1 / FRAC_PI_2, max_acceleration: 0.4 / FRAC_PI_2, ..LIMITS };
    assert!((feed.duration() / ruckig(0.1, &slow) - 1.0).abs() < 1e-6);
}

#[test]
fn a_turn_shorter_than_a_cell_limits_the_feed() {
    let line = Curve::line(at(0.0, 0.0), at(0.1, 0.0)).unwrap();
    let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.01);
    let nodes = [(0.05, UnitQuaternion::identity()), (0.05 + 1e-5, turned)];
    let path = Path::turning_through(line, &nodes).unwrap();
    let feed = Feed::along(&path, &LIMITS).unwrap();
    let (mut fastest, mut hardest): (f64, f64) = (0.0, 0.0);
    for k in 0..200_000 {
        let now = feed.at(feed.duration() * f64::from(k) / 2e5);
        let tool = path.moving_at(now.distance, now.velocity, now.acceleration);
        fastest = fastest.max(tool.angular.norm());
        hardest = hardest.max(tool.angular_acceleration.norm());
    }
    assert!(fastest > 0.0 && fastest <= 1.001, "{fastest}");
    assert!(hardest > 0.1 && hardest <= 4.004, "{hardest}");
}

#[test]
fn limits_that_allow_no_motion_are_refused() {
    let refused = |limits: FeedLimits| Feed::along(&straight(0.1), &limits).map(|_| ()).unwrap_err();
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        for limits in [
            FeedLimits { max_velocity: value, ..LIMITS },
            FeedLimits { max_acceleration: value, ..LIMITS },
            FeedLimits { max_jerk: value, ..LIMITS },
            FeedLimits { max_normal_acceleration: value, ..LIMITS },
            FeedLimits { max_angular_velocity: value, ..LIMITS },
            FeedLimits { max_angular_acceleration: value, ..LIMITS },
        ] {
            assert_eq!(refused(limits), GeneratorError::PathLimit, "{value}");
        }
    }
    let no_step = Feed::in_steps(&straight(0.1), &LIMITS, Duration::ZERO).map(|_| ());
    assert_eq!(no_step, Err(GeneratorError::NoMacrostep));
}
