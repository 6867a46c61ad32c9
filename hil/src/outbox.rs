//! Bytes that an emulated device sends.

use std::collections::VecDeque;

use can::Instant;

/// Bytes to be sent by a device, each with its earliest time.
#[derive(Clone, Debug)]
pub(crate) struct Outbox {
    bytes: VecDeque<(Instant, u8)>,
    now: Instant,
}

impl Outbox {
    /// Capacity in bytes: some dozens of answers.
    const CAPACITY: usize = 1024;

    pub(crate) fn new() -> Self {
        Self { bytes: VecDeque::with_capacity(Self::CAPACITY), now: Instant::ZERO }
    }

    /// Adds the bytes for which there is room. The others are lost. `at` must not decrease.
    pub(crate) fn put(&mut self, at: Instant, bytes: &[u8]) {
        let room = Self::CAPACITY - self.bytes.len();
        self.bytes.extend(bytes.iter().take(room).map(|&byte| (at, byte)));
    }

    pub(crate) fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        let &(_, byte) = self.bytes.front().filter(|(at, _)| *at <= now)?;
        self.bytes.pop_front();
        if self.bytes.is_empty() {
            // The next answer uses the same memory, which is in the cache of the processor.
            self.bytes.clear();
        }
        Some(byte)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    pub(crate) fn run(&mut self, now: Instant) {
        self.now = now;
    }

    /// Time at which the next byte may go, if it lies in the future. A byte that is already due goes as soon as the
    /// line is free, which needs no time-out.
    pub(crate) fn poll_timeout(&self) -> Option<Instant> {
        let &(at, _) = self.bytes.front()?;
        (at > self.now).then_some(at)
    }
}
