//! Light gates along a line of travel as a virtual sensor: direction, velocity and place of passing objects.
//!
//! An object breaks the beams one after the other. Each gate gives the time at which the front of the object arrives, and
//! the time at which its back leaves. The sensor computes from these times:
//!
//! - the velocity: distance of the gates per time between their edges, as the mean of fronts and backs;
//! - the place of the front at any time, by the edge at the last gate and the velocity;
//! - the length: velocity times the duration for which a beam is broken.
//!
//! # Times of edges
//!
//! The driver stamps an edge with the receive time of the frame that showed the edge first. The edge was earlier by
//! - a constant [`delay`](LightGatesConfig::delay): response of the gate, filter of the input, and length of the frame;
//! - the wait of the frame for the bus, from zero to [`wait`](LightGatesConfig::wait);
//! - the wait for the end of the inhibit time, if the node sent another frame shortly before.
//!
//! The sensor subtracts the delay and half of the possible wait. The error of a time is then at most the other half.
//! With the widths *w* of the possible waits at two gates, and the time *T* between their edges, the relative error of the
//! velocity is at most *e* / (*T* − *e*) with *e* = (*w₁* + *w₂*) / 2. The error of a place is at most *v* *w₂* / 2 plus the
//! error of the velocity times the time since the last gate. [`Passage::velocity_bound`] and [`Passage::place_bound`] are
//! these bounds. The bounds hold for a constant velocity.

mod estimate;
#[cfg(test)]
mod tests;

use std::time::Duration;

use can::{Instant, counted};
use drive::cia401::{Edge, EdgesLost, InputImage, IoFault, LatestInputs};
use thiserror::Error;

use super::VirtualSensor;
use crate::generator::{GeneratorError, SensorReading};
pub use estimate::Passage;
use estimate::{Mark, between, occlusions, passage};

/// Greatest number of gates of a sensor.
pub const MAX_GATES: usize = 4;

/// Greatest number of objects between the first and the last gate.
pub const MAX_OBJECTS: usize = 8;

/// Greatest difference between the durations for which an object breaks two beams, as a share of the longer one.
const UNLIKE: f64 = 0.25;

/// A light gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateLine {
    /// Number of the input of the I/O node, from 0. The input is true while the beam is broken.
    pub input: u8,
    /// Place of the beam on the line of travel, m.
    pub place: f64,
}

/// Directions in which objects pass the gates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Travel {
    /// Towards greater places.
    Forward,
    /// Towards lower places.
    Backward,
    /// Both. An object that enters at one end while its gate there fails is then reported as too slow.
    Either,
}

/// Places of the gates, and delays of their edges.
#[derive(Clone, Debug, PartialEq)]
pub struct LightGatesConfig {
    /// Two to [`MAX_GATES`] gates of one I/O node, in ascending order of their places.
    pub gates: Vec<GateLine>,
    /// Possible directions.
    pub travel: Travel,
    /// Lowest speed, m/s. A slower object is [`GateError::TooSlow`].
    pub min_speed: f64,
    /// Greatest speed, m/s. A faster object is [`GateError::TooFast`].
    pub max_speed: f64,
    /// Constant delay from an edge of the light to the receive time of its frame.
    pub delay: Duration,
    /// Longest wait of a frame for the bus, and jitter of the gates.
    pub wait: Duration,
    /// Inhibit time of the node.
    pub inhibit_time: Duration,
}

/// Why a sensor of light gates is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document the variants")]
pub enum GatesRefused {
    #[error("{}, must be 2 to {MAX_GATES}: a velocity needs two places", counted(*.count, "gate"))]
    Count { count: usize },
    #[error("gate {gate}: its place must be finite and beyond that of the gate before")]
    Place { gate: usize },
    #[error("gate {gate}: input {input} already has a gate")]
    Input { gate: usize, input: u8 },
    #[error("speeds from {min} to {max} m/s: the lowest must be above zero and below the greatest, both finite")]
    Speeds { min: f64, max: f64 },
}

/// Why the gates have no velocity and place of an object. Gates are counted from 0 in the order of their places.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GateError {
    /// The I/O node or its bus has a fault. Objects between the gates are forgotten.
    #[error("{0}")]
    Node(IoFault),
    /// The sensor was read too rarely. Objects between the gates are forgotten.
    #[error("{0}")]
    Lost(EdgesLost),
    /// An object broke a beam without having broken the previous beam. The previous gate is out of order, or the object
    /// was already beyond that gate when the sensor began.
    #[error("gate {gate} has no edge of an object that reached gate {reached}: check the beam of gate {gate}")]
    Missing {
        /// Gate without an edge.
        gate: usize,
        /// Gate with an edge.
        reached: usize,
    },
    /// Two edges are closer in time than the greatest speed allows, or in the wrong order.
    #[error("gate {gate} broke {after:.1?} after the gate before, which is above the greatest speed")]
    TooFast {
        /// Second gate.
        gate: usize,
        /// Time between both edges, zero for the wrong order.
        after: Duration,
    },
    /// An object did not reach the next gate at the lowest speed. The object stands, was removed, or the gate is out of
    /// order.
    #[error("no object at gate {gate} for {waited:.1?} since the gate before, which is below the lowest speed")]
    TooSlow {
        /// Gate without an edge.
        gate: usize,
        /// Time since the edge before.
        waited: Duration,
    },
    /// The durations for which an object broke the first and the last beam differ by more than a quarter: edges of two
    /// objects, or an object that changed its speed.
    #[error("the beams were broken for {first:.1?} and {last:.1?}: edges of two objects, or no constant speed")]
    Unlike {
        /// At the first gate.
        first: Duration,
        /// At the last gate.
        last: Duration,
    },
    /// More than [`MAX_OBJECTS`] objects are between the first and the last gate.
    #[error("more than {MAX_OBJECTS} objects between the gates")]
    TooMany,
}

/// Reading of a sensor of light gates.
///
/// The age of the reading is the time since the last frame of the I/O node. The age of a passage follows from
/// [`Passage::at`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateReading {
    count: u64,
    last: Result<Option<Passage>, GateError>,
}

impl SensorReading for GateReading {}

impl GateReading {
    /// The last object that reached the last gate on its way; `None` before the first object. After a [`GateError`] of
    /// a later object, the reading is this error until another object reaches its last gate.
    pub fn passage(&self) -> Result<Option<Passage>, GeneratorError> {
        self.last.map_err(GeneratorError::Gates)
    }

    /// Number of objects so far that reached their last gate or failed.
    pub fn count(&self) -> u64 {
        self.count
    }
}

/// An object between the first and the last gate.
#[derive(Clone, Copy, Debug)]
struct Object {
    /// Number of the passage; zero before the last gate.
    number: u64,
    forward: bool,
    /// Gate that the front reached last.
    reached: usize,
    /// Times of fronts and backs at the gates.
    fronts: [Option<Mark>; MAX_GATES],
    backs: [Option<Mark>; MAX_GATES],
}

/// Light gates along a line of travel, at inputs of one I/O node.
pub struct LightGates {
    inputs: LatestInputs,
    track: Track,
    seen: u64,
}

impl LightGates {
    /// A sensor on the link to an I/O node. Objects that are between the gates at this time are not measured.
    pub fn new(inputs: LatestInputs, config: &LightGatesConfig) -> Result<Self, GatesRefused> {
        let seen = inputs.read().edge_count();
        Ok(Self { track: Track::new(config)?, inputs, seen })
    }

    /// The present reading, with the time of the last frame of the node.
    pub fn read(&mut self) -> (Instant, GateReading) {
        let image = self.inputs.read();
        (image.heard, self.take(&image))
    }

    fn take(&mut self, image: &InputImage) -> GateReading {
        let seen = std::mem::replace(&mut self.seen, image.edge_count());
        let track = &mut self.track;
        if let Some(fault) = image.fault {
            track.clear();
            return GateReading { count: track.count, last: Err(GateError::Node(fault)) };
        }
        match image.edges_since(seen) {
            Ok(edges) => edges.for_each(|edge| track.edge(&edge)),
            Err(lost) => {
                track.clear();
                track.end(Err(GateError::Lost(lost)));
            }
        }
        track.watch(image.at);
        GateReading { count: track.count, last: track.last }
    }
}

impl VirtualSensor for LightGates {
    type Reading = GateReading;
    type Command = ();

    fn poll(&mut self, _: Instant) -> Option<(Instant, GateReading)> {
        Some(self.read())
    }
}

/// The objects between the gates, as a function of the edges.
struct Track {
    gates: [GateLine; MAX_GATES],
    /// Index of the last gate.
    end: usize,
    travel: Travel,
    speeds: [f64; 2],
    delay: Duration,
    wait: Duration,
    inhibit_time: Duration,
    /// The objects, oldest first.
    objects: [Option<Object>; MAX_OBJECTS],
    count: u64,
    last: Result<Option<Passage>, GateError>,
}

impl Track {
    fn new(config: &LightGatesConfig) -> Result<Self, GatesRefused> {
        let LightGatesConfig { ref gates, travel, min_speed, max_speed, delay, wait, inhibit_time } = *config;
        if !(2..=MAX_GATES).contains(&gates.len()) {
            return Err(GatesRefused::Count { count: gates.len() });
        }
        for (gate, line) in gates.iter().enumerate() {
            let before = &gates[..gate];
            if !line.place.is_finite() || before.last().is_some_and(|before| line.place <= before.place) {
                return Err(GatesRefused::Place { gate });
            }
            if before.iter().any(|before| before.input == line.input) {
                return Err(GatesRefused::Input { gate, input: line.input });
            }
        }
        if !(0.0 < min_speed && min_speed < max_speed && max_speed.is_finite()) {
            return Err(GatesRefused::Speeds { min: min_speed, max: max_speed });
        }
        let mut array = [gates[0]; MAX_GATES];
        array[..gates.len()].copy_from_slice(gates);
        Ok(Self {
            gates: array,
            end: gates.len() - 1,
            travel,
            speeds: [min_speed, max_speed],
            delay,
            wait,
            inhibit_time,
            objects: [None; MAX_OBJECTS],
            count: 0,
            last: Ok(None),
        })
    }

    /// Forgets the objects between the gates.
    fn clear(&mut self) {
        self.objects = [None; MAX_OBJECTS];
    }

    fn end(&mut self, outcome: Result<Passage, GateError>) {
        self.count += 1;
        self.last = outcome.map(Some);
    }

    /// Takes an edge. Edges of other inputs are ignored.
    fn edge(&mut self, edge: &Edge) {
        let Some(gate) = self.gates[..=self.end].iter().position(|gate| gate.input == edge.input) else {
            return;
        };
        let mark = self.mark(edge);
        if edge.level { self.front(gate, mark) } else { self.back(gate, mark) }
    }

    /// The time of an edge at the beam. A frame within the inhibit time after the frame before may have waited for the
    /// end of that time.
    fn mark(&self, edge: &Edge) -> Mark {
        let since = edge.at.since(edge.previous);
        let inhibited = since <= self.inhibit_time + self.wait;
        let width = if inhibited { since + self.wait } else { self.wait };
        Mark { at: edge.at - self.delay - width / 2, width }
    }

    /// The next gate of an object; `None` at its last gate.
    fn next(&self, object: &Object) -> Option<usize> {
        let Object { forward, reached, .. } = *object;
        if forward { Some(reached + 1).filter(|next| *next <= self.end) } else { reached.checked_sub(1) }
    }

    fn way(&self, from: usize, to: usize) -> f64 {
        (self.gates[to].place - self.gates[from].place).abs()
    }

    fn find(&self, is: impl Fn(&Object) -> bool) -> Option<(usize, Object)> {
        let mut objects = self.objects.iter().enumerate();
        objects.find_map(|(index, object)| object.filter(|object| is(object)).map(|object| (index, object)))
    }

    fn remove(&mut self, index: usize) {
        self.objects[index..].rotate_left(1);
        self.objects[MAX_OBJECTS - 1] = None;
    }

    /// The beam of `gate` is broken.
    fn front(&mut self, gate: usize, mark: Mark) {
        if let Some((index, mut object)) = self.find(|object| self.next(object) == Some(gate)) {
            let before = object.reached;
            let Some(from) = object.fronts[before] else { return };
            let shortest = self.way(before, gate) / self.speeds[1];
            if between(mark.at, from.at) + (mark.width + from.width).as_secs_f64() / 2.0 < shortest {
                self.remove(index);
                return self.end(Err(GateError::TooFast { gate, after: mark.at.since(from.at) }));
            }
            object.reached = gate;
            object.fronts[gate] = Some(mark);
            if self.next(&object).is_none() {
                self.count += 1;
                object.number = self.count;
                self.pass(&object);
            }
            self.objects[index] = Some(object);
            return;
        }
        let forward = match self.travel {
            Travel::Forward => true,
            Travel::Backward => false,
            Travel::Either => gate == 0,
        };
        let entry = if forward { 0 } else { self.end };
        if gate != entry {
            let missing = if forward { gate - 1 } else { gate + 1 };
            return self.end(Err(GateError::Missing { gate: missing, reached: gate }));
        }
        let Some(free) = self.objects.iter().position(Option::is_none) else {
            return self.end(Err(GateError::TooMany));
        };
        let mut fronts = [None; MAX_GATES];
        fronts[gate] = Some(mark);
        let object = Object { number: 0, forward, reached: gate, fronts, backs: [None; MAX_GATES] };
        self.objects[free] = Some(object);
    }

    /// The beam of `gate` is free. The back of an object that was in the beam at the start is ignored.
    fn back(&mut self, gate: usize, mark: Mark) {
        let is_there = |object: &Object| object.fronts[gate].is_some() && object.backs[gate].is_none();
        let Some((index, mut object)) = self.find(is_there) else {
            return;
        };
        object.backs[gate] = Some(mark);
        self.objects[index] = Some(object);
        if self.next(&object).is_some() || object.reached != gate {
            return;
        }
        self.remove(index);
        let entry = if object.forward { 0 } else { self.end };
        match occlusions(&object, entry) {
            Some((first, last, width)) if first.abs_diff(last) > first.max(last).mul_f64(UNLIKE) + width => {
                self.last = Err(GateError::Unlike { first, last });
            }
            _ => self.pass(&object),
        }
    }

    /// Reports an object at its last gate.
    fn pass(&mut self, object: &Object) {
        if let Some(passage) = passage(object, &self.gates[..=self.end]) {
            self.last = Ok(Some(passage));
        }
    }

    /// Gives up the objects that are too slow.
    fn watch(&mut self, now: Instant) {
        let late = |object: &Object| {
            let next = self.next(object)?;
            let waited = now.since(object.fronts[object.reached]?.at + self.delay + self.wait + self.inhibit_time);
            let longest = self.way(object.reached, next) / self.speeds[0];
            (waited.as_secs_f64() > longest).then_some((next, waited))
        };
        let found = self.objects.iter().enumerate().find_map(|(index, object)| Some((index, late(object.as_ref()?)?)));
        if let Some((index, (gate, waited))) = found {
            self.remove(index);
            self.end(Err(GateError::TooSlow { gate, waited }));
        }
    }
}
