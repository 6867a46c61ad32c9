//! Joint velocities from the velocity of a tool, by weighted and damped least squares.

use nalgebra::{SMatrix, SVector, Vector3, Vector6};
use servo::MAX_AXES;

use crate::robot::Jacobian;

/// Weight of an angular velocity against a linear velocity, m. An arm of less than six axes thus follows the linear
/// velocity to about 0.1 %, and the angular velocity as far as its axes permit.
const LEVER: f64 = 0.02;

/// Damping relative to the mean square of the Jacobian. A direction of full speed is slowed by less than 1e-4 of it.
const DAMPING: f64 = 1e-8;

/// The Jacobian of a tool whose origin is at `lever` from the flange, in the axes of the base, m.
pub(super) fn at_tool(flange: &Jacobian, lever: &Vector3<f64>) -> Jacobian {
    let mut tool = *flange;
    for axis in 0..MAX_AXES {
        let angular = Vector3::from(flange.fixed_view::<3, 1>(3, axis));
        let mut linear = tool.fixed_view_mut::<3, 1>(0, axis);
        linear += angular.cross(lever);
    }
    tool
}

/// Joint velocities at which the tool moves at `twist`: linear velocity, m/s, and angular velocity, rad/s, both in the
/// axes of the Jacobian. Joints that have no column stand.
///
/// Of all joint velocities, the result is the one of the least weighted error. A redundant arm moves with the least sum
/// of squares. `None` if a number is not finite.
pub(super) fn joint_velocities(jacobian: &Jacobian, twist: &Vector6<f64>) -> Option<SVector<f64, MAX_AXES>> {
    let mut weighted = *jacobian;
    weighted.fixed_rows_mut::<3>(3).scale_mut(LEVER);
    let mut wanted = *twist;
    wanted.fixed_rows_mut::<3>(3).scale_mut(LEVER);
    let mut normal: SMatrix<f64, MAX_AXES, MAX_AXES> = weighted.tr_mul(&weighted);
    let damping = DAMPING * (normal.trace() / MAX_AXES as f64).max(f64::MIN_POSITIVE);
    for axis in 0..MAX_AXES {
        normal[(axis, axis)] += damping;
    }
    let mut rates: SVector<f64, MAX_AXES> = weighted.tr_mul(&wanted);
    normal.cholesky()?.solve_mut(&mut rates);
    rates.iter().all(|rate| rate.is_finite()).then_some(rates)
}
