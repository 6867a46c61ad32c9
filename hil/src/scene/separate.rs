//! Steps of single robots, in a scene in which only robots move.

use can::Instant;
use nalgebra::Vector3;

use super::arm::Arm;
use super::{Scene, TipOn, Wall};
use crate::Mechanism;

impl Scene {
    /// The robots, if each robot influences only its own devices: there are no bodies, belts, cutting tools, grippers and
    /// touch probes.
    pub(crate) fn independent_robots(&self) -> Option<impl Iterator<Item = &Mechanism>> {
        let at_rest = self.walls.iter().all(|wall| wall.belt.is_none() && wall.drift.is_none());
        let bare = self.bodies.is_empty() && self.arrivals.coming.is_empty() && self.cutting.is_empty();
        let silent = self.arms.iter().all(|arm| arm.touches.is_empty()) && self.grippers.is_empty();
        (at_rest && bare && silent).then(|| self.arms.iter().map(Arm::mechanism))
    }

    /// All robots, each with the data for its steps. The robots must be [independent](Self::independent_robots). The
    /// caller calls [`Scene::end_steps`] after the steps of all robots.
    pub(crate) fn robots(&mut self) -> impl Iterator<Item = RobotOfScene<'_>> {
        let Self { arms, tips, walls, gravity, .. } = self;
        let mut robots: Vec<_> =
            arms.iter_mut().map(|arm| RobotOfScene { arm, tips: Vec::new(), walls, gravity }).collect();
        tips.iter_mut().for_each(|pair| robots[pair.arm].tips.push(pair));
        robots.into_iter()
    }

    /// Sets the time of the last step, after the steps of all independent robots.
    pub(crate) fn end_steps(&mut self, now: Instant) {
        self.now = now;
    }
}

/// A robot that no other robot of the scene influences.
pub(crate) struct RobotOfScene<'a> {
    arm: &'a mut Arm,
    tips: Vec<&'a mut TipOn>,
    walls: &'a [Wall],
    gravity: &'a Vector3<f64>,
}

impl RobotOfScene<'_> {
    /// Advances the robot by one step. The caller has already moved the motors of the robot to the end of the step.
    pub(crate) fn step(&mut self) {
        self.arm.follow(true);
        self.arm.begin_clearance();
        for pair in &mut self.tips {
            pair.push(self.arm, self.walls, &[], &[]);
        }
        self.arm.finish(self.gravity);
    }
}
