use thiserror::Error;

use super::{Axes, Pose};

/// What generators and the effector control process need of a robot's kinematics and drive train.
pub trait Arm {
    /// How many axes it has.
    fn axes(&self) -> usize;
    /// Base from tool, at these joint positions.
    fn forward(&self, joints: &Axes) -> Result<Pose, ArmError>;
    /// The joint positions within limits that take the tool to `pose`, on the branch next to `near`.
    fn inverse(&self, pose: &Pose, near: &Axes) -> Result<Axes, ArmError>;
    /// Motor positions at these joint positions, both within limits.
    fn motors(&self, joints: &Axes) -> Result<Axes, ArmError>;
    /// Joint positions at these motor positions.
    fn joints(&self, motors: &Axes) -> Result<Axes, ArmError>;
}

/// Why an arm cannot take a pose.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ArmError {
    /// The pose is out of reach.
    #[error("out of reach")]
    OutOfReach,
    /// A joint would pass its limit.
    #[error("axis {axis} at {position:.4} rad passes its limit {limit:.4} rad")]
    JointLimit {
        /// Index of the axis.
        axis: u8,
        /// Where it would have to be.
        position: f64,
        /// The limit.
        limit: f64,
    },
}
