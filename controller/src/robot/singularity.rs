//! Distance of a posture from a singularity.

use super::{Jacobian, KinematicsError};

/// How near joints are to a posture that loses a direction of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Singularity {
    /// The axis that moves most while the flange moves least; of equals the one nearest to the base.
    pub axis: u8,
    /// Smallest singular value of the Jacobian, with lengths in m: the flange's speed, m/s and rad/s taken
    /// together, in its slowest direction at joint speeds of norm 1. Zero at a singularity.
    pub margin: f64,
}

impl Singularity {
    /// More sweeps than a matrix of this size has ever needed; past it the decomposition gives up.
    const MOST_SWEEPS: usize = 200;

    /// That of a Jacobian whose first `axes` columns are a robot's. An arm of fewer than six axes is
    /// measured within the motions it has.
    pub fn of(jacobian: &Jacobian, axes: usize) -> Result<Self, KinematicsError> {
        let decomposed = jacobian
            .try_svd(false, true, f64::EPSILON, Self::MOST_SWEEPS)
            .ok_or(KinematicsError::NotFinite)?;
        let slowest = axes.clamp(1, 6) - 1;
        let motion = decomposed
            .v_t
            .as_ref()
            .map(|rows| rows.row(slowest).abs())
            .ok_or(KinematicsError::NotFinite)?;
        let most = motion.max();
        let axis = motion.iter().position(|&share| share > 0.9 * most);
        Ok(Self {
            axis: axis.unwrap_or(0) as u8,
            margin: decomposed.singular_values[slowest],
        })
    }
}
