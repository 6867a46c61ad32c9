//! The cabinet of several drives, with one emergency stop for all of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use can::Instant;

/// Drives that share one emergency stop. The stop is open while any of the drives is in error. Clones refer to the
/// same cabinet. All drives of a cabinet belong to one world.
#[derive(Clone, Debug, Default)]
pub struct Cabinet(Arc<Stop>);

/// The order of the two atomics does not matter: one thread moves all drives of a world.
#[derive(Debug, Default)]
struct Stop {
    in_error: AtomicU32,
    /// Time of the last opening or closing, ns.
    changed: AtomicU64,
}

impl Cabinet {
    pub(super) fn enter_error(&self, now: Instant) {
        if self.0.in_error.fetch_add(1, Ordering::Relaxed) == 0 {
            self.change(now);
        }
    }

    pub(super) fn leave_error(&self, now: Instant) {
        if self.0.in_error.fetch_sub(1, Ordering::Relaxed) == 1 {
            self.change(now);
        }
    }

    fn change(&self, now: Instant) {
        self.0.changed.store(now.as_nanos(), Ordering::Relaxed);
    }

    /// Whether the stop is open at `at`, which may be past for a lagging drive, back to the last change but one.
    pub(super) fn is_open(&self, at: Instant) -> bool {
        let open = self.0.in_error.load(Ordering::Relaxed) > 0;
        let changed = self.0.changed.load(Ordering::Relaxed);
        open == (at.as_nanos() >= changed)
    }
}
