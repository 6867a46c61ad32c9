//! [`Arm`]: a robot with its tool. Vectors have one entry per axis of the servo.

use std::sync::Arc;

use servo::MAX_AXES;

use super::{KinematicsError, Robot, Vector, Weight};

/// One number per axis; entries beyond the robot's axes are zero.
pub type Axes = [f64; MAX_AXES];

/// Pose of one frame in another, lengths in m: `base_from_tool` unless the name says otherwise.
pub type Pose = nalgebra::Isometry3<f64>;

/// A robot and its tool: kinematics from tool to motors. Vectors are padded with zeros.
#[derive(Clone, Debug)]
pub struct Arm {
    robot: Arc<dyn Robot>,
    flange_from_tool: Pose,
    weight: Option<Arc<Weight>>,
}

impl Arm {
    /// The robot with a tool; the identity means no tool.
    pub fn new(robot: Arc<dyn Robot>, flange_from_tool: Pose) -> Self {
        Self { robot, flange_from_tool, weight: None }
    }

    /// The same arm with the masses of links and load. Without masses, [`torques`](Self::torques) returns zeros.
    pub fn weighing(self, weight: Weight) -> Self {
        Self { weight: Some(Arc::new(weight)), ..self }
    }

    /// The robot without its tool.
    pub fn robot(&self) -> &dyn Robot {
        &*self.robot
    }

    /// Pose of the tool at the flange.
    pub fn flange_from_tool(&self) -> &Pose {
        &self.flange_from_tool
    }

    /// Number of axes of the robot.
    pub fn axes(&self) -> usize {
        self.robot.axes()
    }

    /// Pose of the tool in the base frame at these joint positions.
    pub fn forward(&self, joints: &Axes) -> Result<Pose, KinematicsError> {
        Ok(self.robot.forward(&self.given(joints))? * self.flange_from_tool)
    }

    /// Joint positions within all limits that bring the tool to this pose: of all solutions the nearest to `near`.
    pub fn inverse(&self, base_from_tool: &Pose, near: &Axes) -> Result<Axes, KinematicsError> {
        let base_from_flange = base_from_tool * self.flange_from_tool.inverse();
        Ok(self.robot.inverse(&base_from_flange, &self.given(near))?.preferred().padded())
    }

    /// Motor positions for these joint positions. Both are checked against their limits.
    pub fn motors(&self, joints: &Axes) -> Result<Axes, KinematicsError> {
        Ok(self.robot.motors_from_joints(&self.given(joints))?.padded())
    }

    /// Joint positions at these motor positions. Limits are not checked.
    pub fn joints(&self, motors: &Axes) -> Result<Axes, KinematicsError> {
        Ok(self.robot.joints_from_motors(&self.given(motors))?.padded())
    }

    /// Motor torques, N·m, that balance links and load at these motor positions.
    pub fn torques(&self, motors: &Axes) -> Result<Axes, KinematicsError> {
        match &self.weight {
            None => Ok(Axes::default()),
            Some(weight) => weight.torque(&*self.robot, &self.given(motors)),
        }
    }

    /// The numbers of the axes of the robot, without the padding.
    pub fn given<Space>(&self, numbers: &Axes) -> Vector<Space> {
        Vector::new(&numbers[..self.axes()]).expect("a robot has no more axes than the servo")
    }
}
