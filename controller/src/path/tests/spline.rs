//! Splines: interpolation, derivatives, arc length, refusals.

use super::*;
use crate::path::arc_length::ArcLength;

/// The reference letter, m.
fn letter() -> Vec<Vector3<f64>> {
    let points = [(0, 0), (5, 12), (10, 0), (15, 12), (20, 0), (30, 6), (36, 0), (30, -6), (24, 0)];
    points.map(|(x, y)| at(f64::from(x), f64::from(y)) * 1e-3).to_vec()
}

fn chord_lengths(points: &[Vector3<f64>]) -> Vec<f64> {
    let mut u = vec![0.0];
    u.extend(points.windows(2).map(|pair| (pair[1] - pair[0]).norm()));
    for k in 1..u.len() {
        u[k] += u[k - 1];
    }
    u
}

/// Arc length between two parameters of one span, by Simpson's rule.
fn simpson(spline: &BSpline, from: f64, to: f64) -> f64 {
    const PARTS: u32 = 8_000;
    let h = (to - from) / f64::from(PARTS);
    let term = |k: u32| {
        let weight = if k == 0 || k == PARTS { 1.0 } else { f64::from(2 + 2 * (k % 2)) };
        weight * spline.at(from + f64::from(k) * h)[1].norm()
    };
    (0..=PARTS).map(term).sum::<f64>() * h / 3.0
}

#[test]
fn a_spline_passes_its_points_with_the_derivatives_of_its_ends() {
    for seed in 0..200 {
        let mut random = Random(seed);
        let count = 4 + (random.next() % 9) as usize;
        let points = random.vectors(count, 1.0);
        let (start, end) = (random.vector(1.0), random.vector(1.0));
        let parameters = chord_lengths(&points);
        let last = parameters[count - 1];
        let clamped = SplineEnds::Clamped { start, end };
        for ends in [SplineEnds::Averaged, SplineEnds::NotAKnot, SplineEnds::Natural, clamped] {
            let spline = BSpline::through(&points, ends).unwrap();
            for (u, point) in parameters.iter().zip(&points) {
                let missed = (spline.at(*u)[0] - point).norm();
                assert!(missed < 1e-12, "seed {seed} {ends:?}: {missed:e}");
            }
            let [first, final_] = [spline.at(0.0), spline.at(last)];
            match ends {
                SplineEnds::Averaged | SplineEnds::NotAKnot => assert_eq!(spline.controls().len(), count),
                SplineEnds::Natural => assert!(first[2].norm().max(final_[2].norm()) < 1e-11, "seed {seed}"),
                SplineEnds::Clamped { .. } => {
                    assert!((first[1] - start).norm().max((final_[1] - end).norm()) < 1e-12, "seed {seed}");
                }
            }
        }
    }
}

#[test]
fn averaged_knots_are_those_of_the_nurbs_book() {
    // Example 9.1: knots 0, 0, 0, 0, 28/51, 1, 1, 1, 1 with the total chord length of 17 as unit.
    let points = [at(0.0, 0.0), at(3.0, 4.0), at(-1.0, 4.0), at(-4.0, 0.0), at(-4.0, -3.0)];
    let spline = BSpline::through(&points, SplineEnds::Averaged).unwrap();
    let knots = [0.0, 0.0, 0.0, 0.0, 28.0 / 51.0, 1.0, 1.0, 1.0, 1.0].map(|knot| 17.0 * knot);
    for (found, expected) in spline.knots().iter().zip(knots) {
        assert!((found - expected).abs() < 1e-14, "{:?}", spline.knots());
    }
}

#[test]
fn a_straight_row_of_points_gives_a_line_and_a_cubic_is_reproduced() {
    let row = [0.0, 1.0, 3.0, 4.0, 9.0].map(|x| at(x, 2.0 * x));
    let natural = BSpline::through(&row, SplineEnds::Natural).unwrap();
    let middle = natural.at(10.0);
    assert!((middle[1] - at(1.0, 2.0) / 5.0_f64.sqrt()).norm() < 1e-14);
    assert!(middle[2].norm() < 1e-13);

    // The Bézier curve of four control points, by Bernstein polynomials.
    let controls = vec![at(0.0, 0.0), at(1.0, 2.0), at(3.0, -1.0), at(4.0, 1.0)];
    let bezier = BSpline::new(vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0], controls.clone()).unwrap();
    for u in [0.0, 0.3, 0.9, 1.0] {
        let v: f64 = 1.0 - u;
        let shares = [v * v * v, 3.0 * u * v * v, 3.0 * u * u * v, u * u * u];
        let expected: Vector3<f64> = controls.iter().zip(shares).map(|(point, share)| point * share).sum();
        assert!((bezier.at(u)[0] - expected).norm() < 1e-15, "{u}");
    }
    assert!((bezier.at(0.0)[1] - at(3.0, 6.0)).norm() < 1e-14);
    assert!((bezier.at(1.0)[2] - (controls[3] - controls[2] * 2.0 + controls[1]) * 6.0).norm() < 1e-13);
}

#[test]
fn derivatives_of_a_spline_are_those_of_its_position_inside_and_outside_the_domain() {
    let mut random = Random(3);
    let mut knots: Vec<f64> = (0..14).map(|_| random.within(0.0, 5.0)).collect();
    knots.sort_by(f64::total_cmp);
    let spline = BSpline::new(knots, random.vectors(10, 1.0)).unwrap();
    let (first, last) = spline.domain();
    for _ in 0..200 {
        let u = random.within(first - 0.1, last + 0.1);
        let h = 1e-5;
        if spline.knots().iter().any(|knot| (knot - u).abs() < 2.0 * h) {
            continue;
        }
        let [behind, here, ahead] = [u - h, u, u + h].map(|u| spline.at(u));
        for derivative in [1, 2] {
            let slope = (ahead[derivative - 1] - behind[derivative - 1]) / (2.0 * h);
            let apart = (slope - here[derivative]).norm() / (1.0 + here[derivative].norm());
            assert!(apart < 1e-4, "{u} {derivative} {apart}");
        }
    }
}

#[test]
fn arc_length_and_its_inversion_are_accurate_to_1e_12_of_the_length() {
    let mut random = Random(11);
    let mut splines = vec![BSpline::through(&letter(), SplineEnds::NotAKnot).unwrap()];
    for _ in 0..10 {
        splines.push(BSpline::through(&random.vectors(6, 0.5), SplineEnds::Averaged).unwrap());
    }
    for spline in splines {
        let table = ArcLength::of(spline.clone()).unwrap();
        let knots = spline.spans();
        let lengths: Vec<f64> = knots.windows(2).map(|span| simpson(&spline, span[0], span[1])).collect();
        let length: f64 = lengths.iter().sum();
        assert!((table.length() - length).abs() < 1e-12 * length, "{} {length}", table.length());
        for _ in 0..40 {
            let s = random.within(0.0, length);
            let u = table.parameter(s);
            let span = knots.partition_point(|knot| *knot <= u).min(knots.len() - 1) - 1;
            let found = lengths[..span].iter().sum::<f64>() + simpson(&spline, knots[span], u);
            assert!((found - s).abs() < 1e-12 * length, "{s} {found}");
        }
        assert_eq!(table.parameter(0.0), spline.domain().0);
        assert!((table.parameter(length) - spline.domain().1).abs() < 1e-12 * spline.domain().1);
    }
}

#[test]
fn the_reference_letter_has_its_known_length_and_sharpest_curvature() {
    let curve = Curve::spline(BSpline::through(&letter(), SplineEnds::NotAKnot).unwrap()).unwrap();
    let length = curve.length();
    let sharpest = (0..=100_000).map(|k| curve.at(length * f64::from(k) / 1e5).curvature.norm()).fold(0.0, f64::max);
    assert!((length - 99.26e-3).abs() < 5e-6, "{length}");
    assert!((sharpest - 3630.0).abs() < 5.0, "{sharpest}");
    // A division of it finds the same curvature, in cells that turn little.
    let divisions = curve.divisions(0.05);
    let cells = divisions.windows(2).map(|cell| (cell[1] - cell[0], curve.max_curvature(cell[0], cell[1])));
    let (most, turn) = cells.fold((0.0_f64, 0.0_f64), |(most, turn), (length, curvature)| {
        (most.max(curvature), turn.max(length * curvature))
    });
    assert!((most / sharpest - 1.0).abs() < 1e-3, "{most}");
    assert!(turn < 0.0505 && divisions.len() < 3_000, "{turn} {}", divisions.len());
}

#[test]
fn knots_and_points_without_a_spline_are_refused() {
    let points = |count: usize| (0..count).map(|k| at(k as f64, (k * k) as f64)).collect::<Vec<_>>();
    let new = |knots: &[f64], count: usize| BSpline::new(knots.to_vec(), points(count)).unwrap_err();
    let even = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
    assert_eq!(new(&even[..7], 3), PathError::TooFewPoints { given: 3, needed: 4 });
    assert_eq!(new(&even[..7], 4), PathError::KnotCount { given: 7, controls: 4, needed: 8 });
    assert_eq!(new(&[0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.5, 1.0], 4), PathError::KnotOrder { knot: 6 });
    assert_eq!(new(&[0.0, 0.0, 0.0, 0.0, f64::NAN, 1.0, 1.0, 1.0], 4), PathError::KnotOrder { knot: 4 });
    assert_eq!(new(&[1.0; 8], 4), PathError::KnotOrder { knot: 4 });
    let corner = [0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0];
    assert_eq!(new(&corner, 7), PathError::KnotMultiplicity { knot: 4 });

    let through = |points: &[Vector3<f64>], ends| BSpline::through(points, ends).unwrap_err();
    let few = through(&points(3), SplineEnds::Averaged);
    assert_eq!(few, PathError::TooFewPoints { given: 3, needed: 4 });
    assert_eq!(through(&points(1), SplineEnds::Natural), PathError::TooFewPoints { given: 1, needed: 2 });
    let [a, b] = [at(0.0, 0.0), at(1.0, 1.0)];
    assert_eq!(through(&[a, b, b], SplineEnds::Natural), PathError::Coincident { point: 1 });
    let lost = SplineEnds::Clamped { start: a, end: at(f64::INFINITY, 0.0) };
    assert_eq!(through(&[a, b], lost), PathError::NotFinite { point: 1 });

    // Controls that turn back on a line: the derivative vanishes at u = 1/2.
    let back = vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 0.0), at(0.0, 0.0)];
    let cusp = Curve::spline(BSpline::new(even.to_vec(), back).unwrap()).map(|_| ()).unwrap_err();
    assert_eq!(cusp, PathError::Cusp { parameter: 0.5 });
    let point = Curve::spline(BSpline::new(even.to_vec(), vec![b; 4]).unwrap()).map(|_| ()).unwrap_err();
    assert_eq!(point, PathError::Cusp { parameter: 0.0 });
}
