//! The cabinet that drives stand in, with one emergency stop for all of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use can::Instant;

/// Drives whose power goes through one emergency stop, which is open while any of them is in error.
/// Clones are the same cabinet, and its drives are of one world.
#[derive(Clone, Debug, Default)]
pub struct Cabinet(Arc<Stop>);

/// One thread moves all drives of a world, so that no order between the two matters.
#[derive(Debug, Default)]
struct Stop {
    /// Drives in error.
    in_error: AtomicU32,
    /// When it opened or closed last, ns.
    changed: AtomicU64,
}

impl Cabinet {
    /// Takes note that a drive is in error from `now` on.
    pub(super) fn enter_error(&self, now: Instant) {
        if self.0.in_error.fetch_add(1, Ordering::Relaxed) == 0 {
            self.change(now);
        }
    }

    /// Takes note that a drive that was in error is so no more.
    pub(super) fn leave_error(&self, now: Instant) {
        if self.0.in_error.fetch_sub(1, Ordering::Relaxed) == 1 {
            self.change(now);
        }
    }

    fn change(&self, now: Instant) {
        self.0.changed.store(now.as_nanos(), Ordering::Relaxed);
    }

    /// Whether the stop is open at `at`. A lagging drive asks for the past: the cabinet knows it back to the last
    /// change but one.
    pub(super) fn is_open(&self, at: Instant) -> bool {
        let open = self.0.in_error.load(Ordering::Relaxed) > 0;
        let changed = self.0.changed.load(Ordering::Relaxed);
        open == (at.as_nanos() >= changed)
    }
}
