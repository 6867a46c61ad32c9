//! A robot with its tool, on numbers padded to the axes of the servo.

use std::sync::Arc;

use servo::MAX_AXES;

use super::{KinematicsError, Robot, Vector, Weight};

/// One number per axis; entries beyond the robot's axes are zero.
pub type Axes = [f64; MAX_AXES];

/// Base from tool, metres.
pub type Pose = nalgebra::Isometry3<f64>;

/// A robot and the tool it carries: its kinematics from tool to motors, on numbers padded with zeros.
#[derive(Clone, Debug)]
pub struct Arm {
    robot: Arc<dyn Robot>,
    flange_from_tool: Pose,
    weight: Option<Weight>,
}

impl Arm {
    /// The robot with its tool's frame; the identity for none.
    pub fn new(robot: Arc<dyn Robot>, flange_from_tool: Pose) -> Self {
        Self {
            robot,
            flange_from_tool,
            weight: None,
        }
    }

    /// The same with links that weigh; without, they are taken to weigh nothing.
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

    /// How many axes it has.
    pub fn axes(&self) -> usize {
        self.robot.axes()
    }

    /// Base from tool, at these joint positions.
    pub fn forward(&self, joints: &Axes) -> Result<Pose, KinematicsError> {
        Ok(self.robot.forward(&self.given(joints))? * self.flange_from_tool)
    }

    /// The joint positions, within every limit, that take the tool there, on the branch next to `near`.
    pub fn inverse(&self, base_from_tool: &Pose, near: &Axes) -> Result<Axes, KinematicsError> {
        let base_from_flange = base_from_tool * self.flange_from_tool.inverse();
        let solutions = self.robot.inverse(&base_from_flange, &self.given(near))?;
        Ok(solutions.preferred().padded())
    }

    /// Motor positions at these joint positions, both within limits.
    pub fn motors(&self, joints: &Axes) -> Result<Axes, KinematicsError> {
        Ok(self.robot.motors_from_joints(&self.given(joints))?.padded())
    }

    /// Joint positions at these motor positions.
    pub fn joints(&self, motors: &Axes) -> Result<Axes, KinematicsError> {
        Ok(self.robot.joints_from_motors(&self.given(motors))?.padded())
    }

    /// Torques of the motors at these positions, N·m, that hold the weight of links and load.
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
