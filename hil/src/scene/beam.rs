//! Light gates: beams that bodies of the scene break.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use can::Instant;
use nalgebra::Vector3;

use super::body::Body;
use super::motion::Place;
use super::surface::Shape;
use super::{STEP, Scene, SceneError};
use crate::plant::Noise;

/// Shortest response time of a light gate. A device reads the edges of step n at the beginning of step n + 2.
pub const SHORTEST_RESPONSE: Duration = Duration::from_micros(200);

/// Edges that a light gate keeps until its device takes them. Further edges replace the oldest.
const KEPT: usize = 64;

/// Bisections of a step: the time of an edge is found to 100 µs / 2²⁰ = 0.1 ns.
const BISECTIONS: u32 = 20;

/// A light gate: a beam from a sender to a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamConfig {
    /// Sender in the world, m.
    pub from: [f64; 3],
    /// Receiver in the world, m.
    pub to: [f64; 3],
    /// Time from the interruption or the return of the light to the edge of the output, at least
    /// [`SHORTEST_RESPONSE`].
    pub response: Duration,
    /// Longest further delay of an edge. The delay of each edge is uniformly distributed from zero to this value.
    pub jitter: Duration,
    /// Seed of the jitter.
    pub seed: u64,
}

/// A change of the output of a light gate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BeamEdge {
    /// Time of the change.
    pub at: Instant,
    /// Whether the beam is broken afterwards.
    pub broken: bool,
}

/// The output of one light gate, for an emulated device. Clones share the edges: each edge is taken once.
#[derive(Clone, Debug, Default)]
pub struct BeamProbe(Arc<Mutex<VecDeque<BeamEdge>>>);

impl BeamProbe {
    /// Takes the next edge, in the order of time.
    pub fn take(&self) -> Option<BeamEdge> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    fn put(&self, edge: BeamEdge) {
        let mut edges = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if edges.len() == KEPT {
            edges.pop_front();
        }
        edges.push_back(edge);
    }
}

/// The light gates of a scene.
#[derive(Default)]
pub(super) struct Beams {
    all: Vec<Beam>,
    /// Places of all bodies before the present step.
    before: Vec<Place>,
}

impl Beams {
    /// Notes the places of all bodies before a step.
    pub(super) fn note(&mut self, bodies: &[Body]) {
        if !self.all.is_empty() {
            self.before.clear();
            self.before.extend(bodies.iter().map(|body| body.place));
        }
    }

    /// Computes the edges of the step that ended at `now`.
    pub(super) fn look(&mut self, bodies: &[Body], now: Instant) {
        for beam in &mut self.all {
            beam.look(bodies, &self.before, now);
        }
    }
}

struct Beam {
    ends: [Vector3<f64>; 2],
    response: Duration,
    jitter: f64,
    noise: Noise,
    broken: bool,
    /// Time of the last edge.
    last: Instant,
    probe: BeamProbe,
}

impl Beam {
    fn new(config: &BeamConfig, probe: BeamProbe) -> Result<Self, SceneError> {
        let ends = [Vector3::from(config.from), Vector3::from(config.to)];
        if !ends.iter().flat_map(|end| end.iter()).all(|value| value.is_finite()) {
            return Err(SceneError::NotFinite { what: "an end of a light gate" });
        }
        let length = (ends[1] - ends[0]).norm();
        if length <= 0.0 {
            return Err(SceneError::Length { what: "the beam of a light gate", value: length });
        }
        if config.response < SHORTEST_RESPONSE {
            return Err(SceneError::Response { response: config.response });
        }
        Ok(Self {
            ends,
            response: config.response,
            jitter: config.jitter.as_secs_f64(),
            noise: Noise::new(config.seed),
            broken: false,
            last: Instant::ZERO,
            probe,
        })
    }

    /// Compares the bodies at the end of a step, at `now`, with those at its beginning, whose places are `before`.
    fn look(&mut self, bodies: &[Body], before: &[Place], now: Instant) {
        let broken = self.is_broken(bodies, before, 1.0);
        if broken == self.broken {
            return;
        }
        let [mut old, mut new] = [0.0, 1.0];
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (old + new);
            if self.is_broken(bodies, before, middle) == broken {
                new = middle;
            } else {
                old = middle;
            }
        }
        let at = now - STEP + STEP.mul_f64(new) + self.response;
        let at = at + Duration::from_secs_f64(self.jitter * 0.5 * (1.0 + self.noise.symmetric()));
        // The jitter does not change the order of the edges.
        self.last = at.max(self.last + Duration::from_nanos(1));
        self.broken = broken;
        self.probe.put(BeamEdge { at: self.last, broken });
    }

    /// Whether any body breaks the beam at `share` of the step.
    fn is_broken(&self, bodies: &[Body], before: &[Place], share: f64) -> bool {
        bodies.iter().zip(before).any(|(body, before)| {
            let Shape::Box { half } = body.surface.shape else {
                return false;
            };
            let place = before.towards(&body.place, share);
            let axes = place.axes();
            let [from, to] = self.ends.map(|end| axes.tr_mul(&(end - place.origin)));
            crosses(&from, &to, half)
        })
    }
}

/// Whether a segment has a point inside a box around the origin.
fn crosses(from: &Vector3<f64>, to: &Vector3<f64>, half: [f64; 3]) -> bool {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let (start, along) = (from[axis], to[axis] - from[axis]);
        if along == 0.0 {
            if start.abs() > half[axis] {
                return false;
            }
            continue;
        }
        let [one, other] = [(-half[axis] - start) / along, (half[axis] - start) / along];
        enter = enter.max(one.min(other));
        leave = leave.min(one.max(other));
    }
    enter <= leave
}

impl Scene {
    /// Adds a light gate, whose edges go to `probe`. Bodies break the beam; surfaces and robots do not. An object that
    /// breaks a beam for less than a [`STEP`] may give no edge. Fails if the beam has no length, a number is not finite,
    /// or the response time is too short.
    pub fn add_beam(&mut self, config: &BeamConfig, probe: BeamProbe) -> Result<(), SceneError> {
        self.beams.all.push(Beam::new(config, probe)?);
        Ok(())
    }
}
