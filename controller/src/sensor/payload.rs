//! Payload of a force/torque sensor's tool, passed from the task to the virtual sensor and to a cycle law.

use std::array;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use drive::latest::{Latest, Publisher, latest};
use nalgebra::Vector3;

use crate::force::Load;

/// Length of the encoded value: the mass and three coordinates of its centre.
pub(super) const WORDS: usize = 4;

/// Both ends of a payload. There is no payload yet.
pub(super) fn payload() -> (PayloadPublisher, Payload) {
    let (publisher, latest) = latest([0; WORDS]);
    let taken = array::from_fn(|_| Arc::default());
    (PayloadPublisher(publisher), Payload { latest, taken })
}

/// The writing end.
#[derive(Debug)]
pub(super) struct PayloadPublisher(Publisher<WORDS>);

impl PayloadPublisher {
    /// Publishes a mass, kg, and its centre in the frame of the sensor, m.
    pub(super) fn publish(&mut self, mass: f64, centre: &Vector3<f64>) {
        self.0.publish(&[mass, centre.x, centre.y, centre.z].map(f64::to_bits));
    }

    /// Publishes the words that a law took in an earlier run.
    pub(super) fn repeat(&mut self, words: &[u64; WORDS]) {
        self.0.publish(words);
    }
}

/// The part that a tool carries beside its own load: a point mass. A read neither allocates nor waits for the writer.
#[derive(Clone, Debug)]
pub struct Payload {
    latest: Latest<WORDS>,
    /// The words that the law took last.
    taken: [Arc<AtomicU64>; WORDS],
}

impl Payload {
    /// The words that the law took last.
    pub(super) fn taken(&self) -> &[Arc<AtomicU64>; WORDS] {
        &self.taken
    }

    /// `load` with the present payload.
    pub(super) fn added_to(&self, load: &Load) -> Load {
        of(load, self.latest.read())
    }

    /// `load` with the present payload, for a cycle law. The words are noted for a recording.
    pub(crate) fn take(&self, load: &Load) -> Load {
        let words = self.latest.read();
        for (taken, word) in self.taken.iter().zip(words) {
            taken.store(word, Ordering::Relaxed);
        }
        of(load, words)
    }
}

fn of(load: &Load, words: [u64; WORDS]) -> Load {
    let [mass, x, y, z] = words.map(f64::from_bits);
    if mass == 0.0 {
        return *load;
    }
    // Words of a file may be no load.
    Load::of_weight(mass, Vector3::new(x, y, z)).map_or(*load, |part| load.carrying(&part))
}
