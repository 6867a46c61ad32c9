//! The host's heartbeat: when it is due, and for how long the port has not taken it.

use std::time::Duration;

use can::Instant;

/// The host's heartbeat in operation. A drive watches it from the first one on (CiA 301 §7.5.2.19).
#[derive(Clone, Copy, Debug)]
pub(crate) struct OwnHeartbeat {
    due: Instant,
    /// When the port took the last one, or was offered the first one.
    since: Option<Instant>,
    /// The port took one: the drives would notice that the host falls silent.
    pub(crate) watched: bool,
}

impl OwnHeartbeat {
    /// None was sent, and the first one is due at `now`.
    pub(crate) fn due_at(now: Instant) -> Self {
        Self { due: now, since: None, watched: false }
    }

    /// Makes the next one due at `now`.
    pub(crate) fn hasten(&mut self, now: Instant) {
        self.due = now;
    }

    pub(crate) fn is_due(&self, now: Instant) -> bool {
        now >= self.due
    }

    /// The port was offered a heartbeat; whether it was taken.
    pub(crate) fn offered(&mut self, now: Instant, taken: bool, period: Duration) {
        if taken {
            self.due = now + period;
            self.since = Some(now);
            self.watched = true;
        } else {
            self.since.get_or_insert(now);
        }
    }

    /// How long the drives have heard none, if that is longer than `allowed`.
    pub(crate) fn missing(&self, now: Instant, allowed: Duration) -> Option<Duration> {
        let waited = now.since(self.since?);
        (waited > allowed).then_some(waited)
    }
}
