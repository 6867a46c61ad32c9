//! Velocity, place and length of an object by the times of its edges.

use std::time::Duration;

use can::Instant;

use super::{GateLine, MAX_GATES, Object};

/// Longest time to a place, s.
const LONGEST: f64 = 1e9;

/// The time of an edge at the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mark {
    pub(super) at: Instant,
    /// Length of the interval around `at` that has the edge.
    pub(super) width: Duration,
}

/// An object that reached its last gate.
///
/// The place of an object is the place of its front: the face that breaks the beams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Number of the object, from 1: [`GateReading::count`](super::GateReading::count) when it reached its last gate.
    pub number: u64,
    /// Velocity, m/s, below zero towards lower places. The mean between the first and the last gate.
    pub velocity: f64,
    /// Greatest error of the velocity by the delays of edges, m/s.
    pub velocity_bound: f64,
    /// Length along the direction of travel, m; `None` until the back has left the last gate.
    pub length: Option<f64>,
    /// Time at which the front reached the last gate.
    pub at: Instant,
    /// Place of that gate, m.
    pub front: f64,
    /// Greatest error of the place at [`at`](Self::at) by the delays of edges, m.
    pub front_bound: f64,
}

impl Passage {
    /// Place of the front at `time`, m, by the velocity since the last gate.
    pub fn front_at(&self, time: Instant) -> f64 {
        self.front + self.velocity * between(time, self.at)
    }

    /// Place of the centre at `time`, m; `None` until the length is known.
    pub fn centre_at(&self, time: Instant) -> Option<f64> {
        Some(self.front_at(time) - 0.5 * self.length?.copysign(self.velocity))
    }

    /// Greatest error of a place at `time` by the delays of edges, m.
    pub fn place_bound(&self, time: Instant) -> f64 {
        self.front_bound + self.velocity_bound * between(time, self.at).abs()
    }

    /// Time at which the front reaches `place`, m. The place of the last gate gives [`at`](Self::at), and a place before
    /// that gate gives an earlier time.
    pub fn reaches(&self, place: f64) -> Instant {
        let after = (place - self.front) / self.velocity;
        let by = Duration::from_secs_f64(after.abs().min(LONGEST));
        if after >= 0.0 { self.at + by } else { self.at - by }
    }
}

/// Time from `earlier` to `later`, s, below zero for the other order.
pub(super) fn between(later: Instant, earlier: Instant) -> f64 {
    later.since(earlier).as_secs_f64() - earlier.since(later).as_secs_f64()
}

/// Durations for which an object broke the beam of its first and of its last gate, and the greatest error of their
/// difference.
pub(super) fn occlusions(object: &Object, entry: usize) -> Option<(Duration, Duration, Duration)> {
    let broken = |gate: usize| {
        let (front, back) = (object.fronts[gate]?, object.backs[gate]?);
        Some((back.at.since(front.at), (front.width + back.width) / 2))
    };
    let ((first, one), (last, other)) = (broken(entry)?, broken(object.reached)?);
    Some((first, last, one + other))
}

/// The passage of an object at its last gate.
pub(super) fn passage(object: &Object, gates: &[GateLine]) -> Option<Passage> {
    let entry = if object.forward { 0 } else { gates.len() - 1 };
    let (first, last) = (object.fronts[entry]?, object.fronts[object.reached]?);
    let fronts = slowness(&object.fronts, gates)?;
    // An edge of the back may be missing at a gate; the fronts alone then give the velocity.
    let slowness = slowness(&object.backs, gates).map_or(fronts, |backs| 0.5 * (fronts + backs));
    let velocity = 1.0 / slowness;
    if !velocity.is_finite() {
        return None;
    }
    let time = between(last.at, first.at);
    let error = (first.width + last.width).as_secs_f64() / 2.0;
    let broken = occlusions(object, entry).map(|(first, last, _)| (first + last).as_secs_f64() / 2.0);
    Some(Passage {
        number: object.number,
        velocity,
        velocity_bound: if time > error { velocity.abs() * error / (time - error) } else { f64::INFINITY },
        length: broken.map(|broken| broken * velocity.abs()),
        at: last.at,
        front: gates[object.reached].place,
        front_bound: velocity.abs() * last.width.as_secs_f64() / 2.0,
    })
}

/// Time per distance, s/m, by least squares over the gates; `None` with fewer than two marks.
fn slowness(marks: &[Option<Mark>; MAX_GATES], gates: &[GateLine]) -> Option<f64> {
    let known = || gates.iter().zip(marks).filter_map(|(gate, mark)| Some((gate.place, mark.as_ref()?.at)));
    let (origin, start) = known().next()?;
    let count = known().count() as f64;
    let points = || known().map(|(place, at)| (place - origin, between(at, start)));
    let (way, time) = points().fold((0.0, 0.0), |sum, (way, time)| (sum.0 + way / count, sum.1 + time / count));
    let (above, below) = points().fold((0.0, 0.0), |sum, point| {
        let off = point.0 - way;
        (sum.0 + off * (point.1 - time), sum.1 + off * off)
    });
    (below > 0.0).then(|| above / below)
}
