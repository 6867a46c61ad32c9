//! Count of the turns of a task, for a thread that watches the task.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Count of the turns of one task and of the polls of its agents. Clones share the counts.
///
/// A task that blocks or never awaits does not return from its turn, and a generator that blocks does not return from a
/// poll. The counts let another thread detect such a block. The blocked thread cannot be ended.
#[derive(Clone, Debug, Default)]
pub struct Turns(Arc<[AtomicU64; 2]>);

/// Kinds of work that [`Turns`] counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// The turns of the task.
    Task,
    /// The polls of the agents, which execute steps of generators.
    Steps,
}

impl Turns {
    /// An odd number that identifies the turn or poll in progress; `None` between them.
    pub fn in_progress(&self, work: Work) -> Option<u64> {
        Some(self.0[work as usize].load(Ordering::Relaxed)).filter(|count| count % 2 == 1)
    }

    /// Calls `turn`, and counts it.
    pub(super) fn count<T>(&self, work: Work, turn: impl FnOnce() -> T) -> T {
        let count = &self.0[work as usize];
        count.fetch_add(1, Ordering::Relaxed);
        let done = turn();
        count.fetch_add(1, Ordering::Relaxed);
        done
    }
}
