//! Steps of single robots, in a scene in which only robots move.

use can::Instant;

use super::Scene;
use super::arm::Arm;
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

    /// Advances one of the [independent robots](Self::independent_robots) by one step. The caller has already moved the
    /// robot's motors to the end of the step, and calls [`Scene::end_steps`] after the steps of all robots.
    pub(crate) fn step_robot(&mut self, number: usize) {
        self.arms[number].follow(true);
        self.push_tips(number..number + 1);
        self.arms[number].finish(&self.gravity);
    }

    /// Sets the time of the last step, after the steps of all independent robots.
    pub(crate) fn end_steps(&mut self, now: Instant) {
        self.now = now;
    }
}
