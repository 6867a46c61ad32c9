//! The part of an emulated axis controller that both protocols share.

use can::Instant;

use super::AxisControllerConfig;
use super::drive::Drive;
use crate::outbox::{Heard, Outbox};

/// The drive and its pending answers, shared by both protocols.
pub(super) struct Unit {
    pub(super) drive: Drive,
    pub(super) heard: Heard,
    pub(super) outbox: Outbox,
    config: AxisControllerConfig,
}

impl Unit {
    pub(super) fn new(config: AxisControllerConfig) -> Self {
        Self {
            drive: Drive::new(&config),
            heard: Heard::default(),
            outbox: Outbox::new(),
            config,
        }
    }

    /// Answers a request whose last byte has arrived.
    pub(super) fn answer(&mut self, bytes: &[u8], now: Instant) {
        let at = now + self.config.answer_delay;
        self.heard.overrun += self.outbox.put(at, bytes) as u64;
    }

    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let moves = self.drive.poll_timeout();
        let answers = self.outbox.poll_timeout();
        Some(answers.map_or(moves, |at| at.min(moves)))
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        self.outbox.run(now);
        if self.drive.poll_timeout() <= now {
            self.drive.catch_up(now);
        }
    }
}
