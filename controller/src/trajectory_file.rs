//! Trajectory files of MRROC++ (`.trj`): poses of a time-synchronised motion as text.
//!
//! ```text
//! JOINT               coordinates: MOTOR, JOINT, XYZ_EULER_ZYZ or XYZ_ANGLE_AXIS
//! 2                   number of poses
//! ABSOLUTE            or RELATIVE: each pose from the pose before
//! 0.1 0.2 0.2         per pose three rows: fractions of the limits of velocity, above 0 and at most 1,
//! 0.1 0.1 0.1         fractions of the limits of acceleration,
//! 0.5 -1.57 0.02      and coordinates, rad or m
//! …
//! ```
//!
//! Each row has one column per axis, separated by spaces, tabs or commas. Empty lines are ignored. [`TrajectoryFile`]
//! reads and writes the format, and makes the [`Newsmooth`] motion of MOTOR and JOINT files.
//!
//! JOINT files of IRp-6 and IRb-6 have joints of one of two [conventions](JointConvention). A line `joints =
//! inclination` or `joints = relative` behind the poses tells which. MRROC++ ignores this line. Files of the format
//! before September 2010 have no line ABSOLUTE or RELATIVE, and their joints are inclinations. The oldest of these
//! files have five rows per pose: velocities at start and end come first, and are not used. [`read`](TrajectoryFile::read)
//! tells by [notes](TrajectoryNote) what it left out.
//!
//! ```
//! use mrroc_controller::trajectory_file::{Coordinates, TrajectoryFile};
//!
//! let file = TrajectoryFile::parse("JOINT\n1\nABSOLUTE\n\n0.1 0.2\n0.1 0.1\n0.5 -1.57\n")?;
//! assert_eq!((file.coordinates(), file.columns()), (Coordinates::Joint, 2));
//! assert_eq!(TrajectoryFile::parse(&file.to_string())?, file);
//! # Ok::<(), mrroc_controller::trajectory_file::TrajectoryFileError>(())
//! ```

mod convention;
mod conversion;
mod reading;
#[cfg(test)]
mod tests;

use std::fmt;

use can::counted;
use servo::MAX_AXES;
use thiserror::Error;

use crate::generator::{Axes, GeneratorError, MotionLimits, Newsmooth, SmoothPose};
use crate::robot::{KinematicsError, Space};

pub use convention::{JointConvention, Readings};
pub use reading::TrajectoryNote;

/// Greatest number of poses of a file.
pub const MOST_POSES: usize = 100_000;

/// Rows of one pose.
const ROWS: [PoseRow; 3] = [PoseRow::Velocities, PoseRow::Accelerations, PoseRow::Coordinates];

/// What the coordinates of the poses are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coordinates {
    /// Motors, rad.
    Motor,
    /// Joints, rad, or m for a linear joint.
    Joint,
    /// Tool in the base frame: x, y, z, m, and Euler angles about z, y, z, rad.
    XyzEulerZyz,
    /// Tool in the base frame: x, y, z, m, and the rotation vector, rad.
    XyzAngleAxis,
}

impl Coordinates {
    const ALL: [Self; 4] = [Self::Motor, Self::Joint, Self::XyzEulerZyz, Self::XyzAngleAxis];

    /// Keyword of the first line.
    pub const fn keyword(self) -> &'static str {
        match self {
            Self::Motor => "MOTOR",
            Self::Joint => "JOINT",
            Self::XyzEulerZyz => "XYZ_EULER_ZYZ",
            Self::XyzAngleAxis => "XYZ_ANGLE_AXIS",
        }
    }
}

/// Reference of the poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionType {
    /// Poses are positions.
    Absolute,
    /// Poses are displacements from the pose before.
    Relative,
}

impl MotionType {
    const ALL: [Self; 2] = [Self::Absolute, Self::Relative];

    /// Keyword of the third line.
    pub const fn keyword(self) -> &'static str {
        match self {
            Self::Absolute => "ABSOLUTE",
            Self::Relative => "RELATIVE",
        }
    }
}

/// A row of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseRow {
    /// Fractions of the velocity limits.
    Velocities,
    /// Fractions of the acceleration limits.
    Accelerations,
    /// Coordinates.
    Coordinates,
}

impl fmt::Display for PoseRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Velocities => "velocity fractions",
            Self::Accelerations => "acceleration fractions",
            Self::Coordinates => "coordinates",
        })
    }
}

/// A text is no trajectory file. Lines are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{line}: {problem}")]
pub struct TrajectoryFileError {
    /// The line; the line after the last one if the text ends too early.
    pub line: usize,
    /// The problem.
    pub problem: TrajectoryFileProblem,
}

/// Problem of a line. Columns and poses are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum TrajectoryFileProblem {
    #[error("must be MOTOR, JOINT, XYZ_EULER_ZYZ or XYZ_ANGLE_AXIS")]
    Coordinates,
    #[error("must be the number of poses, 1 to {}", MOST_POSES)]
    Count,
    #[error("must be ABSOLUTE or RELATIVE, or the first row of a file of the format before 2010")]
    MotionType,
    #[error(
        "a row of time and eight coordinates: a teach-in file of MRROC++; replace each time by two rows, the \
         fractions of velocity and acceleration"
    )]
    TeachIn,
    #[error("must be joints = {} or joints = {}", JointConvention::Inclination, JointConvention::Relative)]
    Joints,
    #[error("joints = {found} contradicts line {first}, joints = {told}: remove one of the two lines")]
    TwoConventions { found: JointConvention, told: JointConvention, first: usize },
    #[error("the file ends before its {row} of pose {pose}: correct the number of poses in line 2, or add the rows")]
    Ended { pose: usize, row: PoseRow },
    #[error("the file ends before its first three lines: coordinates, number of poses, ABSOLUTE or RELATIVE")]
    NoHead,
    #[error("{}, supported are 1 to {max}", counted(*.columns, "column"))]
    TooWide { columns: usize, max: usize },
    #[error("{}, and the coordinates of the first pose have {expected}", counted(*.columns, "column"))]
    Ragged { columns: usize, expected: usize },
    #[error("column {column} must be a finite number")]
    Number { column: usize },
    #[error("column {column}: the fraction {value} must be above 0 and at most 1")]
    Fraction { column: usize, value: f64 },
}

/// A trajectory file does not fit a robot. Poses are counted from 1.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum TrajectoryError {
    #[error(
        "poses have {}, and the robot has {}: the file belongs to another robot",
        counted(*.columns, "column"),
        counted(*.axes, "axis")
    )]
    OtherRobot { columns: usize, axes: usize },
    #[error(
        "poses of the tool ({}) cannot be executed: convert them to JOINT by `mrroc kinematics convert`",
        .coordinates.keyword()
    )]
    Tool { coordinates: Coordinates },
    #[error("joints = {given} contradicts the file, whose joints are joints = {told}: remove the setting")]
    Contradiction { told: JointConvention, given: JointConvention },
    #[error("{0}")]
    TwoReadings(Box<Readings>),
    #[error("pose {pose}: {error}")]
    Pose { pose: usize, error: KinematicsError },
    #[error("{0}")]
    Generator(#[from] GeneratorError),
}

/// The poses of a trajectory file.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryFile {
    coordinates: Coordinates,
    motion: MotionType,
    columns: usize,
    poses: Vec<SmoothPose>,
    joints: Option<JointConvention>,
}

impl TrajectoryFile {
    /// A file with the first `columns` entries of these poses; the others become zero. Refuses what
    /// [`parse`](Self::parse) refuses, with the line in the text of the file.
    pub fn new(
        coordinates: Coordinates,
        motion: MotionType,
        columns: usize,
        mut poses: Vec<SmoothPose>,
    ) -> Result<Self, TrajectoryFileError> {
        let of_line = |line: usize, problem| TrajectoryFileError { line, problem };
        if poses.is_empty() || poses.len() > MOST_POSES {
            return Err(of_line(2, TrajectoryFileProblem::Count));
        }
        if columns == 0 || columns > MAX_AXES {
            return Err(of_line(4, TrajectoryFileProblem::TooWide { columns, max: MAX_AXES }));
        }
        for (number, pose) in poses.iter_mut().enumerate() {
            for (index, row) in ROWS.into_iter().enumerate() {
                let (written, others) = row.of_mut(pose).split_at_mut(columns);
                check_row(row, written).map_err(|problem| of_line(4 + 3 * number + index, problem))?;
                others.fill(0.0);
            }
        }
        Ok(Self { coordinates, motion, columns, poses, joints: None })
    }

    /// The same file with a line that tells its convention of joints. Other files than JOINT remain as they are.
    #[must_use]
    pub fn telling(self, joints: JointConvention) -> Self {
        Self { joints: (self.coordinates == Coordinates::Joint).then_some(joints), ..self }
    }

    /// Reads the text of a file, of any robot.
    pub fn parse(text: &str) -> Result<Self, TrajectoryFileError> {
        reading::read(text, None).map(|(file, _)| file)
    }

    /// Reads the text of a file for a robot with this number of axes. Columns behind those of the robot are ignored, as
    /// MRROC++ did. Exception: a wider file for a robot of five axes keeps its columns, since it belongs to the IRp-6
    /// with its six axes. The notes tell what was left out.
    pub fn read(text: &str, axes: usize) -> Result<(Self, Vec<TrajectoryNote>), TrajectoryFileError> {
        reading::read(text, Some(axes))
    }

    /// What the coordinates of the poses are.
    pub fn coordinates(&self) -> Coordinates {
        self.coordinates
    }

    /// Reference of the poses.
    pub fn motion(&self) -> MotionType {
        self.motion
    }

    /// The convention of the joints, if the file tells it: by a line of its own, or by its age.
    pub fn joints(&self) -> Option<JointConvention> {
        self.joints
    }

    /// Number of columns of a row: that of the axes of the robot.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The poses. Entries beyond the columns are zero.
    pub fn poses(&self) -> &[SmoothPose] {
        &self.poses
    }

    /// The motion through the poses for a robot with this number of axes. The fractions apply to `joints` or
    /// `motors`, the limits of joints or motors. Joints are those of the robot: [`for_arm`](Self::for_arm) comes first.
    pub fn motion_of(
        &self,
        axes: usize,
        joints: MotionLimits,
        motors: MotionLimits,
    ) -> Result<Newsmooth, TrajectoryError> {
        let (space, limits) = match self.coordinates {
            Coordinates::Motor => (Space::Motor, motors),
            Coordinates::Joint => (Space::Joint, joints),
            coordinates @ (Coordinates::XyzEulerZyz | Coordinates::XyzAngleAxis) => {
                return Err(TrajectoryError::Tool { coordinates });
            }
        };
        if self.columns != axes {
            return Err(TrajectoryError::OtherRobot { columns: self.columns, axes });
        }
        let motion = Newsmooth::new(space, axes, limits, self.poses.clone())?;
        Ok(match self.motion {
            MotionType::Absolute => motion,
            MotionType::Relative => motion.by_displacements(),
        })
    }
}

impl PoseRow {
    fn of(self, pose: &SmoothPose) -> &Axes {
        match self {
            Self::Velocities => &pose.velocity,
            Self::Accelerations => &pose.acceleration,
            Self::Coordinates => &pose.position,
        }
    }

    fn of_mut(self, pose: &mut SmoothPose) -> &mut Axes {
        match self {
            Self::Velocities => &mut pose.velocity,
            Self::Accelerations => &mut pose.acceleration,
            Self::Coordinates => &mut pose.position,
        }
    }
}

/// Refuses numbers that are not finite, and fractions out of range.
fn check_row(row: PoseRow, values: &[f64]) -> Result<(), TrajectoryFileProblem> {
    for (value, column) in values.iter().copied().zip(1..) {
        let is_fraction = row != PoseRow::Coordinates;
        if !value.is_finite() {
            return Err(TrajectoryFileProblem::Number { column });
        }
        if is_fraction && !(value > 0.0 && value <= 1.0) {
            return Err(TrajectoryFileProblem::Fraction { column, value });
        }
    }
    Ok(())
}

/// The text of the file. Numbers are written so that they are read back exactly.
impl fmt::Display for TrajectoryFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}\n{}\n{}", self.coordinates.keyword(), self.poses.len(), self.motion.keyword())?;
        for pose in &self.poses {
            for row in ROWS {
                for (column, value) in row.of(pose)[..self.columns].iter().enumerate() {
                    write!(f, "{}{value}", if column == 0 { "" } else { " " })?;
                }
                writeln!(f)?;
            }
        }
        self.joints.map_or(Ok(()), |joints| writeln!(f, "{} = {joints}", reading::JOINTS))
    }
}
