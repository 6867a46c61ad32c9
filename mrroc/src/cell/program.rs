//! Conversion of the program in a cell file to the task of an effector control process.

use std::f64::consts::PI;
use std::time::Duration;

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use servo::MAX_AXES;
use thiserror::Error;

use super::{Axis, Cell, Instruction, JointGenerator, Joints, LineInstruction, Path, Robot};
use controller::ecp::Task;
use controller::generator::{
    self, Axes, GeneratorError, JerkLimited, LineLimits, MotionLimits, Newsmooth, PlannedStart, Pose, SmoothPose,
};
use controller::robot::{Arm, KinematicsError, Limits, Space};

/// Greatest joint velocity, acceleration and jerk of generators, rad/s, rad/s² and rad/s³. Velocity and acceleration
/// are those of MRROC++'s generators. With this jerk, the acceleration is reached in a tenth of a second.
pub const JOINT_LIMITS: (f64, f64, f64) = (1.5, 7.0, 70.0);

/// Fractions of a motor's limits of velocity and acceleration for plans. The rest of the acceleration has three uses:
/// changes of the speed override; quintics between macrosteps, which need up to 5/3 of a planned acceleration; and ball
/// screws, whose motor accelerates while the joint velocity is constant.
pub const PLANNED: (f64, f64) = (0.95, 0.5);

/// Number of joint positions at which the drive train is sampled, over the range of each joint.
const SAMPLES: usize = 32;

/// Time to reach the tool acceleration, s.
const LINE_RISE: f64 = 0.1;

/// Permitted rotation per metre of tool motion, rad/m. The angular limits of a line are its linear limits times this.
const TURN_PER_METRE: f64 = 5.0;

/// Number of instructions of a task before those of the program: enable and home.
const PREAMBLE: usize = 2;

/// Error of a program.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ProgramError {
    /// The arm cannot reach the pose.
    #[error("{0}")]
    Kinematics(#[from] KinematicsError),
    /// A generator refuses the motion.
    #[error("{0}")]
    Generator(#[from] GeneratorError),
}

impl ProgramError {
    /// The axis concerned.
    pub fn axis(&self) -> Option<usize> {
        match *self {
            Self::Kinematics(cause) | Self::Generator(GeneratorError::Path { cause, .. }) => cause.axis(),
            Self::Generator(_) => None,
        }
    }
}

/// The key of instruction `index` of the program of robot `robot`.
pub fn instruction_path(robot: usize, index: usize) -> Path {
    Path::to("robot").then(robot).then("program").then(index)
}

impl Cell {
    /// The program of robot `robot` as a task: enable, home, the instructions in order, disable.
    ///
    /// Every pose is checked from the end of the previous instruction. An error comes with the key of the instruction
    /// or the pose.
    pub fn task(&self, robot: usize, arm: &Arm) -> Result<Task, (Path, ProgramError)> {
        let (given, home) = (&self.robot[robot], self.home(robot, arm));
        let meetings = self.meetings();
        let mut task = Task::new().enable().home();
        let mut joints = arm.joints(&home.motors).map_err(|error| (instruction_path(robot, 0), error.into()))?;
        let mut start = Some(home);
        for (index, instruction) in given.program.iter().enumerate() {
            let key = instruction_path(robot, index);
            let (next, end) = match instruction {
                Instruction::Joints(motion) => {
                    let key = key.then("joints").then("poses");
                    given.joint_motion(arm, motion, task).map_err(|(pose, error)| (key.then(pose), error))
                }
                Instruction::Line(line) => {
                    given.line(arm, line, &joints, start, task).map_err(|error| (key.then("line"), error))
                }
                Instruction::Meet(name) => {
                    let meeting = meetings.iter().position(|it| it.name == *name);
                    let meeting = meeting.and_then(|meeting| u8::try_from(meeting).ok());
                    Ok((task.meet(meeting.expect("a parsed cell has few enough meetings")), joints))
                }
            }?;
            (task, joints) = (next, end);
            // After the first motion, the arm is at the end of that motion.
            start = start.filter(|_| matches!(instruction, Instruction::Meet(_)));
        }
        Ok(task.disable())
    }
}

impl Robot {
    /// The index in the program of instruction `index` of the [`task`](Cell::task); `None` for those before and after
    /// the program.
    pub fn instruction_of(&self, index: usize) -> Option<usize> {
        let mut left = index.checked_sub(PREAMBLE)?;
        self.program.iter().position(|instruction| {
            let moves = moves(instruction);
            let found = left < moves;
            left = left.saturating_sub(moves);
            found
        })
    }

    /// Converts a joint motion. An error comes with the number of its pose.
    fn joint_motion(&self, arm: &Arm, motion: &Joints, task: Task) -> Result<(Task, Axes), (usize, ProgramError)> {
        let poses: Vec<Axes> = motion.poses.iter().map(|pose| padded(pose)).collect();
        for (number, pose) in poses.iter().enumerate() {
            arm.motors(pose).map_err(|error| (number, error.into()))?;
        }
        let end = *poses.last().ok_or((0, GeneratorError::NoPoses.into()))?;
        let limits = self.motion_limits(arm);
        let task = match motion.generator {
            JointGenerator::Newsmooth => {
                let poses = poses.iter().map(|pose| smooth_pose(pose, motion.velocity, motion.acceleration)).collect();
                let generator = Newsmooth::new(Space::Joint, arm.axes(), limits, poses);
                task.run(generator.map_err(|error| (0, error.into()))?)
            }
            JointGenerator::JerkLimited => {
                let limits = MotionLimits {
                    max_velocity: limits.max_velocity.map(|it| it * motion.velocity),
                    max_acceleration: limits.max_acceleration.map(|it| it * motion.acceleration),
                    max_jerk: limits.max_jerk.map(|it| it * motion.acceleration),
                };
                let mut task = task;
                for (number, pose) in poses.iter().enumerate() {
                    let generator = JerkLimited::new(Space::Joint, arm.axes(), limits, &[*pose]);
                    let generator = generator.map_err(|error| (number, error.into()))?;
                    task = task.run(match motion.duration {
                        Some(duration) => generator.lasting(Duration::from_secs_f64(duration)),
                        None => generator,
                    });
                }
                task
            }
        };
        Ok((task, end))
    }

    fn line(
        &self,
        arm: &Arm,
        line: &LineInstruction,
        from: &Axes,
        start: Option<PlannedStart>,
        task: Task,
    ) -> Result<(Task, Axes), ProgramError> {
        let rotation = match line.quaternion {
            Some([w, x, y, z]) => UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
            None => arm.forward(from)?.rotation,
        };
        let target = Pose::from_parts(Translation3::from(line.position), rotation);
        let end = arm.inverse(&target, from)?;
        let limits = LineLimits {
            max_velocity: line.velocity,
            max_acceleration: line.acceleration,
            max_jerk: line.acceleration / LINE_RISE,
            max_angular_velocity: line.velocity * TURN_PER_METRE,
            max_angular_acceleration: line.acceleration * TURN_PER_METRE,
            max_angular_jerk: line.acceleration * TURN_PER_METRE / LINE_RISE,
        };
        let generator = generator::StraightLine::new(arm.clone(), target, limits, self.motion_limits(arm))?;
        let generator = match start {
            Some(start) => generator.beginning_at(start),
            None => generator,
        };
        let generator = if line.constant_speed { generator.at_constant_speed() } else { generator };
        Ok((task.run(generator), end))
    }

    /// Limits of each joint that keep every motor within its share of the limits.
    ///
    /// Joints that turn a common motor are slowed together.
    pub fn motion_limits(&self, arm: &Arm) -> MotionLimits {
        let (velocity, acceleration, jerk) = JOINT_LIMITS;
        let mut limits = MotionLimits::uniform(velocity, acceleration, jerk);
        let gains = steepest_gains(arm);
        for (motor, gains) in gains.iter().enumerate().take(arm.axes()) {
            let axis = &self.axis[motor];
            slow(&mut limits.max_velocity, gains, axis.max_velocity * PLANNED.0);
            slow(&mut limits.max_acceleration, gains, axis.max_acceleration * PLANNED.1);
        }
        for joint in 0..arm.axes() {
            limits.max_jerk[joint] = jerk * limits.max_acceleration[joint] / acceleration;
        }
        limits
    }

    /// Limits of each motor for plans: its share of the limits of the servo.
    pub fn motor_limits(&self) -> MotionLimits {
        let mut limits = MotionLimits::uniform(0.0, 0.0, 0.0);
        for (motor, axis) in self.axis.iter().enumerate() {
            limits.max_velocity[motor] = axis.max_velocity * PLANNED.0;
            limits.max_acceleration[motor] = axis.max_acceleration * PLANNED.1;
            limits.max_jerk[motor] = axis.planned_jerk();
        }
        limits
    }
}

impl Axis {
    /// Greatest jerk of the motor in plans, rad/s³.
    pub(crate) fn planned_jerk(&self) -> f64 {
        let (_, acceleration, jerk) = JOINT_LIMITS;
        self.max_acceleration * PLANNED.1 * jerk / acceleration
    }
}

/// Number of instructions of a task for one instruction of a program.
fn moves(instruction: &Instruction) -> usize {
    match instruction {
        Instruction::Joints(Joints { generator: JointGenerator::JerkLimited, poses, .. }) => poses.len(),
        Instruction::Joints(_) | Instruction::Line(_) | Instruction::Meet(_) => 1,
    }
}

/// Reduces the `rates` of the joints that turn a motor until their sum is within `limit`.
fn slow(rates: &mut Axes, gains: &Axes, limit: f64) {
    let sum: f64 = rates.iter().zip(gains).map(|(rate, gain)| rate * gain).sum();
    if sum > limit {
        for (rate, _) in rates.iter_mut().zip(gains).filter(|(_, gain)| **gain > 0.0) {
            *rate *= limit / sum;
        }
    }
}

/// The greatest |∂motor/∂joint| over the range of each joint, one row per motor.
fn steepest_gains(arm: &Arm) -> [Axes; MAX_AXES] {
    let mut gains = [[0.0; MAX_AXES]; MAX_AXES];
    let Ok(home) = arm.joints(&arm.robot().home().padded()) else {
        return gains;
    };
    for (joint, range) in arm.robot().joint_limits().iter().enumerate() {
        // The drive train of a joint without end repeats with every turn.
        let range =
            if range.is_continuous() { Limits { low: home[joint] - PI, high: home[joint] + PI } } else { *range };
        let step = (range.high - range.low) / SAMPLES as f64;
        let at = |sample: usize| {
            let mut joints = home;
            joints[joint] = range.low + step * sample as f64;
            arm.motors(&joints).ok()
        };
        for sample in 0..SAMPLES {
            let (Some(low), Some(high)) = (at(sample), at(sample + 1)) else {
                continue;
            };
            for motor in 0..arm.axes() {
                let gain = ((high[motor] - low[motor]) / step).abs();
                gains[motor][joint] = f64::max(gains[motor][joint], gain);
            }
        }
    }
    gains
}

/// A pose of a synchronised trapezoid, reached with these fractions of the limits.
pub(crate) fn smooth_pose(pose: &[f64], velocity: f64, acceleration: f64) -> SmoothPose {
    SmoothPose { position: padded(pose), velocity: [velocity; MAX_AXES], acceleration: [acceleration; MAX_AXES] }
}

fn padded(pose: &[f64]) -> Axes {
    let mut axes = Axes::default();
    axes[..pose.len()].copy_from_slice(pose);
    axes
}
