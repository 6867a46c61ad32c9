//! Properties of curves and paths over seeded random ones, and their refusals.

mod spline;

use std::f64::consts::{FRAC_PI_2, PI, SQRT_2, TAU};

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::random::Random;

impl Random {
    fn vector(&mut self, most: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.within(-most, most))
    }

    fn vectors(&mut self, count: usize, most: f64) -> Vec<Vector3<f64>> {
        (0..count).map(|_| self.vector(most)).collect()
    }
}

fn at(x: f64, y: f64) -> Vector3<f64> {
    Vector3::new(x, y, 0.0)
}

/// One curve of every kind.
fn curves(seed: u64) -> [Curve; 5] {
    let mut random = Random(seed);
    let points = random.vectors(7, 0.3);
    [
        Curve::line(points[0], points[1]).unwrap(),
        Curve::arc(points[0], points[1], points[2]).unwrap(),
        Curve::arc_about(points[0], points[1], points[2], random.within(-TAU, TAU)).unwrap(),
        Curve::polyline(&points, 1e-3).unwrap(),
        Curve::spline(BSpline::through(&points, SplineEnds::Natural).unwrap()).unwrap(),
    ]
}

#[test]
fn the_tangent_is_a_unit_vector_and_the_derivatives_are_those_of_the_position() {
    for seed in 0..40 {
        for curve in curves(seed) {
            let mut random = Random(seed);
            let (length, h) = (curve.length(), 1e-6);
            for _ in 0..50 {
                let s = random.within(h, length - h);
                if curve.joints().any(|joint| (joint - s).abs() <= h) {
                    continue;
                }
                let [behind, here, ahead] = [s - h, s, s + h].map(|s| curve.at(s));
                let slope = (ahead.position - behind.position) / (2.0 * h);
                let bend = (ahead.tangent - behind.tangent) / (2.0 * h);
                let sharp = 1.0 + here.curvature.norm();
                assert!((here.tangent.norm() - 1.0).abs() < 1e-14, "seed {seed} {curve:?}");
                assert!((slope - here.tangent).norm() < 1e-8 * sharp.powi(2), "seed {seed} {s} {curve:?}");
                assert!((bend - here.curvature).norm() < 1e-8 * sharp.powi(3), "seed {seed} {s} {curve:?}");
                assert!(here.curvature.dot(&here.tangent).abs() < 1e-12 * sharp, "seed {seed} {curve:?}");
            }
        }
    }
}

#[test]
fn position_and_tangent_are_continuous_where_pieces_meet() {
    for seed in 0..40 {
        for curve in curves(seed) {
            for joint in curve.joints() {
                let [behind, ahead] = [joint * (1.0 - 1e-15) - 1e-15, joint].map(|s| curve.at(s));
                assert!((ahead.position - behind.position).norm() < 1e-14, "seed {seed} {joint}");
                assert!((ahead.tangent - behind.tangent).norm() < 1e-11, "seed {seed} {joint}");
            }
        }
    }
}

#[test]
fn an_arc_passes_its_three_points_and_an_arc_about_a_centre_turns_right_handed() {
    for seed in 0..200 {
        let mut random = Random(seed);
        let [from, through, to] = [random.vector(1.0), random.vector(1.0), random.vector(1.0)];
        let arc = Curve::arc(from, through, to).unwrap();
        let length = arc.length();
        assert!((arc.at(0.0).position - from).norm() < 1e-12, "seed {seed}");
        assert!((arc.at(length).position - to).norm() < 1e-9, "seed {seed}");
        let beside = |s: f64| (arc.at(s).position - through).norm();
        let nearest = (0..=10_000).map(|k| beside(length * f64::from(k) / 1e4)).fold(f64::INFINITY, f64::min);
        assert!(nearest < length * 1e-4, "seed {seed}: {nearest} of {length}");
    }
    let z = Vector3::z();
    let quarter = Curve::arc_about(at(2.0, 0.0) + z, at(0.0, 0.0), 5.0 * z, FRAC_PI_2).unwrap();
    assert!((quarter.length() - PI).abs() < 1e-15);
    assert!((quarter.at(PI).position - (at(0.0, 2.0) + z)).norm() < 1e-15);
    let back = Curve::arc_about(at(2.0, 0.0), at(0.0, 0.0), z, -FRAC_PI_2).unwrap();
    assert!((back.at(PI).position - at(0.0, -2.0)).norm() < 1e-15);
}

#[test]
fn a_blend_rounds_a_corner_with_its_radius() {
    let corner = Curve::polyline(&[at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)], 0.2).unwrap();
    assert!((corner.length() - (1.6 + 0.2 * FRAC_PI_2)).abs() < 1e-14);
    let middle = corner.at(corner.length() / 2.0);
    assert!(((middle.position - at(1.0, 0.0)).norm() - 0.2 * (SQRT_2 - 1.0)).abs() < 1e-14);
    assert!((middle.curvature.norm() - 5.0).abs() < 1e-13);
    assert!((corner.at(9.0).position - at(1.0, 1.0)).norm() < 1e-14);
    // Two blends may meet in the middle of a side.
    let points = [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 0.4), at(2.0, 0.4)];
    let tight = Curve::polyline(&points, 0.2).unwrap();
    assert!((tight.length() - (1.6 + 0.4 * FRAC_PI_2)).abs() < 1e-14);
    // Points on a line need no blend.
    let straight = Curve::polyline(&[at(0.0, 0.0), at(1.0, 0.0), at(3.0, 0.0)], 0.2).unwrap();
    assert_eq!(straight.length(), 3.0);
}

#[test]
fn geometry_without_a_meaning_is_refused() {
    let (a, b, c) = (at(0.0, 0.0), at(1.0, 0.0), at(1.0, 0.3));
    let nan = at(f64::NAN, 0.0);
    let z = Vector3::z();
    let refusal = |curve: Result<Curve, PathError>| curve.map(|_| ()).unwrap_err();

    assert_eq!(refusal(Curve::line(a, a)), PathError::Coincident { point: 0 });
    assert_eq!(refusal(Curve::line(a, nan)), PathError::NotFinite { point: 1 });
    assert_eq!(refusal(Curve::arc(a, b, at(2.0, 1e-7))), PathError::Collinear);
    assert_eq!(refusal(Curve::arc(a, b, at(0.5, 0.0))), PathError::Collinear);
    assert_eq!(refusal(Curve::arc(a, b, a)), PathError::Collinear);
    assert_eq!(refusal(Curve::arc(a, b, b)), PathError::Coincident { point: 1 });
    assert_eq!(refusal(Curve::arc_about(a, a, z, 1.0)), PathError::NoRadius);
    assert_eq!(refusal(Curve::arc_about(a, b, Vector3::zeros(), 1.0)), PathError::NoRadius);
    assert_eq!(refusal(Curve::arc_about(a, b, Vector3::x(), 1.0)), PathError::NoRadius);
    assert_eq!(refusal(Curve::arc_about(a, b, z, 0.0)), PathError::NoAngle { angle: 0.0 });
    assert_eq!(refusal(Curve::arc_about(a, b, nan, 1.0)), PathError::NotFinite { point: 2 });
    assert_eq!(refusal(Curve::polyline(&[a], 0.1)), PathError::TooFewPoints { given: 1, needed: 2 });
    assert_eq!(refusal(Curve::polyline(&[a, b, c], 0.0)), PathError::BlendRadius { radius: 0.0 });
    let too_large = refusal(Curve::polyline(&[a, b, c], 0.4));
    assert!(matches!(too_large, PathError::BlendTooLarge { side: 1, available: 0.3, .. }), "{too_large}");
    assert_eq!(refusal(Curve::polyline(&[a, b, at(0.5, 0.0)], 0.1)), PathError::Reversal { corner: 1 });

    let line = || Curve::line(a, b).unwrap();
    let keep = UnitQuaternion::identity();
    let lost = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(f64::NAN, 0.0, 0.0, 0.0));
    let orientation = |path: Result<Path, PathError>| path.map(|_| ()).unwrap_err();
    assert_eq!(orientation(Path::keeping(line(), lost)), PathError::OrientationNotFinite { node: 0 });
    assert_eq!(orientation(Path::turning(line(), keep, lost)), PathError::OrientationNotFinite { node: 1 });
    let turning = |nodes: &[(f64, UnitQuaternion<f64>)]| Path::turning_through(line(), nodes).map(|_| ());
    assert_eq!(turning(&[]), Err(PathError::TooFewPoints { given: 0, needed: 1 }));
    assert_eq!(turning(&[(0.5, keep), (0.5, keep)]), Err(PathError::OrientationOrder { node: 1, at: 0.5 }));
    assert_eq!(turning(&[(0.0, keep), (1.1, keep)]), Err(PathError::OrientationOrder { node: 1, at: 1.1 }));
    assert_eq!(turning(&[(0.1, lost)]), Err(PathError::OrientationNotFinite { node: 0 }));
    assert_eq!(turning(&[(-0.1, keep)]), Err(PathError::OrientationOrder { node: 0, at: -0.1 }));
}

#[test]
fn the_tool_turns_from_orientation_to_orientation_and_its_rates_are_derivatives() {
    let mut random = Random(5);
    let curve = Curve::line(at(0.0, 0.0), at(0.4, 0.0)).unwrap();
    let nodes = [0.05, 0.15, 0.3].map(|s| (s, UnitQuaternion::from_scaled_axis(random.vector(1.5))));
    let through = Path::turning_through(curve.clone(), &nodes).unwrap();
    for (s, orientation) in [(0.0, nodes[0].1), nodes[0], nodes[1], nodes[2], (0.4, nodes[2].1)] {
        let there = through.at(s);
        assert!(there.pose.rotation.angle_to(&orientation) < 1e-14, "{s}");
        assert!(there.angular.norm() < 1e-12, "{s}");
    }
    let linear = Path::turning(curve.clone(), nodes[0].1, nodes[1].1).unwrap();
    assert!(linear.at(0.4).pose.rotation.angle_to(&nodes[1].1) < 1e-14);
    let angle = nodes[0].1.angle_to(&nodes[1].1);
    assert!((linear.at(0.1).angular.norm() - angle / 0.4).abs() < 1e-13);
    assert_eq!(Path::keeping(curve, nodes[0].1).unwrap().at(0.2).angular, Vector3::zeros());

    let h = 1e-5;
    for path in [through, linear] {
        for _ in 0..100 {
            let s = random.within(h, 0.4 - h);
            let [behind, here, ahead] = [s - h, s, s + h].map(|s| path.at(s));
            let turn = (ahead.pose.rotation * behind.pose.rotation.inverse()).scaled_axis() / (2.0 * h);
            let change = (ahead.angular - behind.angular) / (2.0 * h);
            assert!((turn - here.angular).norm() < 1e-4, "{s}");
            assert!((change - here.angular_acceleration).norm() < 2.0, "{s}");
        }
    }
}

#[test]
fn derivatives_by_time_follow_from_speed_and_acceleration_along_the_path() {
    let mut random = Random(9);
    let spline = BSpline::through(&random.vectors(6, 0.2), SplineEnds::Natural).unwrap();
    let [from, to] = [random.vector(1.0), random.vector(1.0)].map(UnitQuaternion::from_scaled_axis);
    let path = Path::turning(Curve::spline(spline).unwrap(), from, to).unwrap();
    let (speed, push, h) = (0.3, 2.0, 1e-5);
    let at_time = |t: f64| path.moving_at(0.4 + speed * t + push * t * t / 2.0, speed + push * t, push);
    let [behind, here, ahead] = [-h, 0.0, h].map(at_time);
    let by_time = |one: Vector3<f64>, other: Vector3<f64>| (other - one) / (2.0 * h);
    let velocity = by_time(behind.pose.translation.vector, ahead.pose.translation.vector);
    let turn = (ahead.pose.rotation * behind.pose.rotation.inverse()).scaled_axis() / (2.0 * h);
    assert!((velocity - here.linear).norm() < 1e-6);
    assert!((turn - here.angular).norm() < 1e-6);
    assert!((by_time(behind.linear, ahead.linear) - here.linear_acceleration).norm() < 1e-4);
    assert!((by_time(behind.angular, ahead.angular) - here.angular_acceleration).norm() < 1e-4);
}
