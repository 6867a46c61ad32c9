//! Cubic B-splines: evaluation by de Boor's algorithm, and interpolation of data points.

use nalgebra::SVector;

use super::PathError;
use super::curve::check_points;

/// Degree of every spline.
const DEGREE: usize = 3;
/// Number of control points, and of basis functions, that determine a point of the spline.
const LOCAL: usize = DEGREE + 1;
/// Smallest accepted pivot of an interpolation, relative to the largest entry of its row. A basis function at its own data point is far larger.
const MIN_PIVOT: f64 = 1e-12;

/// A cubic B-spline C(u) = Σ N_i(u) P_i in `D` dimensions, with its derivatives by the parameter u. In three dimensions,
/// the default, points are positions of the tool, m.
///
/// The convention is that of `scipy.interpolate.BSpline(t, c, 3)`: n control points have n + 4 knots, and the domain is
/// `t[3]` to `t[n]`.
#[derive(Clone, Debug, PartialEq)]
pub struct BSpline<const D: usize = 3> {
    knots: Vec<f64>,
    controls: Vec<SVector<f64, D>>,
}

/// End conditions of an interpolating spline. With data points Q and the chord length u_k = Σ |Q_i − Q_(i−1)|, in m, as
/// parameter, SciPy reproduces the spline by the call in each description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SplineEnds<const D: usize = 3> {
    /// No end condition, at least four points. Knots by averaging: t_(j+3) = (u_j + u_(j+1) + u_(j+2)) / 3 (Piegl and
    /// Tiller, The NURBS Book, 9.8). `make_interp_spline(u, Q, k=3, t=t)`.
    Averaged,
    /// No end condition, at least four points. The data points are the knots, except the second and the last but one.
    /// `make_interp_spline(u, Q, k=3)`.
    NotAKnot,
    /// Second derivatives of zero at both ends, at least two points. The data points are the knots.
    /// `make_interp_spline(u, Q, k=3, bc_type="natural")`.
    Natural,
    /// Given first derivatives dC/du at both ends, at least two points. The data points are the knots. A unit vector is
    /// the natural length. `make_interp_spline(u, Q, k=3, bc_type=([(1, start)], [(1, end)]))`.
    Clamped {
        /// dC/du at the first point.
        start: SVector<f64, D>,
        /// dC/du at the last point.
        end: SVector<f64, D>,
    },
}

impl<const D: usize> BSpline<D> {
    /// The spline of these knots and control points, m. Inside the domain, a knot may occur at most twice, so that the
    /// tangent is continuous.
    pub fn new(knots: Vec<f64>, controls: Vec<SVector<f64, D>>) -> Result<Self, PathError> {
        let count = controls.len();
        if count < LOCAL {
            return Err(PathError::TooFewPoints { given: count, needed: LOCAL });
        }
        if let Some(point) = controls.iter().position(|point| !point.iter().all(|c| c.is_finite())) {
            return Err(PathError::NotFinite { point });
        }
        if knots.len() != count + LOCAL {
            return Err(PathError::KnotCount { given: knots.len(), controls: count, needed: count + LOCAL });
        }
        let unordered = |knot: &usize| !knots[*knot].is_finite() || (*knot > 0 && knots[*knot] < knots[*knot - 1]);
        if let Some(knot) = (0..knots.len()).find(unordered) {
            return Err(PathError::KnotOrder { knot });
        }
        let (first, last) = (knots[DEGREE], knots[count]);
        if first >= last {
            return Err(PathError::KnotOrder { knot: count });
        }
        let corner = |knot: &usize| knots[*knot] > first && knots[*knot] < last && knots[*knot] == knots[*knot + 2];
        match (0..knots.len() - 2).find(corner) {
            Some(knot) => Err(PathError::KnotMultiplicity { knot }),
            None => Ok(Self { knots, controls }),
        }
    }

    /// The spline through data points, m.
    pub fn through(points: &[SVector<f64, D>], ends: SplineEnds<D>) -> Result<Self, PathError> {
        let free = matches!(ends, SplineEnds::Averaged | SplineEnds::NotAKnot);
        check_points(points, if free { LOCAL } else { 2 })?;
        let mut parameters = vec![0.0];
        for pair in points.windows(2) {
            parameters.push(parameters[parameters.len() - 1] + (pair[1] - pair[0]).norm());
        }
        let last = points.len() - 1;
        let total = parameters[last];
        let mut knots = vec![0.0; LOCAL];
        match ends {
            SplineEnds::Averaged => {
                knots.extend(parameters[1..last].windows(DEGREE).map(|three| three.iter().sum::<f64>() / 3.0));
            }
            SplineEnds::NotAKnot => knots.extend(&parameters[2..last - 1]),
            SplineEnds::Natural | SplineEnds::Clamped { .. } => knots.extend(&parameters[1..last]),
        }
        knots.extend([total; LOCAL]);

        let mut rows = Banded::default();
        let row = |u: f64, derivative: usize| {
            let span = span(&knots, u);
            (span - DEGREE, local::<LOCAL>(&knots, span, u, unit_controls())[derivative])
        };
        // Order and values of the derivatives at both ends.
        let ends = match ends {
            SplineEnds::Averaged | SplineEnds::NotAKnot => None,
            SplineEnds::Natural => Some((2, [SVector::zeros(); 2])),
            SplineEnds::Clamped { start, end } => Some((1, [start, end])),
        };
        if let Some((_, conditions)) = ends
            && let Some(end) = conditions.iter().position(|v| !v.iter().all(|c| c.is_finite()))
        {
            return Err(PathError::NotFinite { point: end * last });
        }
        for (index, (&u, &point)) in parameters.iter().zip(points).enumerate() {
            if let (true, Some((derivative, [_, end]))) = (index == last, ends) {
                rows.push(row(u, derivative), end);
            }
            rows.push(row(u, 0), point);
            if let (0, Some((derivative, [start, _]))) = (index, ends) {
                rows.push(row(u, derivative), start);
            }
        }
        let controls = rows.solve().ok_or(PathError::UnevenPoints)?;
        Self::new(knots, controls)
    }

    /// The knots, in the unit of the parameter.
    pub fn knots(&self) -> &[f64] {
        &self.knots
    }

    /// The control points, m.
    pub fn controls(&self) -> &[SVector<f64, D>] {
        &self.controls
    }

    /// First and last parameter.
    pub fn domain(&self) -> (f64, f64) {
        (self.knots[DEGREE], self.knots[self.controls.len()])
    }

    /// Position, first and second derivative by the parameter. A parameter outside the domain continues the polynomial
    /// of the first or the last span.
    pub fn at(&self, u: f64) -> [SVector<f64, D>; 3] {
        let span = span(&self.knots, u);
        local(&self.knots, span, u, std::array::from_fn(|j| self.controls[span - DEGREE + j]))
    }

    /// The different knots of the domain, ascending.
    pub(super) fn spans(&self) -> Vec<f64> {
        let mut spans = self.knots[DEGREE..=self.controls.len()].to_vec();
        spans.dedup();
        spans
    }
}

/// The span i with t_i <= u < t_(i+1), of positive length. The last one of the domain includes its end.
fn span(knots: &[f64], u: f64) -> usize {
    let count = knots.len() - LOCAL;
    let u = u.max(knots[DEGREE]);
    let span = knots.partition_point(|&knot| knot <= u) - 1;
    if span < count { span } else { knots.partition_point(|&knot| knot < knots[count]) - 1 }
}

/// Control "points" whose spline has the four basis functions as coordinates.
fn unit_controls() -> [SVector<f64, LOCAL>; LOCAL] {
    std::array::from_fn(|axis| SVector::from_fn(|row, _| f64::from(u8::from(row == axis))))
}

/// Position, first and second derivative on one span from its four control points.
fn local<const D: usize>(t: &[f64], span: usize, u: f64, p: [SVector<f64, D>; LOCAL]) -> [SVector<f64, D>; 3] {
    let low = span - DEGREE;
    let first: [_; 3] = std::array::from_fn(|j| (p[j + 1] - p[j]) * (3.0 / (t[low + j + 4] - t[low + j + 1])));
    let second: [_; 2] = std::array::from_fn(|j| (first[j + 1] - first[j]) * (2.0 / (t[low + j + 4] - t[low + j + 2])));
    [de_boor(t, span, u, p), de_boor(t, span, u, first), de_boor(t, span, u, second)]
}

/// De Boor's algorithm for the degree N − 1, with the N control points of the span.
fn de_boor<const N: usize, const D: usize>(
    t: &[f64],
    span: usize,
    u: f64,
    mut d: [SVector<f64, D>; N],
) -> SVector<f64, D> {
    let degree = N - 1;
    for round in 1..=degree {
        for j in (round..=degree).rev() {
            let (low, high) = (t[j + span - degree], t[j + 1 + span - round]);
            let share = (u - low) / (high - low);
            d[j] = d[j - 1] * (1.0 - share) + d[j] * share;
        }
    }
    d[degree]
}

/// Linear equations with at most [`DEGREE`] entries on either side of the diagonal. Each unknown is a vector.
#[derive(Default)]
struct Banded<const D: usize> {
    /// Entry `column − row + DEGREE` of each row.
    rows: Vec<[f64; 2 * DEGREE + 1]>,
    right: Vec<SVector<f64, D>>,
}

impl<const D: usize> Banded<D> {
    /// Adds the next row: its entries from column `first` on, and its right side.
    fn push(&mut self, (first, entries): (usize, SVector<f64, LOCAL>), right: SVector<f64, D>) {
        let mut row = [0.0; 2 * DEGREE + 1];
        for (j, entry) in entries.iter().enumerate() {
            // Entries beyond the band are zero: the basis functions vanish there.
            if let Some(place) = (first + j + DEGREE).checked_sub(self.rows.len()).and_then(|at| row.get_mut(at)) {
                *place = *entry;
            }
        }
        self.rows.push(row);
        self.right.push(right);
    }

    /// Gauss elimination without pivoting, which is stable for B-splines (de Boor 1978, chapter XIII). `None` for a
    /// singular matrix.
    fn solve(mut self) -> Option<Vec<SVector<f64, D>>> {
        let count = self.rows.len();
        for pivot in 0..count {
            let row = self.rows[pivot];
            let largest = row.iter().fold(0.0, |largest: f64, entry| largest.max(entry.abs()));
            if row[DEGREE].abs() <= MIN_PIVOT * largest {
                return None;
            }
            for below in pivot + 1..count.min(pivot + LOCAL) {
                let shift = below - pivot;
                let factor = self.rows[below][DEGREE - shift] / row[DEGREE];
                for column in 0..=DEGREE {
                    self.rows[below][DEGREE - shift + column] -= factor * row[DEGREE + column];
                }
                let by = self.right[pivot] * factor;
                self.right[below] -= by;
            }
        }
        for row in (0..count).rev() {
            for column in 1..count.min(row + LOCAL) - row {
                let known = self.right[row + column] * self.rows[row][DEGREE + column];
                self.right[row] -= known;
            }
            self.right[row] /= self.rows[row][DEGREE];
        }
        Some(self.right)
    }
}
