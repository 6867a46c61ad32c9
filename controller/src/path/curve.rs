//! Curves by arc length: line, arc, polyline with blends, B-spline.

use std::f64::consts::{PI, TAU};
use std::sync::Arc as Shared;

use nalgebra::{SVector, Unit, Vector3};

use super::arc_length::ArcLength;
use super::{BSpline, PathError};

/// Distance below which two points coincide, m or rad.
const COINCIDENT: f64 = 1e-9;
/// Ratio of the longest side of a triangle to the diameter of its circumscribed circle, below which its points lie on a
/// line.
const COLLINEAR: f64 = 1e-6;
/// Change of direction below which a polyline goes straight on, and difference from π below which it turns back, rad.
const STRAIGHT: f64 = 1e-9;
const BACK: f64 = 1e-3;
/// Distance from the end at which the curvature of a section of a spline is taken, relative to the section.
const BEFORE_END: f64 = 1e-6;
/// Excess of a blend over its side that is accepted as a rounding error, m.
const ROUNDING: f64 = 1e-12;

/// Position of a curve and its first two derivatives by the arc length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Position, m.
    pub position: Vector3<f64>,
    /// Unit tangent.
    pub tangent: Vector3<f64>,
    /// Curvature vector, 1/m: it points to the centre of curvature, and its length is the inverse radius.
    pub curvature: Vector3<f64>,
}

/// A curve in space by its arc length `s`, m. Its tangent is continuous.
///
/// Curvature is continuous on a B-spline without double knots. It changes by a step where a line meets an arc.
#[derive(Clone, Debug)]
pub struct Curve {
    pieces: Vec<Piece>,
}

#[derive(Clone, Debug)]
struct Piece {
    /// Arc length of the curve before the piece, m.
    start: f64,
    length: f64,
    shape: Shape,
}

#[derive(Clone, Debug)]
enum Shape {
    Line { from: Vector3<f64>, tangent: Vector3<f64> },
    Arc(Arc),
    Spline(Shared<ArcLength>),
}

/// Circular arc: centre + radius (x cos φ + y sin φ), with φ = s / radius.
#[derive(Clone, Copy, Debug)]
struct Arc {
    centre: Vector3<f64>,
    x: Vector3<f64>,
    y: Vector3<f64>,
    radius: f64,
}

impl Curve {
    /// A straight line.
    pub fn line(from: Vector3<f64>, to: Vector3<f64>) -> Result<Self, PathError> {
        check_points(&[from, to], 2)?;
        let way = to - from;
        let shape = Shape::Line { from, tangent: way.normalize() };
        Ok(Self { pieces: vec![Piece { start: 0.0, length: way.norm(), shape }] })
    }

    /// The circular arc from a point through a second to a third point.
    pub fn arc(from: Vector3<f64>, through: Vector3<f64>, to: Vector3<f64>) -> Result<Self, PathError> {
        check_points(&[from, through, to], 3)?;
        let (a, b) = (through - from, to - from);
        if b.norm() < COINCIDENT {
            return Err(PathError::Collinear);
        }
        let normal = a.cross(&b);
        let sides = [a.norm(), b.norm(), (to - through).norm()];
        let longest = sides.into_iter().fold(0.0, f64::max);
        let diameter = sides.into_iter().product::<f64>() / normal.norm();
        if longest <= COLLINEAR * diameter {
            return Err(PathError::Collinear);
        }
        let offset = (b * a.norm_squared() - a * b.norm_squared()).cross(&normal) / (2.0 * normal.norm_squared());
        let x = -offset.normalize();
        let y = normal.normalize().cross(&x);
        let end = b - offset;
        let angle = end.dot(&y).atan2(end.dot(&x)).rem_euclid(TAU);
        Ok(Self::turning(Arc { centre: from + offset, x, y, radius: offset.norm() }, angle))
    }

    /// The circular arc that begins at a point and turns about a centre by `angle`, rad, right-handed about `normal`.
    /// The circle lies in the plane through the point, perpendicular to the normal. A component of the radius along the
    /// normal is ignored.
    pub fn arc_about(
        from: Vector3<f64>,
        centre: Vector3<f64>,
        normal: Vector3<f64>,
        angle: f64,
    ) -> Result<Self, PathError> {
        for (point, vector) in [from, centre, normal].iter().enumerate() {
            check_finite(point, vector)?;
        }
        if !angle.is_finite() || angle == 0.0 {
            return Err(PathError::NoAngle { angle });
        }
        let normal = Unit::try_new(normal * angle.signum(), COINCIDENT).ok_or(PathError::NoRadius)?;
        let spoke = from - centre;
        let spoke = spoke - *normal * normal.dot(&spoke);
        let x = Unit::try_new(spoke, COINCIDENT).ok_or(PathError::NoRadius)?;
        let arc = Arc { centre: from - spoke, x: *x, y: normal.cross(&x), radius: spoke.norm() };
        Ok(Self::turning(arc, angle.abs()))
    }

    /// Straight lines between points, with a circular blend of `radius`, m, at each inner point.
    pub fn polyline(points: &[Vector3<f64>], radius: f64) -> Result<Self, PathError> {
        check_points(points, 2)?;
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(PathError::BlendRadius { radius });
        }
        let last = points.len() - 1;
        let direction = |side: usize| (points[side + 1] - points[side]).normalize();
        let mut curve = Self { pieces: Vec::new() };
        // End of the last blend, and its distance from the corner.
        let (mut from, mut used) = (points[0], 0.0);
        for corner in 1..=last {
            let side = corner - 1;
            let before = direction(side);
            let after = if corner < last { direction(corner) } else { before };
            let turn = before.cross(&after).norm().atan2(before.dot(&after));
            if turn > PI - BACK {
                return Err(PathError::Reversal { corner });
            }
            let straight = turn < STRAIGHT;
            let trim = if straight { 0.0 } else { radius * (turn / 2.0).tan() };
            let (needed, available) = (used + trim, (points[corner] - points[side]).norm());
            if needed > available + ROUNDING {
                return Err(PathError::BlendTooLarge { side, needed, available });
            }
            let begin = points[corner] - before * trim;
            if available - needed > ROUNDING {
                curve.push(available - needed, Shape::Line { from, tangent: before });
            }
            if !straight {
                let y = before;
                let x = (before * before.dot(&after) - after).normalize();
                let arc = Arc { centre: begin - x * radius, x, y, radius };
                curve.push(radius * turn, Shape::Arc(arc));
            }
            (from, used) = (points[corner] + after * trim, trim);
        }
        Ok(curve)
    }

    /// A B-spline by its arc length, to 1e-12 of the length. Refuses a spline whose derivative vanishes.
    pub fn spline(spline: BSpline) -> Result<Self, PathError> {
        let shape = ArcLength::of(spline)?;
        let piece = Piece { start: 0.0, length: shape.length(), shape: Shape::Spline(Shared::new(shape)) };
        Ok(Self { pieces: vec![piece] })
    }

    fn turning(arc: Arc, angle: f64) -> Self {
        Self { pieces: vec![Piece { start: 0.0, length: arc.radius * angle, shape: Shape::Arc(arc) }] }
    }

    fn push(&mut self, length: f64, shape: Shape) {
        self.pieces.push(Piece { start: self.length(), length, shape });
    }

    /// Length of the curve, m.
    pub fn length(&self) -> f64 {
        self.pieces.last().map_or(0.0, |piece| piece.start + piece.length)
    }

    /// The point at the arc length `s`, m. Values before the start and beyond the end give the ends.
    pub fn at(&self, s: f64) -> CurvePoint {
        let piece = &self.pieces[self.piece(s)];
        piece.shape.at((s - piece.start).clamp(0.0, piece.length))
    }

    fn piece(&self, s: f64) -> usize {
        self.pieces.partition_point(|piece| piece.start <= s).max(1) - 1
    }

    /// Arc lengths at which pieces meet, m.
    pub(super) fn joints(&self) -> impl Iterator<Item = f64> {
        self.pieces.iter().skip(1).map(|piece| piece.start)
    }

    /// Largest curvature between two arc lengths, 1/m. On a B-spline, the largest one at both ends.
    pub(crate) fn max_curvature(&self, from: f64, to: f64) -> f64 {
        let (first, last) = (self.piece(from), self.piece(to));
        let within = |piece: &Piece| match &piece.shape {
            Shape::Line { .. } => 0.0,
            Shape::Arc(arc) => 1.0 / arc.radius,
            Shape::Spline(spline) => {
                let at = |s: f64| spline.at((s - piece.start).clamp(0.0, piece.length)).curvature.norm();
                // The curvature behind a double knot differs.
                at(from).max(at(to - BEFORE_END * (to - from)))
            }
        };
        self.pieces[first..=last].iter().map(within).fold(0.0, f64::max)
    }

    /// Arc lengths at which pieces meet, and others that divide B-splines into parts that turn by `turn` rad at most, m.
    pub(crate) fn divisions(&self, turn: f64) -> Vec<f64> {
        let mut divisions: Vec<f64> = self.joints().collect();
        for piece in &self.pieces {
            match &piece.shape {
                Shape::Line { .. } | Shape::Arc(_) => {}
                Shape::Spline(spline) => divisions.extend(spline.divisions(turn).iter().map(|s| piece.start + s)),
            }
        }
        divisions
    }
}

impl Shape {
    fn at(&self, s: f64) -> CurvePoint {
        match self {
            Self::Line { from, tangent } => {
                CurvePoint { position: from + tangent * s, tangent: *tangent, curvature: Vector3::zeros() }
            }
            Self::Arc(Arc { centre, x, y, radius }) => {
                let (sin, cos) = (s / radius).sin_cos();
                let spoke = x * cos + y * sin;
                CurvePoint {
                    position: centre + spoke * *radius,
                    tangent: y * cos - x * sin,
                    curvature: -spoke / *radius,
                }
            }
            Self::Spline(spline) => spline.at(s),
        }
    }
}

fn check_finite<const D: usize>(point: usize, position: &SVector<f64, D>) -> Result<(), PathError> {
    if position.iter().all(|c| c.is_finite()) { Ok(()) } else { Err(PathError::NotFinite { point }) }
}

/// Refuses too few points, points that are not finite, and neighbours that coincide.
pub(super) fn check_points<const D: usize>(points: &[SVector<f64, D>], needed: usize) -> Result<(), PathError> {
    if points.len() < needed {
        return Err(PathError::TooFewPoints { given: points.len(), needed });
    }
    for (point, position) in points.iter().enumerate() {
        check_finite(point, position)?;
    }
    match points.windows(2).position(|pair| (pair[1] - pair[0]).norm() < COINCIDENT) {
        Some(point) => Err(PathError::Coincident { point }),
        None => Ok(()),
    }
}
