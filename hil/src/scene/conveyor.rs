//! Conveyors: belts with a drifting speed, and bodies that are placed on a belt while the scene runs.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::time::Duration;

use can::Instant;
use nalgebra::Vector3;

use super::{BodyConfig, BodyId, Scene, SceneError, WallId};
use crate::AngleProbe;

/// The drive of a belt.
pub(super) struct Belt {
    pub(super) shaft: AngleProbe,
    /// Angle of the shaft at the last step, rad.
    pub(super) angle: f64,
    /// Travel of the belt per angle of the shaft, m/rad, in the frame of the wall.
    pub(super) way: Vector3<f64>,
}

impl Drop for Belt {
    fn drop(&mut self) {
        self.shaft.remove_belt();
    }
}

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

/// Bodies of [`Scene::place_body`].
#[derive(Default)]
pub(super) struct Arrivals {
    /// Bodies that are still to come, in the order of time.
    pub(super) coming: VecDeque<Coming>,
    /// Bodies that have come, by their numbers.
    placed: Vec<Option<BodyId>>,
}

/// A body that is still to come.
pub(super) struct Coming {
    number: usize,
    at: Instant,
    config: BodyConfig,
}

impl Scene {
    /// Sets the velocity, m/s, of a belt on a wall of this scene, in the axes of the world.
    pub fn set_belt(&mut self, wall: WallId, velocity: [f64; 3]) {
        let wall = &mut self.walls[wall.0];
        (wall.belt, wall.drift) = (None, None);
        wall.surface.belt = wall.moving.axes.tr_mul(&Vector3::from(velocity));
    }

    /// Couples the belt on a wall of this scene to a motor. `way` is the travel of the belt per angle of the motor
    /// shaft, m/rad, in the axes of the world. The motor must belong to a drive of the same [`World`](crate::World).
    /// Friction on the belt does not load the motor.
    pub fn drive_belt(&mut self, wall: WallId, shaft: AngleProbe, way: [f64; 3]) {
        let wall = &mut self.walls[wall.0];
        shaft.add_belt();
        let way = wall.moving.axes.tr_mul(&Vector3::from(way));
        wall.drift = None;
        wall.belt = Some(Belt { angle: shaft.angle(), shaft, way });
    }

    /// Drives the belt on a wall of this scene at a mean `velocity`, m/s, in the axes of the world. The deviation of
    /// the speed is a sine of the given period, with the amplitude `share` times the mean.
    pub fn drift_belt(&mut self, wall: WallId, velocity: [f64; 3], share: f64, period: Duration) {
        self.set_belt(wall, velocity);
        let wall = &mut self.walls[wall.0];
        let (velocity, frequency) = (wall.surface.belt, TAU / period.as_secs_f64());
        wall.drift = Some(Drift { velocity, share, frequency });
    }

    /// Places a body in the scene at `at`, at the beginning of the first step from then on. Returns its number for
    /// [`Scene::placed`]. Fails as [`Scene::add_body`].
    pub fn place_body(&mut self, at: Instant, config: &BodyConfig) -> Result<usize, SceneError> {
        config.check()?;
        let Arrivals { coming, placed } = &mut self.arrivals;
        let number = placed.len();
        placed.push(None);
        let index = coming.partition_point(|other| other.at <= at);
        coming.insert(index, Coming { number, at, config: *config });
        Ok(number)
    }

    /// The body of a call of [`Scene::place_body`]; `None` before its time.
    pub fn placed(&self, number: usize) -> Option<BodyId> {
        self.arrivals.placed.get(number).copied().flatten()
    }

    /// Adds the bodies that are due at the beginning of a step.
    pub(super) fn place_due(&mut self) {
        while self.arrivals.coming.front().is_some_and(|coming| coming.at <= self.now) {
            if let Some(Coming { number, config, .. }) = self.arrivals.coming.pop_front() {
                self.arrivals.placed[number] = self.add_body(&config).ok();
            }
        }
    }
}
