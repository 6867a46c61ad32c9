//! Serial links of a robot, for its description.

use std::borrow::Cow;

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use servo::MAX_AXES;

use super::{Joints, Limits};

/// Motion of a link relative to the previous link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// Rotation between limits.
    Revolute,
    /// Endless rotation.
    Continuous,
    /// Translation along the axis.
    Prismatic,
}

/// One link of a serial arm and its joint, as in robot description formats.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Name of the joint.
    pub name: Cow<'static, str>,
    /// Kind of motion.
    pub kind: LinkKind,
    /// Pose of the link's frame in the frame of the previous link (of the base, for the first link) with the joint at
    /// zero.
    pub parent_from_link: Isometry3<f64>,
    /// Axis of rotation or translation, in the link's own frame.
    pub axis: Unit<Vector3<f64>>,
    /// Position relative to the previous link, rad or m, as a weighted sum of the robot's joints: the weights. If the
    /// drives set absolute angles, the sum is a difference.
    pub coupling: [f64; MAX_AXES],
    /// Range of that position, taken alone, within the ranges of the joints in the sum.
    pub limits: Limits,
}

impl Link {
    /// A link that turns about its z axis.
    pub(super) fn turning(
        name: &'static str,
        parent_from_link: Isometry3<f64>,
        coupling: &[(usize, f64)],
        joint_limits: &[Limits],
    ) -> Self {
        let mut factors = [0.0; MAX_AXES];
        let mut limits = Limits::new(0.0, 0.0);
        for &(axis, factor) in coupling {
            factors[axis] = factor;
            let range = joint_limits[axis].map(|end| factor * end);
            limits.low += range.low;
            limits.high += range.high;
        }
        Self {
            name: Cow::Borrowed(name),
            kind: if limits.is_continuous() { LinkKind::Continuous } else { LinkKind::Revolute },
            parent_from_link,
            axis: Vector3::z_axis(),
            coupling: factors,
            limits,
        }
    }

    /// Pose of the link's frame in the frame of the previous link, at these joints of the robot.
    pub fn placed(&self, joints: &Joints) -> Isometry3<f64> {
        let position: f64 = joints.iter().zip(self.coupling).map(|(q, k)| k * q).sum();
        let moved = match self.kind {
            LinkKind::Revolute | LinkKind::Continuous => {
                Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&self.axis, position))
            }
            LinkKind::Prismatic => Translation3::from(self.axis.scale(position)).into(),
        };
        self.parent_from_link * moved
    }
}
