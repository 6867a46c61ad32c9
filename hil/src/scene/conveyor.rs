//! Conveyors: belts whose speed drifts, and bodies that are placed on them while the scene runs.

use std::f64::consts::TAU;
use std::time::Duration;

use can::Instant;
use nalgebra::Vector3;

use super::{BodyConfig, BodyId, Scene, SceneError, WallId};

/// The motor of a belt, whose speed follows a sine about its mean.
pub(super) struct Drift {
    /// Mean velocity in the frame of the wall, m/s.
    velocity: Vector3<f64>,
    /// Greatest deviation as a share of the mean.
    share: f64,
    /// Angular frequency, rad/s.
    frequency: f64,
}

impl Drift {
    /// Velocity of the belt at `now`, m/s.
    pub(super) fn at(&self, now: Instant) -> Vector3<f64> {
        let angle = self.frequency * now.since(Instant::ZERO).as_secs_f64();
        self.velocity * (1.0 + self.share * angle.sin())
    }
}

/// A body that is still to come.
pub(super) struct Coming {
    /// Number of the body among those that came or will come.
    number: usize,
    at: Instant,
    config: BodyConfig,
}

impl Scene {
    /// Drives the belt on a wall of this scene at a mean `velocity`, m/s, in the axes of the world. The speed deviates by
    /// up to the `share` of the mean, as a sine of the given period.
    pub fn drift_belt(&mut self, wall: WallId, velocity: [f64; 3], share: f64, period: Duration) {
        self.set_belt(wall, velocity);
        let wall = &mut self.walls[wall.0];
        let (velocity, frequency) = (wall.surface.belt, TAU / period.as_secs_f64());
        wall.drift = Some(Drift { velocity, share, frequency });
    }

    /// Places a body in the scene at `at`, at the beginning of the first step from then on. Returns its number for
    /// [`Scene::placed`]. Fails as [`Scene::add_body`].
    pub fn place_body(&mut self, at: Instant, config: &BodyConfig) -> Result<usize, SceneError> {
        super::check_body(config)?;
        let number = self.placed.len();
        self.placed.push(None);
        let index = self.coming.partition_point(|other| other.at <= at);
        self.coming.insert(index, Coming { number, at, config: *config });
        Ok(number)
    }

    /// The body of a call of [`Scene::place_body`]; `None` before its time.
    pub fn placed(&self, number: usize) -> Option<BodyId> {
        self.placed.get(number).copied().flatten()
    }

    /// Adds the bodies that are due at the beginning of a step.
    pub(super) fn place_due(&mut self, start: Instant) {
        while self.coming.front().is_some_and(|coming| coming.at <= start) {
            if let Some(Coming { number, config, .. }) = self.coming.pop_front() {
                self.placed[number] = self.add_body(&config).ok();
            }
        }
    }
}
