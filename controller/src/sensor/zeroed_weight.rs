//! Weight of a tool at the zeroing of its force/torque sensor, passed from the virtual sensor to a cycle law.

use std::array;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use drive::latest::{Latest, Publisher, latest};

use crate::force::Wrench;

/// Length of the encoded value: six components and the number of the request.
pub(super) const WORDS: usize = 7;

/// Both ends of the weight at the last zeroing. There was no zeroing yet.
pub(super) fn zeroed_weight() -> (WeightPublisher, ZeroedWeight) {
    let (publisher, latest) = latest([0; WORDS]);
    let taken = array::from_fn(|_| Arc::default());
    (WeightPublisher(publisher), ZeroedWeight { latest, taken })
}

/// The writing end.
#[derive(Debug)]
pub(super) struct WeightPublisher(Publisher<WORDS>);

impl WeightPublisher {
    /// Publishes the weight at the zeroing with number `request`; 0 for none.
    pub(super) fn publish(&mut self, request: u64, weight: &Wrench) {
        let mut words = [request; WORDS];
        for (word, component) in words.iter_mut().zip(weight.components()) {
            *word = component.to_bits();
        }
        self.0.publish(&words);
    }

    /// Publishes the words that a law took in an earlier run.
    pub(super) fn repeat(&mut self, words: &[u64; WORDS]) {
        self.0.publish(words);
    }
}

/// Weight of the tool at the last zeroing of its sensor, which the measured wrench no longer contains. A read neither
/// allocates nor waits for the writer.
#[derive(Clone, Debug)]
pub struct ZeroedWeight {
    latest: Latest<WORDS>,
    /// The words that the law took last.
    taken: [Arc<AtomicU64>; WORDS],
}

impl ZeroedWeight {
    /// The weight `weight` at the zeroing with number `request`.
    pub fn of(request: u64, weight: &Wrench) -> Self {
        let (mut publisher, reader) = zeroed_weight();
        publisher.publish(request, weight);
        reader
    }

    /// The words that the law took last.
    pub(super) fn taken(&self) -> &[Arc<AtomicU64>; WORDS] {
        &self.taken
    }

    /// Number of the zeroing, 0 before the first, and the weight at that time in the frame of the sensor.
    pub fn read(&self) -> (u64, Wrench) {
        let words = self.latest.read();
        for (taken, word) in self.taken.iter().zip(words) {
            taken.store(word, Ordering::Relaxed);
        }
        (words[WORDS - 1], Wrench::from_components(array::from_fn(|component| f64::from_bits(words[component]))))
    }
}
