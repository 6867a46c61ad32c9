//! Robots: forward kinematics, inverse kinematics and drive trains.
//!
//! [`Robot`] is the contract. Its robots are [`Irb6`] (5 axes), [`Irp6`] (6), [`Irp6Track`] and [`Polycrank`] (7),
//! and [`Rnt`] (6, serial-parallel). [`Chain`] is any serial arm of 1 to 8 axes, from a description of its joints.
//! [`LinearDevice`] is a gripper or a conveyor, of one axis, with the same contract.
//! Every call is a function of its arguments: no state, no allocation, no unbounded search. A call that a robot
//! cannot fulfil returns a [`KinematicsError`] with the axis and both sides, never a NaN or a clamped number.
//!
//! Frames are named as `base_from_flange`. The **base** frame stands on axis 1 with z up. Its origin is at the
//! shoulder axis, unless the parameters raise the shoulder above the origin. The **flange** is the last frame of the
//! arm. Tools belong to the caller. Forward: `base_from_tool = base_from_flange * flange_from_tool`. Inverse:
//! [`Robot::inverse`] takes `base_from_tool * flange_from_tool.inverse()`.
//!
//! Files of the robots:
//!
//! | robot | type | file | special features |
//! |---|---|---|---|
//! | ASEA IRb-6 | [`Irb6`] | `irb6.rs` | five axes: poses whose tool axis lies in the arm's plane |
//! | WUT IRp-6 | [`Irp6`] | `irp6.rs` | the hand axis; one branch within the limits |
//! | IRp-6 on its track | [`Irp6Track`] | `irp6_track.rs` | the choice of the carriage position |
//! | Polycrank | [`Polycrank`] | `polycrank.rs`, `polycrank/cranks.rs` | endless joints, the forearm's reach |
//! | RNT | [`Rnt`] | `rnt.rs`, `legs.rs` | closed loops of legs, by Newton's method, and a wrist |
//! | any serial arm | [`Chain`] | `chain` | joints as in URDF, closed forms found from the numbers, a numerical solver |
//! | gripper, conveyor | [`LinearDevice`] | `axis_map.rs` | one motor each |
//!
//! Figures and every parameter with its source are in `docs/robots` of the repository. Read [`Robot`] first, then
//! `irp6.rs` as a complete example of a robot.
//!
//! Parameters are marked with their sources. *Public code* is the published source of the WUT robots' controllers.
//! *Derived* values follow from public code by arithmetic. *Nominal* values are plausible figures to be replaced by
//! measurement.

mod arm;
mod axis_map;
mod chain;
mod drive_train;
mod free_parameter;
mod irb6;
mod irp6;
mod irp6_track;
mod legs;
mod links;
mod parameters;
mod polycrank;
mod rating;
mod rnt;
mod room;
mod singularity;
mod solutions;
mod tool;
mod vector;
mod weight;

#[cfg(test)]
mod tests;

use std::{fmt, sync::Arc};

use can::counted;
use nalgebra::{Isometry3, SMatrix};
use serde::{Deserialize, Serialize};
use servo::MAX_AXES;
use thiserror::Error;

pub use axis_map::{ConveyorParameters, GripperParameters, LinearDevice};
pub use chain::{Chain, ChainError, ChainJoint, ChainParameters, ClosedForm, LinkBody};
pub use drive_train::{GearAxis, ScrewAxis};
pub use irb6::{Irb6, Irb6Parameters};
pub use irp6::{Irp6, Irp6Parameters};
pub use irp6_track::{Irp6Track, Irp6TrackParameters};
pub use links::{Link, LinkKind};
pub use parameters::{ArmParameters, ParameterError};
pub use polycrank::{Polycrank, PolycrankParameters};
pub use rating::MotorRating;
pub use rnt::{LegAxis, Rnt, RntParameters};
pub use singularity::Singularity;
pub use solutions::Solutions;
pub use tool::{Arm, Axes, Pose};
pub use vector::{Joint, Joints, Motor, Motors, Vector};
pub use weight::{Mass, Weight, WeightError};

/// Velocity of the flange per unit of joint velocity. Column i belongs to joint i. Columns beyond the last axis are
/// zero. Rows 0..3 are the linear velocity of the flange origin, m/s. Rows 3..6 are the angular velocity, rad/s. Both
/// are in the base frame.
pub type Jacobian = SMatrix<f64, 6, MAX_AXES>;

/// Half of the interval of a difference of poses, rad or m of a joint.
const DIFFERENCE: f64 = 1e-5;

/// The numbers of one robot.
pub trait RobotParameters: Clone {
    /// Number of axes of the robot.
    fn axes(&self) -> usize;

    /// The robot of these numbers, or what is wrong with them.
    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError>;

    /// The same numbers with room at home, in each range that includes the home position. The motors, in the order of
    /// the axes, come to rest up to these distances beside their home positions, rad.
    ///
    /// The default does not change the ranges, for a robot whose ranges extend to both sides of home.
    #[must_use]
    fn with_room_at_home(self, _motors: &[f64]) -> Self {
        self
    }

    /// Nominal masses of the links: plausible figures, to be replaced by those of the machine at hand.
    fn masses(&self) -> Vec<Mass> {
        Vec::new()
    }

    /// Nominal ratings of the motors, in the order of the axes. A robot without links needs none.
    fn motors(&self) -> Vec<MotorRating> {
        Vec::new()
    }

    /// The direction against gravity in the base frame.
    fn up(&self) -> [f64; 3] {
        [0.0, 0.0, 1.0]
    }
}

/// One robot: its geometry, its drive train, its limits.
///
/// Every method refuses vectors of another length ([`KinematicsError::AxisCount`]) and numbers that
/// are not finite ([`KinematicsError::NotFinite`]).
pub trait Robot: fmt::Debug + Send + Sync {
    /// Number of axes, at most [`MAX_AXES`]. All vectors of the robot have this length.
    fn axes(&self) -> usize {
        self.joint_limits().len()
    }

    /// Range of each joint, rad (m for a linear joint). [`Limits::CONTINUOUS`] marks an endless joint. The position
    /// of an endless joint counts its turns: 0 and 2π are two positions, and an interpolation passes all positions
    /// between them.
    fn joint_limits(&self) -> &[Limits];

    /// Range of each motor, rad.
    fn motor_limits(&self) -> &[Limits];

    /// Motor positions at which homing leaves the counters zero, rad.
    #[doc(alias = "synchro_motor_position")]
    fn home(&self) -> Motors;

    /// `base_from_flange` at these joints. No limit is checked, so that measured joints can be used.
    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError>;

    /// The joints that bring the flange to the pose, within all joint and motor limits.
    ///
    /// `near` is the present posture. Solutions come nearest first. A joint with a range above one turn is returned
    /// in the turn nearest to `near`. A redundant robot takes its free parameter from `near`.
    ///
    /// At a wrist singularity the pose leaves an axis open. Some robots then keep the value of `near`, and say so.
    /// The other robots return [`KinematicsError::Singular`]. If branches exist but none lies within the limits,
    /// [`KinematicsError::BeyondLimit`] describes the branch nearest to `near`.
    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError>;

    /// Motor positions for these joints, both within their limits. Every commanded position passes this check.
    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError>;

    /// Joints for these motor positions. Only positions that the mechanism cannot take are refused. No other limit is
    /// checked, so that measured positions can be converted.
    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError>;

    /// The Jacobian at these joints. By default, it is computed from differences of [`Robot::forward`], with an error
    /// of about 1e-9 for links of 1 m. The neighbouring poses must then exist as well.
    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let mut jacobian = Jacobian::zeros();
        for axis in 0..self.axes() {
            let moved = |by: f64| {
                let mut moved = *joints;
                moved[axis] += by;
                self.forward(&moved)
            };
            let (low, high) = (moved(-DIFFERENCE)?, moved(DIFFERENCE)?);
            let velocity = (high.translation.vector - low.translation.vector) / (2.0 * DIFFERENCE);
            let spin = (high.rotation * low.rotation.inverse()).scaled_axis() / (2.0 * DIFFERENCE);
            jacobian.fixed_view_mut::<3, 1>(0, axis).copy_from(&velocity);
            jacobian.fixed_view_mut::<3, 1>(3, axis).copy_from(&spin);
        }
        Ok(jacobian)
    }

    /// Distance of these joints from a singularity.
    fn singularity(&self, joints: &Joints) -> Result<Singularity, KinematicsError> {
        Singularity::of(&self.jacobian(joints)?, self.axes())
    }

    /// The links of a serial arm from base to flange, one per axis, for description files and figures; none if the robot
    /// is no such chain. The product of the links, each [placed](Link::placed), and of
    /// [`link_from_flange`](Self::link_from_flange) equals [`forward`](Self::forward).
    fn links(&self) -> Vec<Link> {
        Vec::new()
    }

    /// Pose of the flange in the frame of the last link. The identity by default; the description of a [`Chain`] can
    /// state another pose.
    fn link_from_flange(&self) -> Pose {
        Pose::identity()
    }

    /// Index of the lower arm's joint, if the joints of lower arm, upper arm and wrist pitch follow each other and are
    /// inclinations to the horizontal, as those of the IRp-6. `None` for any other robot.
    fn lower_arm(&self) -> Option<usize> {
        None
    }
}

/// A closed range of positions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// The lowest position allowed.
    pub low: f64,
    /// The highest position allowed.
    pub high: f64,
}

impl Limits {
    /// Tolerance for rounding errors of a position exactly at its limit.
    const SLACK: f64 = 1e-9;

    /// No limit: an endless joint.
    pub const CONTINUOUS: Self = Self::new(f64::NEG_INFINITY, f64::INFINITY);

    const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// The range of a monotonic function over this range.
    fn map(self, function: impl Fn(f64) -> f64) -> Self {
        let [a, b] = [self.low, self.high].map(function);
        Self::new(a.min(b), a.max(b))
    }

    /// The positions that both ranges include.
    fn within(self, other: Self) -> Self {
        Self::new(self.low.max(other.low), self.high.min(other.high))
    }

    /// Whether neither side has a limit.
    pub const fn is_continuous(&self) -> bool {
        self.low == f64::NEG_INFINITY && self.high == f64::INFINITY
    }

    /// Refuses a position of axis `axis` beyond its limit.
    pub fn check(&self, space: Space, axis: usize, position: f64) -> Result<(), KinematicsError> {
        match self.exceeded_by(position) {
            Some(limit) => Err(KinematicsError::BeyondLimit { space, axis: axis as u8, value: position, limit }),
            None => Ok(()),
        }
    }

    /// The limit that `position` exceeds. A NaN exceeds the lower limit.
    pub fn exceeded_by(&self, position: f64) -> Option<f64> {
        if position > self.high + Self::SLACK {
            Some(self.high)
        } else if position >= self.low - Self::SLACK {
            None
        } else {
            Some(self.low)
        }
    }
}

/// The two positions of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// Position of the joint.
    Joint,
    /// Position of the motor shaft.
    Motor,
}

impl fmt::Display for Space {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Joint => "joint",
            Self::Motor => "motor",
        })
    }
}

/// Reasons why a robot has no answer. Axes are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum KinematicsError {
    /// A NaN or an infinity was passed.
    #[error("a number is not finite")]
    NotFinite,
    /// A vector has the length of another robot.
    #[error("{} for a robot of {}", counted(*.given, "position"), counted(*.axes, "axis"))]
    AxisCount { axes: u8, given: u8 },
    /// The pose is too far away for the arm, or too near. `margin` is the missing distance in the best branch.
    #[error("pose is {margin:.6} m out of reach of the arm")]
    Unreachable { margin: f64 },
    /// The pose leaves an axis undetermined. `margin` is the distance of the flange from the axis, m, or the sine of
    /// the angle between the two axes.
    #[error("axis {axis} is undetermined {margin:.1e} from a singular pose: take a pose beside it, or joints")]
    Singular { axis: u8, margin: f64 },
    /// The legs cannot have these lengths at the same time. Legs are counted from 0. `residual` is the requested length
    /// minus the length in the closest posture found.
    #[error("the legs do not close: leg {leg} misses its length by {residual:.6} m at the least")]
    Open { leg: u8, residual: f64 },
    /// A leg would exceed its limit. Legs are counted from 0, like their motors.
    #[error("leg {leg} at {length:.6} m is beyond its limit {limit:.6} m")]
    LegLimit { leg: u8, length: f64, limit: f64 },
    /// A joint or a motor would exceed its limit. Positions are in rad (m for a linear joint).
    #[error("axis {axis}: {space} at {value:.6} is beyond its limit {limit:.6} (rad, or m of a linear joint)")]
    BeyondLimit { space: Space, axis: u8, value: f64, limit: f64 },
    /// The pose lies beside the path of a device with one axis.
    #[error("{distance:.6} m and {angle:.6} rad off the only axis")]
    OffAxis { distance: f64, angle: f64 },
    /// No posture was found that brings the flange to the pose. `distance` and `angle` are the errors of the nearest
    /// posture.
    #[error("the arm misses the pose by {distance:.6} m and {angle:.6} rad at the least")]
    Missed { distance: f64, angle: f64 },
    /// The tool axis lies outside the vertical plane of a 5-axis arm. `residual` is the sine of the angle between them,
    /// with the sign of the normal (-sin th1, cos th1, 0).
    #[error(
        "tool axis leans {residual:.3e} rad out of the arm's plane: its azimuth must be that of the position, atan2(y, x)"
    )]
    ToolPlane { residual: f64 },
}

impl KinematicsError {
    /// The axis of the error.
    pub fn axis(&self) -> Option<usize> {
        match *self {
            Self::Singular { axis, .. }
            | Self::Open { leg: axis, .. }
            | Self::LegLimit { leg: axis, .. }
            | Self::BeyondLimit { axis, .. } => Some(usize::from(axis)),
            Self::NotFinite
            | Self::AxisCount { .. }
            | Self::Unreachable { .. }
            | Self::OffAxis { .. }
            | Self::Missed { .. }
            | Self::ToolPlane { .. } => None,
        }
    }
}
