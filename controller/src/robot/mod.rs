//! Robots: where the flange is for given joints, which joints put it there, and where the motors are.
//!
//! [`Robot`] is the contract; [`Irb6`] (5 axes), [`Irp6`] (6), [`Irp6Track`] and [`Polycrank`] (7), and [`Rnt`] (6,
//! serial-parallel) keep it, and so do two devices of one axis, [`Gripper`] and [`Conveyor`]. Every call is a function
//! of its arguments: no state, no allocation, no search without a bound. What a robot cannot do is a
//! [`KinematicsError`] that names the axis and both sides, never a NaN or a clamped number.
//!
//! Frames are named as `base_from_flange`. The **base** frame stands on axis 1, z up, its origin at
//! the shoulder axis unless the parameters raise the shoulder above it; the **flange** is the last
//! frame of the arm. Tools belong to the caller: `base_from_tool = base_from_flange * flange_from_tool`
//! on the way out, and `base_from_tool * flange_from_tool.inverse()` is what [`Robot::inverse`] takes.
//!
//! Where each robot lives:
//!
//! | robot | type | file | what is its own |
//! |---|---|---|---|
//! | ASEA IRb-6 | [`Irb6`] | `irb6.rs` | five axes: poses whose tool axis lies in the arm's plane |
//! | WUT IRp-6 | [`Irp6`] | `irp6.rs` | the hand axis; one branch within the limits |
//! | IRp-6 on its track | [`Irp6Track`] | `irp6_track.rs` | where the carriage stands |
//! | Polycrank | [`Polycrank`] | `polycrank.rs`, `polycrank/cranks.rs` | joints without end, the forearm's reach |
//! | RNT | [`Rnt`] | `rnt.rs`, `legs.rs` | legs that close, by Newton's method, and a wrist |
//! | gripper, conveyor | [`Gripper`], [`Conveyor`] | `axis_map.rs` | one motor each |
//!
//! What they share: `arm.rs` is the arm under IRb-6 and IRp-6, `parameters.rs` its numbers and what may be wrong with
//! any; `drive_train.rs` is gears, screws and couplings between motors and joints; `solutions.rs` collects
//! branches within the limits, nearest first; `free_parameter.rs` is how a redundant robot chooses;
//! `links.rs` is a robot link by link, for description files and figures; `singularity.rs` is how near the arm is to
//! losing a direction; `weight.rs` is what links weigh on motors; `tool.rs` is a robot with its tool; `room.rs` is room in a range that ends at home; `vector.rs` is positions, one per axis. Figures and every parameter with its source are in
//! `docs/robots` of the repository. Read [`Robot`] first, then `irp6.rs` for a robot from end to end.
//!
//! Numbers carry the place they come from: *public code* is the published source of the WUT robots'
//! controllers, *derived* follows from those by arithmetic, *nominal* is a plausible figure to be
//! replaced by measurement.

mod arm;
mod axis_map;
mod drive_train;
mod free_parameter;
mod irb6;
mod irp6;
mod irp6_track;
mod legs;
mod links;
mod parameters;
mod polycrank;
mod rnt;
mod room;
mod singularity;
mod solutions;
mod tool;
mod vector;
mod weight;

#[cfg(test)]
mod tests;

use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, SMatrix};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use servo::MAX_AXES;
use thiserror::Error;

pub use axis_map::{Conveyor, ConveyorParameters, Gripper, GripperParameters};
pub use drive_train::{GearAxis, ScrewAxis};
pub use irb6::{Irb6, Irb6Parameters};
pub use irp6::{Irp6, Irp6Parameters};
pub use irp6_track::{Irp6Track, Irp6TrackParameters};
pub use links::{Link, LinkKind, Links};
pub use parameters::{ArmParameters, ParameterError};
pub use polycrank::{Polycrank, PolycrankParameters};
pub use rnt::{LegAxis, Rnt, RntParameters};
pub use singularity::Singularity;
pub use solutions::Solutions;
pub use tool::{Arm, Axes, Pose};
pub use vector::{Joint, Joints, Motor, Motors, Vector};
pub use weight::{Mass, Weight, WeightError};

/// Velocity of the flange per unit of joint velocity: column i is joint i, columns past the last
/// axis are zero. Rows 0..3 are the linear velocity of the flange origin, m/s; rows 3..6 the angular
/// velocity, rad/s; both in the base frame.
pub type Jacobian = SMatrix<f64, 6, MAX_AXES>;

/// The numbers of one robot.
pub trait RobotParameters: Copy {
    /// Axes of the robot.
    const AXES: usize;

    /// The robot of these numbers, or what is wrong with them.
    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError>;

    /// The same numbers with room at home, in each range that includes the home position. The motors, in the order of
    /// the axes, come to rest up to these distances beside their home positions, rad.
    #[must_use]
    fn with_room_at_home(self, motors: &[f64]) -> Self;

    /// Nominal masses of the links: plausible figures, to be replaced by those of the machine at hand.
    fn masses(&self) -> &'static [Mass] {
        &[]
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
    /// Axes, at most [`MAX_AXES`]; the length of every vector it takes and gives.
    fn axes(&self) -> usize;

    /// Range of each joint, rad (m for a linear joint); [`Limits::CONTINUOUS`] for one that turns without end. The
    /// position of such a joint counts its turns: 0 and 2π are two positions, and an interpolation passes all
    /// positions between them.
    fn joint_limits(&self) -> &[Limits];

    /// Range of each motor, rad.
    fn motor_limits(&self) -> &[Limits];

    /// Motor positions at which homing leaves the counters zero, rad.
    #[doc(alias = "synchro_motor_position")]
    fn home(&self) -> Motors;

    /// `base_from_flange` at these joints. Looks at no limit: it serves measured joints as well.
    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError>;

    /// The joints that put the flange there, within every joint and motor limit.
    ///
    /// `near` is the present posture. Solutions come nearest first. A joint of more than one turn is returned in the
    /// turn nearest to `near`, and a redundant robot takes its free parameter from `near`. Where the pose leaves an
    /// axis open (a wrist singularity), the value of `near` is kept if the robot says so, otherwise the answer is
    /// [`KinematicsError::Singular`]. Where branches exist but none within limits, [`KinematicsError::BeyondLimit`]
    /// tells of the one nearest to `near`.
    fn inverse(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &Joints,
    ) -> Result<Solutions, KinematicsError>;

    /// Motor positions for these joints, both within their limits: the gate of everything commanded.
    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError>;

    /// Joints for these motor positions. Looks at no limit but what the mechanism cannot assume at
    /// all: it serves measured positions as well.
    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError>;

    /// The Jacobian at these joints.
    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError>;

    /// How near these joints are to a singularity.
    fn singularity(&self, joints: &Joints) -> Result<Singularity, KinematicsError> {
        Singularity::of(&self.jacobian(joints)?, self.axes())
    }

    /// The arm link by link, for description files and figures; `None` where it is no serial chain.
    fn links(&self) -> Option<Links> {
        None
    }
}

/// A closed range of positions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// The lowest position allowed.
    pub low: f64,
    /// The highest position allowed.
    pub high: f64,
}

impl Limits {
    /// What rounding may add to a position that stands exactly on its limit.
    const SLACK: f64 = 1e-9;

    /// No limit at all: a joint that turns without end.
    pub const CONTINUOUS: Self = Self {
        low: f64::NEG_INFINITY,
        high: f64::INFINITY,
    };

    /// Whether there is no limit on either side.
    pub const fn is_continuous(&self) -> bool {
        self.low == f64::NEG_INFINITY && self.high == f64::INFINITY
    }

    /// The limit that `position` is beyond; a NaN is beyond the lower one.
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

/// Which of an axis's two positions is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// The joint.
    Joint,
    /// The motor shaft.
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

/// Why a robot has no answer. Axes are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum KinematicsError {
    /// A NaN or an infinity was given.
    #[error("a number is not finite")]
    NotFinite,
    /// A vector of another robot.
    #[error("{given} positions for a robot of {axes} axes")]
    AxisCount {
        /// Axes of the robot.
        axes: u8,
        /// Positions given.
        given: u8,
    },
    /// The arm is too short, or too long to fold that far.
    #[error("{margin:.6} m out of reach")]
    Unreachable {
        /// What is missing on the branch that misses least, m.
        margin: f64,
    },
    /// The pose leaves an axis undetermined.
    #[error("axis {axis} is undetermined {margin:.1e} from a singular pose")]
    Singular {
        /// The axis.
        axis: u8,
        /// Distance from the singular pose: of the flange from the axis, m, or the sine of the angle between the two
        /// axes.
        margin: f64,
    },
    /// Legs that cannot have these lengths together. Legs are counted from 0.
    #[error("the legs do not close: leg {leg} misses its length by {residual:.6} m at the least")]
    Open {
        /// The leg that misses most.
        leg: u8,
        /// The length asked for less that of the closest posture found, m.
        residual: f64,
    },
    /// A leg would pass its limit. Legs are counted from 0.
    #[error("leg {leg} at {length:.6} m is beyond its limit {limit:.6} m")]
    LegLimit {
        /// The leg, which has the motor of the same number.
        leg: u8,
        /// The length asked for, m.
        length: f64,
        /// The limit it passes, m.
        limit: f64,
    },
    /// A joint or a motor would pass its limit.
    #[error("axis {axis}: {space} at {value:.6} is beyond its limit {limit:.6}")]
    BeyondLimit {
        /// Whether joint or motor.
        space: Space,
        /// The axis.
        axis: u8,
        /// The position asked for, rad (m for a linear joint).
        value: f64,
        /// The limit it passes.
        limit: f64,
    },
    /// The pose is beside the only way that a device of one axis has.
    #[error("{distance:.6} m and {angle:.6} rad off the only axis")]
    OffAxis {
        /// Distance from the axis, m.
        distance: f64,
        /// Angle by which the pose is turned, rad.
        angle: f64,
    },
    /// The tool axis is outside the vertical plane of a 5-axis arm.
    #[error("tool axis leans {residual:.3e} out of the arm's plane")]
    ToolPlane {
        /// Sine of the angle between tool axis and plane, signed by the normal (-sin th1, cos th1, 0).
        residual: f64,
    },
}

impl KinematicsError {
    /// The axis it is about.
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
            | Self::ToolPlane { .. } => None,
        }
    }
}
