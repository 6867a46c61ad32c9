//! Errors of path geometry.

use can::counted;
use thiserror::Error;

/// Reasons why points, knots or angles do not define a path. Points, corners and knots are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum PathError {
    /// The number of axes of a joint path is zero or above [`servo::MAX_AXES`].
    #[error("{axes} axes, supported are 1 to {max}")]
    Axes { axes: usize, max: usize },
    #[error("{}, at least {needed} are needed", counted(*.given, "point"))]
    TooFewPoints { given: usize, needed: usize },
    #[error("point or vector {point}, counted from 0, has a coordinate that is NaN or infinite: give finite numbers")]
    NotFinite { point: usize },
    #[error("points {point} and {} coincide: leave one of them out", .point + 1)]
    Coincident { point: usize },
    #[error("the three points of the arc lie on one line, or two of them coincide: use a line, or move a point")]
    Collinear,
    #[error("radius or normal of the arc is zero")]
    NoRadius,
    #[error("an angle of {angle} rad defines no arc")]
    NoAngle { angle: f64 },
    #[error("blend radius {radius} is not positive and finite")]
    BlendRadius { radius: f64 },
    /// The blends at both ends of a side overlap. `needed` is the length of the side that they need, m.
    #[error("the blends on the side after point {side} need {needed:.6} m of its {available:.6} m: reduce the radius")]
    BlendTooLarge { side: usize, needed: f64, available: f64 },
    #[error("the polyline turns back at point {corner}: no blend has a finite length")]
    Reversal { corner: usize },
    #[error("{}, {controls} control points need {needed}", counted(*.given, "knot"))]
    KnotCount { given: usize, controls: usize, needed: usize },
    #[error(
        "knot {knot}, counted from 0, is NaN or infinite, less than the knot before it, or makes the domain empty: \
         give finite knots that do not decrease"
    )]
    KnotOrder { knot: usize },
    #[error("knot {knot} occurs more than twice inside the domain: the path has a corner there")]
    KnotMultiplicity { knot: usize },
    #[error("knot {knot} occurs twice inside the domain: the acceleration of the joints would jump there")]
    JointKnotMultiplicity { knot: usize },
    #[error("the spacing of the data points is too uneven for an interpolation")]
    UnevenPoints,
    #[error("the spline stands still at parameter {parameter}: its tangent is undefined")]
    Cusp { parameter: f64 },
    #[error("orientation {node} is not finite")]
    OrientationNotFinite { node: usize },
    #[error("orientation {node} is at {at} m, which is not between its neighbours on the path")]
    OrientationOrder { node: usize, at: f64 },
}
