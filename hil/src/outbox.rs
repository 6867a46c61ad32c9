//! Bytes that an emulated device receives and sends.

use std::collections::VecDeque;

use can::Instant;

/// Receive counters of a device. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Heard {
    /// Requests executed.
    pub obeyed: u64,
    /// Requests to other addresses.
    pub foreign: u64,
    /// Requests that were valid but unknown, or that the drive does not support.
    pub refused: u64,
    /// Frames whose checksum was wrong.
    pub damaged: u64,
    /// Bytes that belonged to no request.
    pub skipped: u64,
    /// Bytes of answers that found no room in the transmit buffer.
    pub overrun: u64,
}

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
        Self {
            bytes: VecDeque::with_capacity(Self::CAPACITY),
            now: Instant::ZERO,
        }
    }

    /// Adds the bytes for which there is room, and returns the number of the others. `at` must not decrease.
    pub(crate) fn put(&mut self, at: Instant, bytes: &[u8]) -> usize {
        let fit = bytes.len().min(Self::CAPACITY - self.bytes.len());
        self.bytes
            .extend(bytes[..fit].iter().map(|&byte| (at, byte)));
        bytes.len() - fit
    }

    pub(crate) fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        let &(_, byte) = self.bytes.front().filter(|(at, _)| *at <= now)?;
        self.bytes.pop_front();
        Some(byte)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Sets the current time.
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
