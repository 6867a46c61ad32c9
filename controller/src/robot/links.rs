//! Serial links of a robot, for its description.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use servo::MAX_AXES;

use super::{Joints, KinematicsError, Limits};

/// How a link moves against the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkKind {
    /// It turns between limits.
    Revolute,
    /// It turns without end.
    Continuous,
    /// It slides along its axis.
    Prismatic,
}

/// One link of a serial arm and the joint that moves it, as robot description formats have it.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// What the joint is called.
    pub name: &'static str,
    /// How it moves.
    pub kind: LinkKind,
    /// Where the link's frame stands in the frame of the link before it (of the base, for the first) when the
    /// joint is at zero.
    pub parent_from_link: Isometry3<f64>,
    /// The line it turns about or slides along, in its own frame.
    pub axis: Unit<Vector3<f64>>,
    /// Its position against the link before, rad or m, as a sum over the robot's joints: the factor of
    /// each. An arm whose drives set absolute angles has differences here.
    pub coupling: [f64; MAX_AXES],
    /// Range of that position: what the ranges of the joints in the sum leave, taken alone.
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
        let mut limits = Limits {
            low: 0.0,
            high: 0.0,
        };
        for &(axis, factor) in coupling {
            factors[axis] = factor;
            let ends = [joint_limits[axis].low, joint_limits[axis].high].map(|end| factor * end);
            limits.low += ends[0].min(ends[1]);
            limits.high += ends[0].max(ends[1]);
        }
        Self {
            name,
            kind: if limits.is_continuous() {
                LinkKind::Continuous
            } else {
                LinkKind::Revolute
            },
            parent_from_link,
            axis: Vector3::z_axis(),
            coupling: factors,
            limits,
        }
    }

    /// Where the link's frame stands in the frame of the link before it at these joints of the robot.
    pub fn placed(&self, joints: &Joints) -> Isometry3<f64> {
        let position: f64 = joints.iter().zip(self.coupling).map(|(q, k)| k * q).sum();
        let moved = match self.kind {
            LinkKind::Revolute | LinkKind::Continuous => {
                let turn = UnitQuaternion::from_axis_angle(&self.axis, position);
                Isometry3::from_parts(Translation3::identity(), turn)
            }
            LinkKind::Prismatic => Translation3::from(self.axis.scale(position)).into(),
        };
        self.parent_from_link * moved
    }
}

/// The links of a serial arm from base to flange; the last link's frame is the flange.
#[derive(Clone, Debug, PartialEq)]
pub struct Links(pub Vec<Link>);

impl Links {
    /// `base_from_flange`, the product of the links: what [`super::Robot::forward`] gives.
    pub fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        if !joints.iter().all(|joint| joint.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        let links = self.0.iter().map(|link| link.placed(joints));
        Ok(links.fold(Isometry3::identity(), |base, link| base * link))
    }
}
