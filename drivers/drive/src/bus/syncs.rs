//! The SYNCs of a bus, and the SYNC that an answer belongs to.

use can::Instant;

/// The SYNCs sent to which answers may still arrive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Syncs {
    pub(crate) last: Option<Instant>,
    before: Option<Instant>,
    /// The last cycle had to send a SYNC.
    pub(crate) attempted: bool,
    /// The port took the SYNC of the last cycle.
    pub(crate) sent: bool,
}

impl Syncs {
    /// The SYNC that an answer received at `at` belongs to: the last one sent before the answer. `None` if the answer
    /// is older than the last two SYNCs.
    pub(crate) fn of_answer(&self, at: Instant) -> Option<Instant> {
        [self.last, self.before].into_iter().flatten().find(|sync| at >= *sync)
    }

    pub(crate) fn send(&mut self, now: Instant, sent: bool) {
        self.attempted = true;
        self.sent = sent;
        if sent {
            self.before = self.last.replace(now);
        }
    }
}
