//! Distance of a posture from a singularity.

use serde::Serialize;

use super::{Jacobian, KinematicsError};

/// Distance of a posture from a singularity, in which the flange cannot move in some direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Singularity {
    /// The axis with the largest speed in the motion of `margin`. Among axes within 10 % of it, the axis nearest to
    /// the base.
    pub axis: u8,
    /// Smallest singular value of the Jacobian, with lengths in m. This value is the speed of the flange in its
    /// slowest direction at joint speeds of norm 1, with m/s and rad/s taken together. Zero at a singularity.
    pub margin: f64,
}

impl Singularity {
    /// Maximum number of sweeps of the decomposition. Beyond it, [`KinematicsError::NotFinite`].
    const MOST_SWEEPS: usize = 200;

    /// Singularity of a robot with `axes` axes. Columns beyond them are zero. The margin is singular value
    /// number min(`axes`, 6).
    pub fn of(jacobian: &Jacobian, axes: usize) -> Result<Self, KinematicsError> {
        let decomposed =
            jacobian.try_svd(false, true, f64::EPSILON, Self::MOST_SWEEPS).ok_or(KinematicsError::NotFinite)?;
        let slowest = axes.clamp(1, 6) - 1;
        let motion = decomposed.v_t.as_ref().map(|rows| rows.row(slowest).abs()).ok_or(KinematicsError::NotFinite)?;
        let most = motion.max();
        let axis = motion.iter().position(|&share| share > 0.9 * most);
        Ok(Self { axis: axis.unwrap_or(0) as u8, margin: decomposed.singular_values[slowest] })
    }
}
