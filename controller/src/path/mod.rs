//! Paths of the tool, position and orientation by arc length, and of the joints.
//!
//! A [`Curve`] is the geometry of the tool's origin: line, circular arc, polyline with blends, or [`BSpline`]. A [`Path`]
//! adds the orientation of the tool. A [`JointPath`] leads the joints through way-points.
//!
//! Nothing here knows time. [`Feed`](crate::generator::Feed) plans the arc length over time, and
//! [`Contour`](crate::generator::Contour) moves the tool. [`PathTiming`](crate::generator::PathTiming) plans a joint
//! path over time, and [`TimeOptimal`](crate::generator::TimeOptimal) moves the joints.
//!
//! Positions are in the base frame, in m. A curve is constructed once, and may allocate and iterate then. Evaluations
//! neither allocate nor fail.
//!
//! ```
//! use mrroc_controller::path::{BSpline, Curve, Path, SplineEnds};
//! use nalgebra::{UnitQuaternion, Vector3};
//!
//! let points = [[0.0, 0.0], [0.1, 0.1], [0.2, 0.0], [0.3, 0.1]].map(|[x, y]| Vector3::new(x, y, 0.5));
//! let curve = Curve::spline(BSpline::through(&points, SplineEnds::Natural)?)?;
//! let path = Path::keeping(curve, UnitQuaternion::identity())?;
//! assert!((path.at(path.length()).pose.translation.vector - points[3]).norm() < 1e-12);
//! # Ok::<(), mrroc_controller::path::PathError>(())
//! ```

mod arc_length;
mod curve;
mod error;
mod joint;
mod spline;
#[cfg(test)]
mod tests;

use nalgebra::{UnitQuaternion, Vector3};

pub use crate::robot::Pose;
pub use curve::{Curve, CurvePoint};
pub use error::PathError;
pub use joint::{JointPath, JointPoint};
pub use spline::{BSpline, SplineEnds};

/// Parts of a smooth step for the feed. The derivative of the rate of turn between two parts exceeds the larger one of
/// both ends by less than 0.1 %.
const STEP_PARTS: u32 = 64;

/// Path of the tool in the base frame: pose by arc length `s`, m.
#[derive(Clone, Debug)]
pub struct Path {
    curve: Curve,
    turns: Vec<Turn>,
}

/// Rotation about one axis between two arc lengths.
#[derive(Clone, Copy, Debug)]
struct Turn {
    start: f64,
    length: f64,
    from: UnitQuaternion<f64>,
    /// Unit vector in the base frame.
    axis: Vector3<f64>,
    /// Angle of the whole turn, rad, 0 to π.
    angle: f64,
    /// Whether the rate of turn vanishes at both ends.
    eased: bool,
}

/// Pose of a path and its first two derivatives by the arc length, or by time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseState {
    /// Pose of the tool in the base frame.
    pub pose: Pose,
    /// First derivative of the position: unit tangent, or velocity in m/s.
    pub linear: Vector3<f64>,
    /// Rate of turn in the base frame: rad/m, or rad/s.
    pub angular: Vector3<f64>,
    /// Second derivative of the position: curvature in 1/m, or acceleration in m/s².
    pub linear_acceleration: Vector3<f64>,
    /// Derivative of the rate of turn in the base frame: rad/m², or rad/s².
    pub angular_acceleration: Vector3<f64>,
}

impl Path {
    /// A path with one orientation of the tool.
    pub fn keeping(curve: Curve, orientation: UnitQuaternion<f64>) -> Result<Self, PathError> {
        check_orientation(0, &orientation)?;
        Ok(Self { curve, turns: vec![Turn::none(0.0, orientation)] })
    }

    /// A path on which the tool turns the shortest way from the first to the second orientation, in proportion to the
    /// arc length.
    pub fn turning(curve: Curve, from: UnitQuaternion<f64>, to: UnitQuaternion<f64>) -> Result<Self, PathError> {
        check_orientation(0, &from)?;
        check_orientation(1, &to)?;
        let turn = Turn::between((0.0, from), (curve.length(), to), false);
        Ok(Self { curve, turns: vec![turn] })
    }

    /// A path with given orientations at given arc lengths, m, in ascending order. Between two of them the tool turns
    /// the shortest way by a quintic smooth step. The rate of turn vanishes at both, and its derivative is continuous. Before the first and after the last one, the tool keeps its orientation.
    pub fn turning_through(curve: Curve, orientations: &[(f64, UnitQuaternion<f64>)]) -> Result<Self, PathError> {
        let Some(&(at, first)) = orientations.first() else {
            return Err(PathError::TooFewPoints { given: 0, needed: 1 });
        };
        let mut turns = vec![Turn::none(at, first)];
        let mut last = 0.0;
        for (node, (at, orientation)) in orientations.iter().enumerate() {
            let ascending = if node == 0 { *at >= 0.0 } else { *at > last };
            if !ascending || *at > curve.length() {
                return Err(PathError::OrientationOrder { node, at: *at });
            }
            check_orientation(node, orientation)?;
            last = *at;
        }
        turns.extend(orientations.windows(2).map(|pair| Turn::between(pair[0], pair[1], true)));
        Ok(Self { curve, turns })
    }

    /// The curve of the tool's origin.
    pub fn curve(&self) -> &Curve {
        &self.curve
    }

    /// Length of the path, m.
    pub fn length(&self) -> f64 {
        self.curve.length()
    }

    /// Pose at the arc length `s`, m, with its derivatives by `s`. Values before the start and beyond the end give the
    /// ends.
    pub fn at(&self, s: f64) -> PoseState {
        let CurvePoint { position, tangent, curvature } = self.curve.at(s);
        let turn = self.turn(s);
        let [angle, rate, change] = turn.at(s);
        let turned = UnitQuaternion::from_scaled_axis(turn.axis * angle);
        PoseState {
            pose: Pose::from_parts(position.into(), turned * turn.from),
            linear: tangent,
            angular: turn.axis * rate,
            linear_acceleration: curvature,
            angular_acceleration: turn.axis * change,
        }
    }

    /// Pose at the arc length `s`, m, with its derivatives by time, if the tool is there with the path speed `velocity`,
    /// m/s, and the tangential acceleration `acceleration`, m/s².
    pub fn moving_at(&self, s: f64, velocity: f64, acceleration: f64) -> PoseState {
        let by_length = self.at(s);
        let square = velocity * velocity;
        PoseState {
            pose: by_length.pose,
            linear: by_length.linear * velocity,
            angular: by_length.angular * velocity,
            linear_acceleration: by_length.linear * acceleration + by_length.linear_acceleration * square,
            angular_acceleration: by_length.angular * acceleration + by_length.angular_acceleration * square,
        }
    }

    fn turn(&self, s: f64) -> &Turn {
        &self.turns[self.turns.partition_point(|turn| turn.start <= s).max(1) - 1]
    }

    /// Arc lengths at which curvature or rate of turn may change by a step, m. Others divide B-splines into parts that
    /// turn by `turn` rad at most, and smooth steps of the orientation into [`STEP_PARTS`].
    pub(crate) fn divisions(&self, turn: f64) -> Vec<f64> {
        let mut divisions = self.curve.divisions(turn);
        for turn in &self.turns {
            let parts = if turn.eased { STEP_PARTS } else { 1 };
            divisions.extend((0..=parts).map(|part| turn.start + turn.length * f64::from(part) / f64::from(parts)));
        }
        divisions
    }

    /// Largest rate of turn, rad/m, and largest derivative of the rate, rad/m², at two arc lengths.
    pub(crate) fn max_turning(&self, from: f64, to: f64) -> [f64; 2] {
        let ends = [from, to].map(|s| self.turn(s).at(s));
        [1, 2].map(|derivative| ends[0][derivative].abs().max(ends[1][derivative].abs()))
    }

    /// Largest rate of turn on the whole path, rad/m.
    pub(crate) fn max_turning_rate(&self) -> f64 {
        self.turns.iter().map(Turn::max_rate).fold(0.0, f64::max)
    }
}

fn check_orientation(node: usize, orientation: &UnitQuaternion<f64>) -> Result<(), PathError> {
    let finite = orientation.coords.iter().all(|c| c.is_finite());
    if finite { Ok(()) } else { Err(PathError::OrientationNotFinite { node }) }
}

impl Turn {
    fn none(start: f64, from: UnitQuaternion<f64>) -> Self {
        Self { start, length: 0.0, from, axis: Vector3::z(), angle: 0.0, eased: false }
    }

    fn between((start, from): (f64, UnitQuaternion<f64>), (end, to): (f64, UnitQuaternion<f64>), eased: bool) -> Self {
        let turn = (to * from.inverse()).scaled_axis();
        let axis = turn.try_normalize(0.0).unwrap_or_else(Vector3::z);
        Self { start, length: end - start, from, axis, angle: turn.norm(), eased }
    }

    /// Angle, and its first and second derivative by the arc length.
    fn at(&self, s: f64) -> [f64; 3] {
        if self.length <= 0.0 || self.angle == 0.0 {
            return [0.0; 3];
        }
        let u = ((s - self.start) / self.length).clamp(0.0, 1.0);
        let (rate, change) = (self.angle / self.length, self.angle / self.length.powi(2));
        if self.eased {
            let share = u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
            let slope = 30.0 * (u * (1.0 - u)).powi(2);
            [self.angle * share, rate * slope, change * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)]
        } else {
            [self.angle * u, rate, 0.0]
        }
    }

    /// Largest rate of turn, rad/m.
    fn max_rate(&self) -> f64 {
        let [_, rate, _] = self.at(self.start + self.length / 2.0);
        rate
    }
}
