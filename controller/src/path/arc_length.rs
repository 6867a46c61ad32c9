//! B-splines by arc length: a table of lengths by Gauss-Legendre quadrature, inverted by Newton's method.

use nalgebra::Vector3;

use super::{BSpline, CurvePoint, PathError};

/// Abscissae and weights of the Gauss-Legendre quadrature with eight points on [-1, 1], positive half.
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];
/// Largest difference between a quadrature and the sum of its halves, relative to the length of the control polygon. The
/// table holds the halves, whose error is 2^16 times smaller.
const AGREEMENT: f64 = 1e-13;
/// Largest number of times that a span is halved.
const HALVINGS: u32 = 40;
/// Smallest accepted |dC/du|, relative to its mean.
const STANDSTILL: f64 = 1e-6;
/// Accuracy of the inversion, relative to the length. Newton's method ends below it, or after the largest number of
/// rounds, by which rounding errors dominate.
const INVERSION: f64 = 1e-15;
const ROUNDS: u32 = 8;

/// Largest number of parts into which [`ArcLength::divisions`] divides a part of the table.
const MOST_PARTS: f64 = 1_000.0;

/// A B-spline by arc length.
#[derive(Clone, Debug)]
pub(super) struct ArcLength {
    spline: BSpline,
    /// Parameters and arc lengths, ascending. Between two neighbours the quadrature is accurate.
    table: Vec<(f64, f64)>,
}

impl ArcLength {
    pub(super) fn of(spline: BSpline) -> Result<Self, PathError> {
        let polygon: f64 = spline.controls().windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        let (first, last) = spline.domain();
        let spans = spline.spans();
        let mut this = Self { spline, table: vec![(first, 0.0)] };
        for span in spans.windows(2) {
            let whole = this.quadrature(span[0], span[1]);
            this.extend((span[0], span[1]), whole, AGREEMENT * polygon, HALVINGS);
        }
        let slowest = STANDSTILL * polygon / (last - first);
        let pieces = this.table.windows(2).flat_map(|pair| abscissae(pair[0].0, pair[1].0).chain([pair[1].0]));
        for parameter in [first].into_iter().chain(pieces) {
            let speed = this.spline.at(parameter)[1].norm();
            if speed <= slowest || speed.is_nan() {
                return Err(PathError::Cusp { parameter });
            }
        }
        Ok(this)
    }

    /// Adds a part of the spline with the length `whole`, in halves of halves that agree.
    fn extend(&mut self, (from, to): (f64, f64), whole: f64, tolerance: f64, halvings: u32) {
        let middle = from + (to - from) / 2.0;
        let halves = [(from, middle), (middle, to)].map(|part| (part, self.quadrature(part.0, part.1)));
        let agree = (halves[0].1 + halves[1].1 - whole).abs() <= tolerance;
        for (part, length) in halves {
            if agree || halvings == 0 {
                let (_, so_far) = self.table[self.table.len() - 1];
                self.table.push((part.1, so_far + length));
            } else {
                self.extend(part, length, tolerance, halvings - 1);
            }
        }
    }

    /// Arc length between two parameters.
    fn quadrature(&self, from: f64, to: f64) -> f64 {
        let speed = |at: f64| self.spline.at(at)[1].norm();
        let weights = GAUSS.into_iter().flat_map(|(_, weight)| [weight; 2]);
        let sum: f64 = abscissae(from, to).zip(weights).map(|(at, weight)| weight * speed(at)).sum();
        sum * (to - from) / 2.0
    }

    pub(super) fn length(&self) -> f64 {
        self.table[self.table.len() - 1].1
    }

    /// Arc lengths that divide the spline into parts, which turn by about `turn` rad at most. Each part of the table is
    /// divided into at most [`MOST_PARTS`].
    pub(super) fn divisions(&self, turn: f64) -> Vec<f64> {
        let sharpness = |u: f64| {
            let [_, first, second] = self.spline.at(u);
            curvature(&first, &second).norm()
        };
        let mut divisions = Vec::new();
        for pair in self.table.windows(2) {
            let ((low, begin), (high, end)) = (pair[0], pair[1]);
            let sharpest = abscissae(low, high).chain([low, high]).map(sharpness).fold(0.0, f64::max);
            let parts = (sharpest * (end - begin) / turn).ceil().clamp(1.0, MOST_PARTS);
            divisions.extend((1..=parts as u32).map(|part| begin + (end - begin) * f64::from(part) / parts));
        }
        divisions
    }

    /// Parameter at the arc length `s`.
    pub(super) fn parameter(&self, s: f64) -> f64 {
        let after = self.table.partition_point(|&(_, length)| length <= s).clamp(1, self.table.len() - 1);
        let ((low, begin), (high, end)) = (self.table[after - 1], self.table[after]);
        let mut u = low + (high - low) * ((s - begin) / (end - begin)).clamp(0.0, 1.0);
        for _ in 0..ROUNDS {
            let excess = begin + self.quadrature(low, u) - s;
            u = (u - excess / self.spline.at(u)[1].norm()).clamp(low, high);
            if excess.abs() <= INVERSION * self.length() {
                break;
            }
        }
        u
    }

    pub(super) fn at(&self, s: f64) -> CurvePoint {
        let [position, first, second] = self.spline.at(self.parameter(s));
        CurvePoint { position, tangent: first.normalize(), curvature: curvature(&first, &second) }
    }
}

/// The abscissae of the quadrature on an interval.
fn abscissae(from: f64, to: f64) -> impl Iterator<Item = f64> {
    let (centre, half) = (f64::midpoint(from, to), (to - from) / 2.0);
    GAUSS.into_iter().flat_map(move |(x, _)| [centre - half * x, centre + half * x])
}

/// Curvature vector from the first and second derivative by any parameter.
fn curvature(first: &Vector3<f64>, second: &Vector3<f64>) -> Vector3<f64> {
    let square = first.norm_squared();
    (second - first * (first.dot(second) / square)) / square
}
