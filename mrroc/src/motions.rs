//! Motions of one robot of a cell, within the limits of its axes.

use anyhow::{Context, bail};
use controller::generator::{MotionLimits, Newsmooth};
use controller::robot::{Arm, Space};

use crate::cell::{CellFile, smooth_pose};

/// Makes generators for one robot of a cell.
#[derive(Clone, Debug)]
pub struct Motions {
    arm: Arm,
    limits: MotionLimits,
}

impl Motions {
    /// Motions of robot `robot`.
    pub(crate) fn of(file: &CellFile, robot: usize) -> Self {
        let arm = file.arms[robot].clone();
        let limits = file.cell.robot[robot].motion_limits(&arm);
        Self { arm, limits }
    }

    /// Kinematics, drive train and tool of the robot.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Limits of the joints that the motors permit, rad or m and s.
    pub fn limits(&self) -> MotionLimits {
        self.limits
    }

    /// A synchronised trapezoid through joint positions, rad (m for a linear joint).
    ///
    /// `share` is the fraction of the limits of velocity and acceleration to use, above 0 and at most 1.
    pub fn joints<const AXES: usize>(&self, share: f64, poses: &[[f64; AXES]]) -> anyhow::Result<Newsmooth> {
        let axes = self.arm.axes();
        if AXES != axes {
            bail!("a pose has {AXES} joints, and the robot has {axes}");
        }
        let poses = poses.iter().map(|pose| smooth_pose(pose, share, share)).collect();
        let motion = Newsmooth::new(Space::Joint, axes, self.limits, poses);
        motion.context("the joint motion cannot be planned")
    }
}
