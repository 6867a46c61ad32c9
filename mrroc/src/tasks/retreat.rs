//! Return of motors that stand beyond their position limits.
//!
//! An arm that falls, or that a person moves while the drives are off, may come to rest beyond a limit. No motion of joints
//! or of the tool begins there. Each motor alone may move back towards its limit.

use controller::ecp::Task;
use controller::generator::{MotionLimits, Newsmooth};
use controller::robot::Space;
use servo::MAX_AXES;

use super::{Outcome, Robot};
use crate::cell::smooth_pose;

/// Share of the limits of velocity and acceleration of each motor.
const SHARE: f64 = 0.05;

impl Robot {
    /// Moves each motor that stands beyond a position limit back to within the limit by its `following_error`. Moves
    /// nothing if all motors are within their limits.
    pub(super) async fn return_within_limits(&mut self) -> Outcome {
        let number = self.agent.robot();
        let (arm, axes) = (&self.file.arms[number], &self.file.cell.robot[number].axis);
        let ranges = arm.robot().motor_limits();
        let stands = self.image()?.commanded.motors.position;
        let mut target = stands;
        let mut limits = MotionLimits::uniform(1.0, 1.0, 1.0);
        for (motor, axis) in axes.iter().enumerate() {
            let low = axis.min_position.unwrap_or(ranges[motor].low);
            let high = axis.max_position.unwrap_or(ranges[motor].high);
            let inside = axis.following_error.min(0.25 * (high - low));
            if stands[motor] > high {
                target[motor] = high - inside;
            } else if stands[motor] < low {
                target[motor] = low + inside;
            }
            limits.max_velocity[motor] = axis.max_velocity;
            limits.max_acceleration[motor] = axis.max_acceleration;
        }
        if target == stands {
            return Ok(());
        }
        let pose = smooth_pose(&target[..axes.len().min(MAX_AXES)], SHARE, SHARE);
        let motion = Newsmooth::new(Space::Motor, axes.len(), limits, vec![pose])?;
        self.perform(Task::new().run(motion)).await
    }
}
