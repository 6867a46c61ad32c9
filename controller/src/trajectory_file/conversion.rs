//! Conversion of trajectory files to positions of the joints.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{Axes, Coordinates, JointConvention, MotionType, SmoothPose, TrajectoryError, TrajectoryFile};
use crate::robot::{Arm, Pose};

impl TrajectoryFile {
    /// The file as JOINT file of positions (ABSOLUTE), with the joints of this library. `start` is the position of the
    /// joints at the beginning of the motion. Displacements count from there, and of several solutions of the inverse
    /// kinematics the nearest to the position before is taken. Displacements of the tool are in the frame of the tool.
    ///
    /// `given` is the convention of a JOINT file that does not tell its own. The fractions of joints and motors are
    /// kept. The fractions of tool coordinates have no counterpart: all joints get the least fraction of the row. Between the
    /// poses, the converted motion is one of the joints and not that of the tool's coordinates.
    pub fn to_joints(&self, arm: &Arm, given: Option<JointConvention>, start: &Axes) -> Result<Self, TrajectoryError> {
        let file = self.for_arm(arm, given)?;
        let axes = arm.axes();
        let is_tool = matches!(file.coordinates, Coordinates::XyzEulerZyz | Coordinates::XyzAngleAxis);
        if !is_tool && file.columns != axes {
            return Err(TrajectoryError::OtherRobot { columns: file.columns, axes });
        }
        let mut at = *start;
        let mut poses = Vec::with_capacity(file.poses.len());
        for (pose, number) in file.poses.iter().zip(1..) {
            let of_pose = |error| TrajectoryError::Pose { pose: number, error };
            let moved = |from: Axes| match file.motion {
                MotionType::Absolute => pose.position,
                MotionType::Relative => std::array::from_fn(|axis| from[axis] + pose.position[axis]),
            };
            at = match file.coordinates {
                Coordinates::Joint => moved(at),
                Coordinates::Motor => {
                    let motors = arm.motors(&at).map_err(of_pose)?;
                    arm.joints(&moved(motors)).map_err(of_pose)?
                }
                coordinates @ (Coordinates::XyzEulerZyz | Coordinates::XyzAngleAxis) => {
                    let given = tool(coordinates, &pose.position);
                    let target = match file.motion {
                        MotionType::Absolute => given,
                        MotionType::Relative => arm.forward(&at).map_err(of_pose)? * given,
                    };
                    arm.inverse(&target, &at).map_err(of_pose)?
                }
            };
            arm.motors(&at).map_err(of_pose)?;
            let fractions = |row: &Axes| if is_tool { least(&row[..file.columns], axes) } else { *row };
            let (velocity, acceleration) = (fractions(&pose.velocity), fractions(&pose.acceleration));
            poses.push(SmoothPose { position: at, velocity, acceleration });
        }
        let joints = arm.robot().lower_arm().map(|_| JointConvention::Inclination);
        Ok(Self { coordinates: Coordinates::Joint, motion: MotionType::Absolute, columns: axes, poses, joints })
    }
}

/// The least of these fractions on each axis.
fn least(row: &[f64], axes: usize) -> Axes {
    let least = row.iter().copied().fold(1.0, f64::min);
    std::array::from_fn(|axis| if axis < axes { least } else { 0.0 })
}

/// The pose of six coordinates of the tool.
fn tool(coordinates: Coordinates, &[x, y, z, a, b, c, ..]: &Axes) -> Pose {
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    let rotation = match coordinates {
        Coordinates::XyzEulerZyz => {
            about(Vector3::z_axis(), a) * about(Vector3::y_axis(), b) * about(Vector3::z_axis(), c)
        }
        _ => UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c)),
    };
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}
