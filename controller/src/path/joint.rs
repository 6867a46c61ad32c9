//! Paths of the joints: cubic splines through way-points, and B-splines.

use nalgebra::SVector;
use servo::MAX_AXES;

use super::{BSpline, PathError, SplineEnds};
use crate::robot::Axes;

/// Path of the joints q(s): a cubic spline through way-points, or a B-spline. Curvature is continuous.
///
/// The parameter s is 0 at the first way-point. At the others it is the sum of the straight distances |Δq| between
/// way-points, in which rad and m count alike. On a B-spline, s is the parameter of the spline, counted from the start
/// of its domain.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPath {
    spline: BSpline<MAX_AXES>,
    axes: usize,
}

/// Position of a joint path and its derivatives by the path parameter s. Entries beyond the axes of the path are zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPoint {
    /// q, rad, or m for a linear joint.
    pub position: Axes,
    /// q′ = dq/ds.
    pub first: Axes,
    /// q″ = d²q/ds².
    pub second: Axes,
}

impl JointPath {
    /// The path of the first `axes` axes through way-points, rad, or m for a linear joint. Neighbours differ by 1e-9 at
    /// least. [`SplineEnds`] says how many way-points are needed.
    pub fn through(axes: usize, way_points: &[Axes], ends: SplineEnds<MAX_AXES>) -> Result<Self, PathError> {
        if axes == 0 || axes > MAX_AXES {
            return Err(PathError::Axes { axes, max: MAX_AXES });
        }
        let masked = |values: &[f64]| -> SVector<f64, MAX_AXES> {
            SVector::from_fn(|axis, _| if axis < axes { values[axis] } else { 0.0 })
        };
        let points: Vec<_> = way_points.iter().map(|point| masked(point)).collect();
        let ends = match ends {
            SplineEnds::Clamped { start, end } => {
                SplineEnds::Clamped { start: masked(start.as_slice()), end: masked(end.as_slice()) }
            }
            SplineEnds::Averaged | SplineEnds::NotAKnot | SplineEnds::Natural => ends,
        };
        Ok(Self { spline: BSpline::through(&points, ends)?, axes })
    }

    /// The path of the first `axes` axes along a B-spline, whose control points are joint positions, rad, or m for a
    /// linear joint. The path begins at the first control point only if the first knot occurs four times, and ends at
    /// the last one accordingly. Refuses a double knot inside the domain.
    pub fn along(axes: usize, spline: &BSpline<MAX_AXES>) -> Result<Self, PathError> {
        if axes == 0 || axes > MAX_AXES {
            return Err(PathError::Axes { axes, max: MAX_AXES });
        }
        let (first, last) = spline.domain();
        let inside = |pair: &[f64]| pair[0] > first && pair[0] < last && pair[0] == pair[1];
        if let Some(knot) = spline.knots().windows(2).position(inside) {
            return Err(PathError::JointKnotMultiplicity { knot });
        }
        let knots = spline.knots().iter().map(|knot| knot - first).collect();
        let masked =
            |point: &SVector<f64, MAX_AXES>| SVector::from_fn(|axis, _| if axis < axes { point[axis] } else { 0.0 });
        Ok(Self { spline: BSpline::new(knots, spline.controls().iter().map(masked).collect())?, axes })
    }

    /// Number of axes.
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// Path parameter at the last way-point.
    pub fn length(&self) -> f64 {
        let (_, last) = self.spline.domain();
        last
    }

    /// The point at the parameter `s`. Values before the start and beyond the end give the ends.
    pub fn at(&self, s: f64) -> JointPoint {
        let [position, first, second] = self.spline.at(s.clamp(0.0, self.length()));
        JointPoint { position: position.into(), first: first.into(), second: second.into() }
    }

    /// Parameters at which the third derivative may change by a step, from 0 to the length.
    pub(crate) fn knots(&self) -> Vec<f64> {
        self.spline.spans()
    }
}
