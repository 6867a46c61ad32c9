//! Least-squares place of a box from the distances of the elements of an ultrasonic matrix.
//!
//! Unknown are the centre *(x, y)* of the near face of the box, its rotation, and its distance *h* from the matrix. The
//! near face is a rectangle. Let *l* be the distance of an element from the rectangle, in the plane of the matrix, and *c*
//! half the opening angle of its cone. The element sees the rectangle if *l* ≤ *h* tan *c*, at the distance
//! √(*h*² + *l*²). Otherwise the element sees the floor, at the distance *h* plus the height of the box.
//!
//! A measured distance below *h* plus half the height is an echo of the box, another one an echo of the floor. Each gives
//! one residual of its distance, and one residual of its place: the length by which *l* is on the wrong side of
//! *h* tan *c*. Residuals above three standard deviations have less weight (Huber). Levenberg-Marquardt solves the problem
//! from several rotations, and the solution with the least cost is used.

use std::f64::consts::PI;

use nalgebra::{Matrix4, Vector4};

use super::{EchoError, MatrixConfig};

/// Share of the elements that must have an echo.
const NEEDED: f64 = 0.5;

/// Least number of elements that see the box.
const NEAR: usize = 4;

/// Greatest standard deviation of a place, m.
const MOST_DEVIATION: f64 = 0.005;

/// Greatest residual, in standard deviations of one distance.
const MOST_RESIDUAL: f64 = 3.0;

/// Residual, in standard deviations, above which the weight decreases.
const HUBER: f64 = 3.0;

/// Rotations that are compared, and number of the best ones from which a solution begins.
const STARTS: usize = 8;
const SOLVED: usize = 2;

/// Greatest number of iterations of a solution.
const ITERATIONS: usize = 20;

/// One element in this number may be an outlier.
const OUTLIERS: usize = 10;

/// Least standard deviation of the mean of several distances, m: echo times have a resolution of 1 µs.
const RESOLUTION: f64 = 1e-4;

/// Mean distances of the elements.
#[derive(Clone, Debug, Default)]
pub(super) struct Echoes {
    /// Place of the element, m; mean distance, m; number of distances.
    elements: Vec<([f64; 2], f64, usize)>,
    /// Elements without an echo.
    pub(super) missing: u16,
    /// Distances that differ too much from the median of their element.
    pub(super) outliers: u16,
}

/// A fitted box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fitted {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) distance: f64,
    pub(super) yaw: f64,
    pub(super) deviation: [f64; 3],
    pub(super) residual: f64,
    pub(super) used: u16,
    pub(super) outliers: u16,
}

impl Echoes {
    /// Adds an element with its distances, m, at most [`MOST_SCANS`](super::MOST_SCANS).
    pub(super) fn add(&mut self, place: [f64; 2], distances: impl Iterator<Item = f64>, spread: f64) {
        let mut sorted = [0.0; super::MOST_SCANS];
        let mut count = 0;
        for (slot, distance) in sorted.iter_mut().zip(distances) {
            *slot = distance;
            count += 1;
        }
        let sorted = &mut sorted[..count];
        sorted.sort_by(f64::total_cmp);
        let Some(&median) = sorted.get(count / 2) else {
            self.missing += 1;
            return;
        };
        let (mut sum, mut used) = (0.0, 0);
        for distance in sorted.iter().filter(|distance| (**distance - median).abs() <= spread) {
            sum += distance;
            used += 1;
        }
        self.outliers += (count - used) as u16;
        self.elements.push((place, sum / used as f64, used));
    }
}

/// Fits a box with edges `size`, m.
pub(super) fn locate(echoes: &Echoes, config: &MatrixConfig, size: [f64; 3]) -> Result<Fitted, EchoError> {
    let all = echoes.elements.len() + usize::from(echoes.missing);
    let (found, needed) = (echoes.elements.len(), ((all as f64 * NEEDED).ceil() as usize).max(NEAR));
    if found < needed {
        let [found, elements, needed] = [found, all, needed].map(|count| count as u16);
        return Err(EchoError::TooFewEchoes { found, elements, needed });
    }
    let problem = Problem::of(echoes, config, size)?;
    let start = |start: usize| {
        let yaw = PI * start as f64 / STARTS as f64;
        Vector4::new(problem.start[0], problem.start[1], problem.start[2], yaw)
    };
    let mut starts: [_; STARTS] = std::array::from_fn(|number| (problem.cost(&start(number)), start(number)));
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let solved = starts[..SOLVED].iter().map(|(_, start)| problem.solve(*start)).min_by(|a, b| a.1.total_cmp(&b.1));
    let (place, _) = solved.expect("there is at least one start");
    problem.judge(&place)
}

struct Problem<'a> {
    echoes: &'a Echoes,
    /// Tangent of half the cone.
    slope: f64,
    /// Half edges of the near face, and height of the box, m.
    half: [f64; 2],
    height: f64,
    /// Standard deviation of one distance, m.
    deviation: f64,
    /// Distance that separates echoes of the box from echoes of the floor, m.
    threshold: f64,
    /// First values: centre and distance of the near face.
    start: [f64; 3],
}

impl<'a> Problem<'a> {
    fn of(echoes: &'a Echoes, config: &MatrixConfig, size: [f64; 3]) -> Result<Self, EchoError> {
        let mut sorted: Vec<_> = echoes.elements.iter().map(|(_, distance, _)| *distance).collect();
        sorted.sort_by(f64::total_cmp);
        // A single echo from nearer than the box is an outlier.
        let nearest = sorted[NEAR / 2];
        let height = size[2];
        let threshold = nearest + 0.5 * height;
        let (mut sum, mut near) = ([0.0; 3], 0);
        for ([x, y], distance, _) in echoes.elements.iter().filter(|(_, distance, _)| *distance < threshold) {
            sum = [sum[0] + x, sum[1] + y, sum[2] + distance];
            near += 1;
        }
        let far = echoes.elements.len() - near;
        // The floor is seen beside the box, at its height below the near face.
        let floor = sorted[near + far / 2..].first().copied();
        let fits = floor.is_some_and(|floor| (floor - nearest - height).abs() < 0.25 * height + 3.0 * config.deviation);
        if near < NEAR || far < NEAR || !fits {
            return Err(EchoError::NothingFound { height, near: near as u16, far: far as u16 });
        }
        Ok(Self {
            echoes,
            slope: config.half_cone.tan(),
            half: [0.5 * size[0], 0.5 * size[1]],
            height,
            deviation: config.deviation,
            threshold,
            start: sum.map(|sum| sum / near as f64),
        })
    }

    /// Standard deviation of a mean of `count` distances, m.
    fn sigma(&self, count: usize) -> f64 {
        (self.deviation / (count as f64).sqrt()).hypot(RESOLUTION)
    }

    /// Residuals of an element, in standard deviations: of its distance, and of its place.
    fn residuals(&self, place: &Vector4<f64>, element: &([f64; 2], f64, usize)) -> [f64; 2] {
        let &([x, y], distance, count) = element;
        let (sine, cosine) = place[3].sin_cos();
        let (dx, dy) = (x - place[0], y - place[1]);
        let beyond = [(cosine * dx + sine * dy).abs() - self.half[0], (cosine * dy - sine * dx).abs() - self.half[1]];
        let from_face = beyond[0].max(0.0).hypot(beyond[1].max(0.0));
        // Inside the rectangle, the distance from its edge is negative: a floor echo from there has a slope.
        let from_edge = if from_face > 0.0 { from_face } else { beyond[0].max(beyond[1]) };
        let radius = place[2] * self.slope;
        let sigma = self.sigma(count);
        if distance < self.threshold {
            [(place[2].hypot(from_face) - distance) / sigma, (from_edge - radius).max(0.0) / sigma]
        } else {
            [(place[2] + self.height - distance) / sigma, (radius - from_edge).max(0.0) / sigma]
        }
    }

    fn cost(&self, place: &Vector4<f64>) -> f64 {
        let huber = |residual: f64| {
            let size = residual.abs();
            if size <= HUBER { 0.5 * size * size } else { HUBER * (size - 0.5 * HUBER) }
        };
        let elements = self.echoes.elements.iter();
        elements.flat_map(|element| self.residuals(place, element)).map(huber).sum()
    }

    /// Normal matrix and gradient at a place.
    fn linearise(&self, place: &Vector4<f64>) -> (Matrix4<f64>, Vector4<f64>) {
        const STEPS: [f64; 4] = [1e-6, 1e-6, 1e-6, 1e-5];
        let (mut normal, mut gradient) = (Matrix4::zeros(), Vector4::zeros());
        for element in &self.echoes.elements {
            let now = self.residuals(place, element);
            let beside: [[[f64; 2]; 2]; 4] = std::array::from_fn(|axis| {
                [STEPS[axis], -STEPS[axis]].map(|step| {
                    let mut moved = *place;
                    moved[axis] += step;
                    self.residuals(&moved, element)
                })
            });
            for (kind, residual) in now.into_iter().enumerate() {
                let slope =
                    Vector4::from_fn(|axis, _| (beside[axis][0][kind] - beside[axis][1][kind]) / (2.0 * STEPS[axis]));
                let weight = if residual.abs() <= HUBER { 1.0 } else { HUBER / residual.abs() };
                normal += slope * slope.transpose() * weight;
                gradient += slope * (residual * weight);
            }
        }
        (normal, gradient)
    }

    /// Levenberg-Marquardt from `place`. Returns the solution and its cost.
    fn solve(&self, mut place: Vector4<f64>) -> (Vector4<f64>, f64) {
        let (mut cost, mut damping) = (self.cost(&place), 1e-3);
        for _ in 0..ITERATIONS {
            let (normal, gradient) = self.linearise(&place);
            let mut damped = normal;
            for axis in 0..4 {
                damped[(axis, axis)] += damping * normal[(axis, axis)].max(1.0);
            }
            let Some(factor) = damped.cholesky() else { break };
            let step = factor.solve(&gradient);
            let next = place - step;
            let after = self.cost(&next);
            if after < cost {
                let gain = cost - after;
                (place, cost, damping) = (next, after, damping * 0.3);
                if gain < 1e-6 * cost {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        (place, cost)
    }

    /// The result of a solution, or the reason why the solution is refused.
    fn judge(&self, place: &Vector4<f64>) -> Result<Fitted, EchoError> {
        let (normal, _) = self.linearise(place);
        // A square face or a single row leaves the rotation open. A weak prior of half a turn keeps the matrix regular.
        let mut regular = normal;
        regular[(3, 3)] += 1.0 / (PI * PI);
        let covariance = regular.try_inverse().unwrap_or(Matrix4::identity());
        let deviation: [f64; 3] = std::array::from_fn(|axis| covariance[(axis, axis)].max(0.0).sqrt());
        let worst = deviation[0].max(deviation[1]);
        if worst.is_nan() || worst > MOST_DEVIATION {
            return Err(EchoError::Uncertain { deviation: worst, most: MOST_DEVIATION });
        }
        let (mut sum, mut used, mut outliers) = (0.0, 0_u16, 0_u16);
        for element in &self.echoes.elements {
            let sigma = self.sigma(element.2);
            let [distance, side] = self.residuals(place, element);
            if distance.abs().max(side) > 2.0 * HUBER {
                outliers += 1;
            } else {
                sum += (distance * sigma).powi(2);
                used += 1;
            }
        }
        let residual = (sum / f64::from(used.max(1))).sqrt();
        let most = MOST_RESIDUAL * self.deviation;
        if residual > most || usize::from(outliers) > self.echoes.elements.len() / OUTLIERS {
            let all = self.echoes.elements.iter().map(|it| (self.residuals(place, it)[0] * self.sigma(it.2)).powi(2));
            let residual = (all.sum::<f64>() / self.echoes.elements.len() as f64).sqrt();
            return Err(EchoError::Unlike { residual, most });
        }
        let yaw = place[3].rem_euclid(PI);
        Ok(Fitted { x: place[0], y: place[1], distance: place[2], yaw, deviation, residual, used, outliers })
    }
}
