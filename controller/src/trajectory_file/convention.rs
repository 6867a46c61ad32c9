//! The two conventions of the joints in JOINT files of IRp-6 and IRb-6.

use std::f64::consts::FRAC_PI_2;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Axes, Coordinates, MotionType, TrajectoryError, TrajectoryFile};
use crate::robot::{Arm, KinematicsError};

/// Two readings of a joint that differ by at most this are the same, rad.
const SAME: f64 = 1e-9;

/// Meaning of the joints of upper arm and wrist pitch in a JOINT file of IRp-6 or IRb-6.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointConvention {
    /// Inclinations to the horizontal, th3 and th4, as the drives set them: files of MRROC++ up to 8 October 2010, and
    /// the joints of this library.
    Inclination,
    /// Angles to the previous link by Denavit and Hartenberg, q3 = th3 - th2 - π/2 and q4 = th4 - th3: files of MRROC++
    /// since 8 October 2010.
    Relative,
}

impl JointConvention {
    /// Both conventions.
    pub const ALL: [Self; 2] = [Self::Inclination, Self::Relative];

    /// The word of the key `joints`.
    pub const fn keyword(self) -> &'static str {
        match self {
            Self::Inclination => "inclination",
            Self::Relative => "relative",
        }
    }

    /// The convention of a word.
    pub fn of(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|it| it.keyword() == word)
    }

    /// Inclinations of joints of this convention. `lower_arm` is the index of th2.
    pub fn to_inclinations(self, joints: &Axes, lower_arm: usize, motion: MotionType) -> Axes {
        let mut joints = *joints;
        if self == Self::Relative {
            joints[lower_arm + 1] += joints[lower_arm] + right_angle(motion);
            joints[lower_arm + 2] += joints[lower_arm + 1];
        }
        joints
    }

    /// Joints of this convention at these inclinations.
    pub fn of_inclinations(self, inclinations: &Axes, lower_arm: usize, motion: MotionType) -> Axes {
        let mut joints = *inclinations;
        if self == Self::Relative {
            joints[lower_arm + 2] -= joints[lower_arm + 1];
            joints[lower_arm + 1] -= joints[lower_arm] + right_angle(motion);
        }
        joints
    }
}

/// The constant between both conventions; displacements have none.
const fn right_angle(motion: MotionType) -> f64 {
    match motion {
        MotionType::Absolute => FRAC_PI_2,
        MotionType::Relative => 0.0,
    }
}

impl fmt::Display for JointConvention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.keyword())
    }
}

/// The two readings of one pose, by both conventions in the order of [`JointConvention::ALL`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readings {
    /// The pose in whose readings the tool is farthest apart, counted from 1.
    pose: usize,
    /// Whether the poses are displacements, here from the home position.
    motion: MotionType,
    axes: usize,
    readings: [Reading; 2],
}

/// The robot at one reading.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    /// Joints as inclinations, rad or m.
    joints: Axes,
    /// Place of the tool in the base frame, m.
    tool: [f64; 3],
    /// Reason why the robot cannot take the pose.
    refused: Option<KinematicsError>,
}

impl Reading {
    fn of(arm: &Arm, joints: &Axes) -> Result<Self, KinematicsError> {
        let tool = arm.forward(joints)?.translation.vector.into();
        Ok(Self { joints: *joints, tool, refused: arm.motors(joints).err() })
    }
}

impl fmt::Display for Readings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let from = match self.motion {
            MotionType::Absolute => "",
            MotionType::Relative => " from the home position",
        };
        write!(f, "the file does not tell what its joints are, and pose {}{from} has two readings: ", self.pose)?;
        for (convention, Reading { joints, tool: [x, y, z], refused }) in
            JointConvention::ALL.iter().zip(&self.readings)
        {
            let joints: Vec<_> = joints[..self.axes].iter().map(|joint| format!("{joint:.4}")).collect();
            let joints = joints.join(" ");
            write!(f, "joints = \"{convention}\" gives the inclinations {joints}, tool at {x:.4} {y:.4} {z:.4} m")?;
            if let Some(refused) = refused {
                write!(f, " ({refused})")?;
            }
            f.write_str("; ")?;
        }
        f.write_str(
            "files of MRROC++ since 8 October 2010 are relative, earlier files and those taught by mrroc are inclinations",
        )
    }
}

impl TrajectoryFile {
    /// The file with the joints of this arm. `given` is the convention of a JOINT file that does not tell its own.
    /// Files of other coordinates and other robots have no convention and remain as they are.
    ///
    /// Refuses a file without a convention, unless both readings are the same, and a convention that contradicts the
    /// file.
    pub fn for_arm(&self, arm: &Arm, given: Option<JointConvention>) -> Result<Self, TrajectoryError> {
        let Some(lower_arm) = self.lower_arm(arm) else {
            return Ok(self.clone());
        };
        let convention = match (self.joints, given) {
            (Some(told), Some(given)) if told != given => {
                return Err(TrajectoryError::Contradiction { told, given });
            }
            (Some(convention), _) | (None, Some(convention)) => convention,
            (None, None) => match self.readings(arm, lower_arm)? {
                None => JointConvention::Inclination,
                Some(readings) => return Err(TrajectoryError::TwoReadings(Box::new(readings))),
            },
        };
        let mut file = self.clone();
        for pose in &mut file.poses {
            pose.position = convention.to_inclinations(&pose.position, lower_arm, self.motion);
        }
        Ok(Self { joints: Some(JointConvention::Inclination), ..file })
    }

    /// The index of th2 of a file with joints of this arm that have a convention.
    fn lower_arm(&self, arm: &Arm) -> Option<usize> {
        let has_joints = self.coordinates == Coordinates::Joint && self.columns == arm.axes();
        arm.robot().lower_arm().filter(|_| has_joints)
    }

    /// The two readings of the pose at which the tool is farthest apart; `None` if both readings of all poses are the
    /// same.
    fn readings(&self, arm: &Arm, lower_arm: usize) -> Result<Option<Readings>, TrajectoryError> {
        let home = arm.robot().home().padded();
        let start = arm.joints(&home).map_err(|error| TrajectoryError::Pose { pose: 1, error })?;
        let mut at = [start; 2];
        let mut farthest: Option<(f64, Readings)> = None;
        for (pose, number) in self.poses.iter().zip(1..) {
            for (at, convention) in at.iter_mut().zip(JointConvention::ALL) {
                let joints = convention.to_inclinations(&pose.position, lower_arm, self.motion);
                *at = match self.motion {
                    MotionType::Absolute => joints,
                    MotionType::Relative => std::array::from_fn(|axis| at[axis] + joints[axis]),
                };
            }
            if at[0].iter().zip(at[1]).all(|(one, other)| (one - other).abs() <= SAME) {
                continue;
            }
            let of_pose = |error| TrajectoryError::Pose { pose: number, error };
            let [one, other] = at.map(|joints| Reading::of(arm, &joints).map_err(of_pose));
            let readings = [one?, other?];
            let apart = (0..3).map(|it| (readings[0].tool[it] - readings[1].tool[it]).powi(2)).sum();
            if farthest.is_none_or(|(distance, _)| apart > distance) {
                farthest = Some((apart, Readings { pose: number, motion: self.motion, axes: arm.axes(), readings }));
            }
        }
        Ok(farthest.map(|(_, readings)| readings))
    }
}
