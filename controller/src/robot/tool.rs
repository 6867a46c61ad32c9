//! A robot with its tool, with vectors padded to the axes of the servo.

use std::sync::Arc;

use servo::MAX_AXES;

use super::{KinematicsError, Robot, Vector, Weight};

/// One number per axis; entries beyond the robot's axes are zero.
pub type Axes = [f64; MAX_AXES];

/// Base from tool, metres.
pub type Pose = nalgebra::Isometry3<f64>;

/// A robot and its tool: kinematics from tool to motors, with vectors padded with zeros.
#[derive(Clone, Debug)]
pub struct Arm {
    robot: Arc<dyn Robot>,
    flange_from_tool: Pose,
    weight: Option<Weight>,
}

impl Arm {
    /// The robot with its tool frame; the identity stands for no tool.
    pub fn new(robot: Arc<dyn Robot>, flange_from_tool: Pose) -> Self {
        Self {
            robot,
            flange_from_tool,
            weight: None,
        }
    }

    /// The same arm with the weight of its links. An arm without weight has a weight torque of zero.
    pub fn weighing(self, weight: Weight) -> Self {
        Self {
            weight: Some(weight),
            ..self
        }
    }

    /// The robot without its tool.
    pub fn robot(&self) -> &dyn Robot {
        &*self.robot
    }

    /// Number of axes of the robot.
    pub fn axes(&self) -> usize {
        self.robot.axes()
    }

    /// Pose of the tool in the base frame at these joint positions.
    pub fn forward(&self, joints: &Axes) -> Result<Pose, KinematicsError> {
        Ok(self.robot.forward(&self.given(joints))? * self.flange_from_tool)
    }

    /// The joint positions, within all limits, that bring the tool to the pose, on the branch nearest to `near`.
    pub fn inverse(&self, base_from_tool: &Pose, near: &Axes) -> Result<Axes, KinematicsError> {
        let base_from_flange = base_from_tool * self.flange_from_tool.inverse();
        let solutions = self.robot.inverse(&base_from_flange, &self.given(near))?;
        Ok(solutions.preferred().padded())
    }

    /// Motor positions for these joint positions. Both are checked against their limits.
    pub fn motors(&self, joints: &Axes) -> Result<Axes, KinematicsError> {
        Ok(self.robot.motors_from_joints(&self.given(joints))?.padded())
    }

    /// Joint positions at these motor positions.
    pub fn joints(&self, motors: &Axes) -> Result<Axes, KinematicsError> {
        Ok(self.robot.joints_from_motors(&self.given(motors))?.padded())
    }

    /// Motor torques at these positions, N·m, that balance the weight of links and load.
    pub fn torques(&self, motors: &Axes) -> Result<Axes, KinematicsError> {
        match &self.weight {
            None => Ok(Axes::default()),
            Some(weight) => weight.torque(&*self.robot, &self.given(motors)),
        }
    }

    fn given<Space>(&self, numbers: &Axes) -> Vector<Space> {
        Vector::new(&numbers[..self.axes()]).expect("a robot has no more axes than the servo")
    }
}
