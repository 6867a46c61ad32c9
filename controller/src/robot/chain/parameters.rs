//! Numbers of a serial arm that is described by its joints, and the refusal of invalid numbers.

use nalgebra::{DMatrix, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use servo::MAX_AXES;
use thiserror::Error;

use super::super::{Limits, LinkKind, Mass, Pose, WeightError, room};

/// Largest coordinate of a frame in the previous frame, m.
const FARTHEST: f64 = 1000.0;

/// Shortest axis and upward direction before they are normalised.
const SHORTEST: f64 = 1e-6;

/// Largest deviation of a quaternion's length from 1.
const UNIT: f64 = 1e-6;

/// Largest deviation of a coupling matrix times its inverse from the identity.
const INVERTED: f64 = 1e-9;

/// Numbers of a serial arm: its joints from base to flange, in the words of URDF.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ChainParameters {
    /// The joints from base to flange: 1 to 8.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 8)))]
    pub joints: Vec<ChainJoint>,
    /// Pose of the flange in the frame of the last link, lengths in m.
    #[serde(default = "Pose::identity", with = "placement")]
    #[cfg_attr(feature = "schema", schemars(with = "placement::Placement"))]
    pub link_from_flange: Pose,
    /// Direction against gravity in the base frame, of any length.
    #[serde(default = "vertical")]
    pub up: [f64; 3],
    /// Motor positions per joint position, row by row, rad/rad (rad/m for a linear joint): for belts and differential
    /// wrists. Without a matrix each motor moves its own joint by the `ratio` of that joint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motors_from_joints: Option<Vec<Vec<f64>>>,
    /// A direction in the flange frame about which the tool may turn freely, of any length: the axis of a torch or a
    /// pen. Inverse kinematics then brings this direction, and not the whole orientation, to that of the pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub free_axis: Option<[f64; 3]>,
}

/// One joint, with the link behind the joint. The link's frame is the joint's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ChainJoint {
    /// Name of the joint, unique in the arm.
    pub name: String,
    /// Kind of motion.
    pub kind: LinkKind,
    /// Pose of the joint's frame in the frame of the previous link (of the base, for the first joint) with the joint at
    /// zero, lengths in m: `<origin>` of URDF.
    #[serde(default = "Pose::identity", with = "placement")]
    #[cfg_attr(feature = "schema", schemars(with = "placement::Placement"))]
    pub parent_from_joint: Pose,
    /// Axis of rotation or translation in the joint's frame, of any length: `<axis>` of URDF.
    pub axis: [f64; 3],
    /// Range of the joint, rad (m for a linear joint). A continuous joint has none.
    #[serde(default = "continuous")]
    pub limits: Limits,
    /// Greatest velocity of the joint, rad/s (m/s for a linear joint), if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity: Option<f64>,
    /// Greatest effort of the joint, N·m (N for a linear joint), if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effort: Option<f64>,
    /// Motor angle per joint angle (per metre for a linear joint), negative if they turn in opposite directions. A
    /// coupling matrix takes its place.
    pub ratio: f64,
    /// Joint position at home, rad (m for a linear joint).
    #[serde(default)]
    pub joint_at_home: f64,
    /// Motor position at home, rad.
    #[serde(default)]
    pub motor_at_home: f64,
    /// Mass and inertia of the link, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<LinkBody>,
}

/// Mass and inertia of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LinkBody {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the link's frame, m.
    pub centre: [f64; 3],
    /// Moments of inertia about the centre of mass, along the axes of the link's frame, kg·m²: xx, yy, zz, xy, xz, yz.
    /// The last three are elements of the matrix, as in URDF.
    pub inertia: [f64; 6],
}

/// Reasons why a description is no arm. Joints are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum ChainError {
    /// The number of joints.
    #[error("{given} joints, must be 1 to {MAX_AXES}")]
    JointCount { given: usize },
    /// The name is empty.
    #[error("joint {joint} has no name")]
    NoName { joint: u8 },
    /// Two joints have one name.
    #[error("joint {joint} has the name of joint {other}")]
    SameName { joint: u8, other: u8 },
    /// A NaN or an infinity.
    #[error("{number} of joint {joint} is not finite")]
    NotFinite { joint: u8, number: &'static str },
    /// A coordinate of a frame, m.
    #[error("the frame of joint {joint} is {coordinate} m from the previous frame, more than {FARTHEST} m")]
    TooFar { joint: u8, coordinate: f64 },
    /// A vector without length.
    #[error("the axis of joint {joint} has no direction")]
    NoAxis { joint: u8 },
    /// The lower limit is not below the upper limit.
    #[error("joint {joint} has limits {low} .. {high}: the first must be below the second")]
    EmptyRange { joint: u8, low: f64, high: f64 },
    /// The motor does not move the joint.
    #[error("joint {joint} has a ratio of zero")]
    NoRatio { joint: u8 },
    /// A velocity or an effort. Where the value is unknown, the key is left out.
    #[error("{number} of joint {joint} is {value}, not above zero: leave it out where it is unknown")]
    NotPositive { joint: u8, number: &'static str, value: f64 },
    /// A mass or its centre.
    #[error("the link of joint {joint}: {error}")]
    Mass { joint: u8, error: WeightError },
    /// No body has these moments of inertia: they are not positive semi-definite.
    #[error("the inertia of joint {joint} is that of no body: a moment of inertia is below zero about some axis")]
    Inertia { joint: u8 },
    /// The flange, counted as the joint after the last.
    #[error("the pose of the flange is not finite, or more than {FARTHEST} m from the last link")]
    Flange,
    /// The upward direction.
    #[error("up has no direction")]
    NoUp,
    /// The free axis of the tool.
    #[error("free_axis has no direction")]
    NoFreeAxis,
    /// The number of rows of the coupling matrix.
    #[error("motors_from_joints has {rows} rows for {joints} joints")]
    RowCount { rows: usize, joints: usize },
    /// The length of a row of the coupling matrix.
    #[error("motors_from_joints has {columns} numbers in row {row} for {joints} joints")]
    RowLength { row: usize, columns: usize, joints: usize },
    /// A number of the coupling matrix.
    #[error("motors_from_joints has a number in row {row} that is not finite")]
    MatrixNotFinite { row: usize },
    /// The motors do not determine the joints.
    #[error("motors_from_joints has no inverse: the motors do not determine the joints")]
    NotInvertible,
}

impl ChainParameters {
    /// Masses of the links in the order of the joints, or `None` if the mass of any link is unknown.
    pub fn known_masses(&self) -> Option<Vec<Mass>> {
        let mass = |joint: &ChainJoint| joint.body.map(|body| Mass { mass: body.mass, centre: body.centre });
        self.joints.iter().map(mass).collect()
    }

    /// The same numbers with room at home, in each joint range that includes the home position. The motors, in the
    /// order of the axes, come to rest up to these distances beside their home positions, rad.
    pub(super) fn roomy(mut self, motors: &[f64]) -> Self {
        let Ok(matrix) = self.check() else {
            return self;
        };
        let count = self.joints.len();
        let inverse = matrix.try_inverse().expect("the check inverts the matrix");
        for (axis, joint) in self.joints.iter_mut().enumerate() {
            let by: f64 = (0..count).map(|motor| inverse[(axis, motor)].abs() * room::room(motors, motor)).sum();
            joint.limits = joint.limits.with_room(joint.joint_at_home, by);
        }
        self
    }

    /// Refuses numbers that are no arm. Returns the matrix of motor positions per joint position.
    pub(super) fn check(&self) -> Result<DMatrix<f64>, ChainError> {
        let given = self.joints.len();
        if !(1..=MAX_AXES).contains(&given) {
            return Err(ChainError::JointCount { given });
        }
        for (index, joint) in self.joints.iter().enumerate() {
            joint.check(index as u8)?;
            if let Some(other) = self.joints[..index].iter().position(|other| other.name == joint.name) {
                return Err(ChainError::SameName { joint: index as u8, other: other as u8 });
            }
        }
        if farthest(&self.link_from_flange).is_none_or(|coordinate| coordinate > FARTHEST) {
            return Err(ChainError::Flange);
        }
        direction(self.up).ok_or(ChainError::NoUp)?;
        if let Some(axis) = self.free_axis {
            direction(axis).ok_or(ChainError::NoFreeAxis)?;
        }
        self.matrix()
    }

    fn matrix(&self) -> Result<DMatrix<f64>, ChainError> {
        let joints = self.joints.len();
        let Some(rows) = &self.motors_from_joints else {
            return Ok(DMatrix::from_fn(
                joints,
                joints,
                |row, column| {
                    if row == column { self.joints[row].ratio } else { 0.0 }
                },
            ));
        };
        if rows.len() != joints {
            return Err(ChainError::RowCount { rows: rows.len(), joints });
        }
        if let Some(row) = rows.iter().position(|row| row.len() != joints) {
            return Err(ChainError::RowLength { row, columns: rows[row].len(), joints });
        }
        if let Some(row) = rows.iter().position(|row| !row.iter().all(|number| number.is_finite())) {
            return Err(ChainError::MatrixNotFinite { row });
        }
        let matrix = DMatrix::from_fn(joints, joints, |row, column| rows[row][column]);
        let inverse = matrix.clone().try_inverse().ok_or(ChainError::NotInvertible)?;
        let residual = (&inverse * &matrix - DMatrix::identity(joints, joints)).amax();
        // A NaN is no small residual.
        if residual < INVERTED { Ok(matrix) } else { Err(ChainError::NotInvertible) }
    }
}

impl ChainJoint {
    fn check(&self, joint: u8) -> Result<(), ChainError> {
        if self.name.is_empty() {
            return Err(ChainError::NoName { joint });
        }
        let endless = self.kind == LinkKind::Continuous;
        let Limits { low, high } = if endless { Limits::new(0.0, 1.0) } else { self.limits };
        for (number, value) in [
            ("the lower limit", low),
            ("the upper limit", high),
            ("the ratio", self.ratio),
            ("joint_at_home", self.joint_at_home),
            ("motor_at_home", self.motor_at_home),
        ] {
            if !value.is_finite() {
                return Err(ChainError::NotFinite { joint, number });
            }
        }
        let frame = ChainError::NotFinite { joint, number: "parent_from_joint" };
        let coordinate = farthest(&self.parent_from_joint).ok_or(frame)?;
        if coordinate > FARTHEST {
            return Err(ChainError::TooFar { joint, coordinate });
        }
        direction(self.axis).ok_or(ChainError::NoAxis { joint })?;
        if low >= high {
            return Err(ChainError::EmptyRange { joint, low, high });
        }
        if self.ratio == 0.0 {
            return Err(ChainError::NoRatio { joint });
        }
        for (number, value) in [("velocity", self.velocity), ("effort", self.effort)] {
            match value {
                Some(value) if !value.is_finite() => return Err(ChainError::NotFinite { joint, number }),
                Some(value) if value <= 0.0 => return Err(ChainError::NotPositive { joint, number, value }),
                _ => {}
            }
        }
        self.body.map_or(Ok(()), |body| body.check(joint))
    }
}

impl LinkBody {
    /// The matrix of inertia about the centre of mass, kg·m².
    fn matrix(&self) -> nalgebra::Matrix3<f64> {
        let [xx, yy, zz, xy, xz, yz] = self.inertia;
        nalgebra::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    fn check(&self, joint: u8) -> Result<(), ChainError> {
        let Self { mass, centre, inertia } = *self;
        let link = usize::from(joint);
        if !(0.0..=Mass::MOST).contains(&mass) {
            return Err(ChainError::Mass { joint, error: WeightError::Mass { link, mass } });
        }
        let near = |coordinate: &f64| coordinate.abs() <= Mass::FARTHEST;
        if let Some(coordinate) = centre.into_iter().find(|coordinate| !near(coordinate)) {
            return Err(ChainError::Mass { joint, error: WeightError::Centre { link, coordinate } });
        }
        if !inertia.iter().all(|number| number.is_finite()) {
            return Err(ChainError::NotFinite { joint, number: "inertia" });
        }
        let moments = self.matrix().symmetric_eigenvalues();
        let slack = 1e-9 * moments.amax();
        if moments.min() < -slack {
            return Err(ChainError::Inertia { joint });
        }
        Ok(())
    }
}

/// The unit vector of a direction, or `None` for a vector without a direction.
pub(super) fn direction(vector: [f64; 3]) -> Option<Vector3<f64>> {
    let vector = Vector3::from(vector);
    let length = vector.norm();
    (length.is_finite() && length > SHORTEST).then(|| vector / length)
}

/// Largest coordinate of a pose, m, or `None` if a number of the pose is not finite.
fn farthest(pose: &Pose) -> Option<f64> {
    let finite = |value: &f64| value.is_finite();
    let (position, rotation) = (&pose.translation.vector, &pose.rotation.coords);
    (position.iter().all(finite) && rotation.iter().all(finite)).then(|| position.amax())
}

const fn vertical() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

const fn continuous() -> Limits {
    Limits::CONTINUOUS
}

/// A pose as position and quaternion, like other poses of a cell file.
mod placement {
    use serde::{Deserializer, Serializer, de::Error as _};

    use super::{Deserialize, Pose, Quaternion, Serialize, Translation3, UNIT, UnitQuaternion};

    /// Pose of a frame in the previous frame.
    #[derive(Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[serde(deny_unknown_fields)]
    pub(super) struct Placement {
        /// Position, m: x, y, z.
        #[serde(default)]
        position: [f64; 3],
        /// Rotation as a unit quaternion: w, x, y, z.
        #[serde(default = "unturned")]
        quaternion: [f64; 4],
    }

    const fn unturned() -> [f64; 4] {
        [1.0, 0.0, 0.0, 0.0]
    }

    pub(super) fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
        let rotation = pose.rotation.quaternion();
        let quaternion = [rotation.w, rotation.i, rotation.j, rotation.k];
        Placement { position: pose.translation.vector.into(), quaternion }.serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
        let Placement { position, quaternion: [w, x, y, z] } = Placement::deserialize(deserializer)?;
        let rotation = Quaternion::new(w, x, y, z);
        let length = rotation.norm();
        let off = (length - 1.0).abs();
        if off.is_nan() || off > UNIT {
            return Err(D::Error::custom(format_args!(
                "quaternion has the length {length:.3}, must be a unit quaternion"
            )));
        }
        // A pose that was written is read back bit by bit.
        let written = off < 4.0 * f64::EPSILON;
        let rotation =
            if written { UnitQuaternion::new_unchecked(rotation) } else { UnitQuaternion::from_quaternion(rotation) };
        Ok(Pose::from_parts(Translation3::from(position), rotation))
    }
}
