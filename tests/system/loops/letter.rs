//! A letter drawn as by a plotter: a cubic spline through nine points, at a feed rate with limited acceleration.

use nalgebra::{SMatrix, SVector, Vector2};

const POINTS: usize = 9;

/// Points of the spline, m.
const THROUGH: [[f64; 2]; POINTS] = [
    [0.000, 0.000],
    [0.005, 0.012],
    [0.010, 0.000],
    [0.015, 0.012],
    [0.020, 0.000],
    [0.030, 0.006],
    [0.036, 0.000],
    [0.030, -0.006],
    [0.024, 0.000],
];

/// Number of points in the table of arc length.
const TABLE: usize = 20_000;

/// The curve. The parameter is the chord length; the third derivative is continuous at the second and the last but one
/// point.
struct Letter {
    /// Lengths of the chords, m.
    chords: [f64; POINTS - 1],
    /// Second derivatives at the points.
    bends: SMatrix<f64, POINTS, 2>,
}

/// One point of the curve.
struct Sample {
    /// Position, m.
    at: Vector2<f64>,
    /// Curvature, 1/m.
    curvature: f64,
    /// Arc length, m.
    way: f64,
}

impl Letter {
    fn new() -> Self {
        let point = |i: usize| SVector::from(THROUGH[i]).transpose();
        let chords: [f64; POINTS - 1] = std::array::from_fn(|i| (point(i + 1) - point(i)).norm());
        let mut matrix = SMatrix::<f64, POINTS, POINTS>::zeros();
        let mut right = SMatrix::<f64, POINTS, 2>::zeros();
        let slope = |i: usize| (point(i + 1) - point(i)) / chords[i];
        for i in 1..POINTS - 1 {
            let (before, after) = (chords[i - 1], chords[i]);
            matrix[(i, i - 1)] = before;
            matrix[(i, i)] = 2.0 * (before + after);
            matrix[(i, i + 1)] = after;
            right.set_row(i, &(6.0 * (slope(i) - slope(i - 1))));
        }
        let last = POINTS - 1;
        for (row, [a, b, c], before, after) in [
            (0, [0, 1, 2], chords[0], chords[1]),
            (last, [last - 2, last - 1, last], chords[last - 2], chords[last - 1]),
        ] {
            matrix[(row, a)] = after;
            matrix[(row, b)] = -(before + after);
            matrix[(row, c)] = before;
        }
        let bends = matrix.lu().solve(&right).expect("points apart");
        Self { chords, bends }
    }

    fn samples(&self) -> Vec<Sample> {
        let each = TABLE / self.chords.len();
        let mut samples: Vec<Sample> = Vec::with_capacity(TABLE + 1);
        for (i, chord) in self.chords.into_iter().enumerate() {
            let first = usize::from(i > 0);
            for k in first..=each {
                let (at, velocity, bend) = self.at(i, chord, k as f64 / each as f64);
                let way = samples.last().map_or(0.0, |last: &Sample| last.way + (at - last.at).norm());
                samples.push(Sample { at, curvature: velocity.perp(&bend).abs() / velocity.norm().powi(3), way });
            }
        }
        samples
    }

    /// Position and its first two derivatives, at the fraction `w` of piece `i`.
    fn at(&self, i: usize, chord: f64, w: f64) -> (Vector2<f64>, Vector2<f64>, Vector2<f64>) {
        let (from, to) = (Vector2::from(THROUGH[i]), Vector2::from(THROUGH[i + 1]));
        let bend = |i: usize| self.bends.row(i).transpose();
        let (before, after, v) = (bend(i), bend(i + 1), 1.0 - w);
        let sixth = chord * chord / 6.0;
        (
            v * from + w * to + sixth * ((v.powi(3) - v) * before + (w.powi(3) - w) * after),
            (to - from) / chord + sixth / chord * ((1.0 - 3.0 * v * v) * before + (3.0 * w * w - 1.0) * after),
            v * before + w * after,
        )
    }
}

/// Points of the letter, m, one per `dt` seconds, from rest to rest. The speed is `feed`, m/s, reduced where necessary.
/// Tangential and normal acceleration are each limited to `acceleration`, m/s².
pub(super) fn points(feed: f64, acceleration: f64, dt: f64) -> Vec<Vector2<f64>> {
    let samples = Letter::new().samples();
    let mut squared: Vec<f64> =
        samples.iter().map(|sample| (feed * feed).min(acceleration / sample.curvature)).collect();
    let last = samples.len() - 1;
    (squared[0], squared[last]) = (0.0, 0.0);
    let gain = |i: usize| 2.0 * acceleration * (samples[i + 1].way - samples[i].way);
    for i in 0..last {
        squared[i + 1] = squared[i + 1].min(squared[i] + gain(i));
    }
    for i in (0..last).rev() {
        squared[i] = squared[i].min(squared[i + 1] + gain(i));
    }
    let mut points = Vec::new();
    let (mut from, mut number) = (0.0, 0);
    for i in 0..last {
        let way = samples[i + 1].way - samples[i].way;
        let (v0, v1) = (squared[i].sqrt(), squared[i + 1].sqrt());
        let duration = 2.0 * way / (v0 + v1);
        while f64::from(number) * dt < from + duration {
            let t = f64::from(number) * dt - from;
            let part = (v0 * t + 0.5 * (v1 - v0) / duration * t * t) / way;
            points.push(samples[i].at.lerp(&samples[i + 1].at, part));
            number += 1;
        }
        from += duration;
    }
    points.push(samples[last].at);
    points
}

#[test]
fn the_letter_is_that_of_the_figures() {
    let samples = Letter::new().samples();
    let length = samples.last().unwrap().way;
    let sharpest = samples.iter().map(|s| s.curvature).fold(0.0, f64::max);
    assert!((length - 0.099_26).abs() < 5e-6, "{length} m");
    assert!((sharpest - 3630.0).abs() < 5.0, "{sharpest} 1/m");
}
