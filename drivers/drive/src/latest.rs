//! The latest value of a fixed number of words, for one writer and any number of readers.
//!
//! Neither side waits for the other. The writer fills two buffers alternately. A reader repeats its read if the writer
//! began to overwrite the buffer.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

/// One buffer. The words may be read during a write. A read is valid if `number` is the same, and not 0, before and
/// after the read.
#[derive(Debug)]
struct Copied<const N: usize> {
    /// Number of the value, from 1; 0 while it is written.
    number: AtomicU64,
    words: [AtomicU64; N],
}

#[derive(Debug)]
struct Shared<const N: usize> {
    /// Number of words that may differ from zero.
    used: usize,
    /// Number of the last value published.
    published: AtomicU64,
    copies: [Copied<N>; 2],
}

impl<const N: usize> Shared<N> {
    fn copy(&self, number: u64) -> &Copied<N> {
        &self.copies[(number % 2) as usize]
    }
}

/// Both ends of a latest value, which is `first` until another value is published.
pub fn latest<const N: usize>(first: [u64; N]) -> (Publisher<N>, Latest<N>) {
    latest_of(N, first)
}

/// As [`latest`], for values in which only the first `used` words may differ from zero. Publishing and reading are faster
/// with fewer words.
pub fn latest_of<const N: usize>(used: usize, first: [u64; N]) -> (Publisher<N>, Latest<N>) {
    let copy = |number| Copied { number: AtomicU64::new(number), words: first.map(AtomicU64::new) };
    let shared = Arc::new(Shared { used: used.min(N), published: AtomicU64::new(1), copies: [copy(0), copy(1)] });
    (Publisher { shared: Arc::clone(&shared), number: 1 }, Latest(shared))
}

/// The writing end. There is one per value.
#[derive(Debug)]
pub struct Publisher<const N: usize> {
    shared: Arc<Shared<N>>,
    number: u64,
}

impl<const N: usize> Publisher<N> {
    /// Replaces the value. The function neither waits nor allocates.
    pub fn publish(&mut self, words: &[u64; N]) {
        self.number += 1;
        let copy = self.shared.copy(self.number);
        copy.number.store(0, Ordering::Relaxed);
        // A reader that sees a new word also sees that the copy is being written.
        fence(Ordering::Release);
        for (place, word) in copy.words.iter().zip(words).take(self.shared.used) {
            place.store(*word, Ordering::Relaxed);
        }
        copy.number.store(self.number, Ordering::Release);
        self.shared.published.store(self.number, Ordering::Release);
    }
}

/// The reading end. Clones read the same value. A read does not change the value and does not delay the writer.
#[derive(Clone, Debug)]
pub struct Latest<const N: usize>(Arc<Shared<N>>);

impl<const N: usize> Latest<N> {
    /// The latest value. All its words are of one publication.
    pub fn read(&self) -> [u64; N] {
        loop {
            let number = self.0.published.load(Ordering::Acquire);
            let copy = self.0.copy(number);
            let before = copy.number.load(Ordering::Acquire);
            let mut words = [0; N];
            for (word, place) in words.iter_mut().zip(&copy.words).take(self.0.used) {
                *word = place.load(Ordering::Relaxed);
            }
            fence(Ordering::Acquire);
            // Otherwise the writer began to overwrite this buffer during the read.
            if before == number && copy.number.load(Ordering::Relaxed) == number {
                return words;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    #[test]
    fn the_first_value_is_read_until_another_is_published() {
        let (mut publisher, latest) = latest([7, 8]);
        assert_eq!(latest.read(), [7, 8]);
        publisher.publish(&[1, 2]);
        assert_eq!(latest.clone().read(), [1, 2]);
        publisher.publish(&[3, 4]);
        assert_eq!(latest.read(), [3, 4]);
    }

    #[test]
    fn unused_words_stay_zero() {
        let (mut publisher, latest) = latest_of(2, [7, 8, 0]);
        assert_eq!(latest.read(), [7, 8, 0]);
        publisher.publish(&[1, 2, 3]);
        assert_eq!(latest.read(), [1, 2, 0]);
    }

    #[test]
    fn readers_see_neither_two_values_at_once_nor_an_earlier_one_after_a_later_one() {
        const LAST: u64 = 200_000;
        let (mut publisher, latest) = latest([0; 20]);
        thread::scope(|scope| {
            for _ in 0..2 {
                let latest = latest.clone();
                scope.spawn(move || {
                    let mut last = 0;
                    while last < LAST {
                        let words = latest.read();
                        assert_eq!(words, [words[0]; 20]);
                        assert!(words[0] >= last);
                        last = words[0];
                    }
                });
            }
            (1..=LAST).for_each(|number| publisher.publish(&[number; 20]));
        });
    }
}
