//! A gripper of a robot, which a digital output opens and closes.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Point3};

use super::grip::GripConfig;
use super::{BodyId, GripId, Holder, RobotId, Scene, SceneError, finite};
use crate::OutputProbe;

/// A gripper at the flange of a robot.
///
/// The gripper closes in the step in which its output takes the level `closed_at`. It then holds the first body of the
/// scene whose surface is at most `reach` away from the gripper's origin, or which contains the origin. The spring of
/// the grip is unloaded in the pose in which the gripper finds the body, because jaws adapt to the place of a part. A
/// gripper that finds no body holds nothing until it closes again. Jaws take no time to close.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperConfig {
    /// Springs and dampers of the closed gripper.
    pub grip: GripConfig,
    /// Place between the jaws in the flange frame of [`Mechanism::set_payload`](crate::Mechanism::set_payload).
    pub pose: Isometry3<f64>,
    /// Greatest distance of a body that the gripper holds, m.
    pub reach: f64,
    /// Level of the output at which the gripper is closed.
    pub closed_at: bool,
}

/// The true wrench of a gripper on its body, for tests and recordings. Clones read the same gripper.
#[derive(Clone, Debug, Default)]
pub struct GripProbe(Arc<Mutex<Option<[f64; 6]>>>);

impl GripProbe {
    /// Force, N, and torque, N·m, as [`Scene::grip_wrench`]; `None` while the gripper holds no body.
    pub fn last(&self) -> Option<[f64; 6]> {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(super) struct Gripper {
    config: GripperConfig,
    robot: RobotId,
    output: OutputProbe,
    is_closed: bool,
    grip: Option<GripId>,
    probe: GripProbe,
}

impl Scene {
    /// Adds a gripper that a digital output drives. Fails if the grip is not passive or a number is invalid.
    pub fn add_gripper(
        &mut self,
        robot: RobotId,
        config: &GripperConfig,
        output: &OutputProbe,
    ) -> Result<GripProbe, SceneError> {
        let GripConfig { stiffness, damping, .. } = config.grip;
        if !config.grip.is_passive() {
            return Err(SceneError::Grip { stiffness, damping });
        }
        finite(&config.pose, "the place of a gripper")?;
        if !(config.reach >= 0.0 && config.reach.is_finite()) {
            return Err(SceneError::Length { what: "the reach of a gripper", value: config.reach });
        }
        let probe = GripProbe::default();
        let (config, output) = (*config, output.clone());
        self.grippers.push(Gripper { config, robot, output, is_closed: false, grip: None, probe: probe.clone() });
        Ok(probe)
    }

    /// Opens and closes the grippers whose outputs have changed.
    pub(super) fn switch_grippers(&mut self) {
        for number in 0..self.grippers.len() {
            let gripper = &self.grippers[number];
            let closes = gripper.output.level() == gripper.config.closed_at;
            if closes == gripper.is_closed {
                continue;
            }
            let (config, robot) = (gripper.config, gripper.robot);
            let grip = if let Some(grip) = gripper.grip {
                self.release(grip);
                None
            } else {
                let found = self.body_at(robot, &config).filter(|_| closes);
                let hold = |body| self.hold(&config.grip, Holder::Robot(robot), &config.pose, body, None);
                found.map(hold).transpose().expect("the gripper was checked when it was added")
            };
            let gripper = &mut self.grippers[number];
            (gripper.is_closed, gripper.grip) = (closes, grip);
        }
    }

    /// The first body within the reach of a gripper.
    fn body_at(&self, robot: RobotId, config: &GripperConfig) -> Option<BodyId> {
        let at = self.flange(robot) * Point3::from(config.pose.translation.vector);
        let near = self.bodies.iter().position(|body| {
            let local = body.state().pose.inverse() * at;
            body.surface.shape.gap(&local.coords).0 <= config.reach
        });
        near.map(BodyId)
    }

    /// Shows the wrenches of this step in the probes.
    pub(super) fn show_grippers(&self) {
        for gripper in &self.grippers {
            let wrench = gripper.grip.map(|grip| self.grip_wrench(grip));
            *gripper.probe.0.lock().unwrap_or_else(PoisonError::into_inner) = wrench;
        }
    }
}
