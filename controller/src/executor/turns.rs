//! Count of the turns of a task, for a thread that watches the task.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Count of the turns of one task. Clones share the count.
///
/// A task that blocks or never awaits does not return from its turn, and its thread cannot end the turn.
#[derive(Clone, Debug, Default)]
pub struct Turns(Arc<AtomicU64>);

impl Turns {
    /// An odd number that identifies the turn in progress; `None` between turns.
    pub fn in_progress(&self) -> Option<u64> {
        Some(self.0.load(Ordering::Relaxed)).filter(|count| count % 2 == 1)
    }

    pub(super) fn begin(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn end(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}
