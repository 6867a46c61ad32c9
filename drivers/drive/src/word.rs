//! Words that drivers and cycle laws take from other threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A word that other threads set and that the servo thread takes, for a recording and its replay.
///
/// The driver stores what it takes in [`taken`](Self::taken), in the cycle in which the value takes effect. A replay sets
/// the same value before the same cycle.
pub struct Word {
    /// The value taken last. Only the servo thread writes it.
    pub taken: Arc<AtomicU64>,
    /// Sets the value that the next cycle takes.
    pub repeat: Box<dyn FnMut(u64) + Send>,
}

/// A request that the servo thread takes, and the number of requests taken.
#[derive(Clone, Debug, Default)]
pub(crate) struct Request {
    pending: Arc<AtomicBool>,
    taken: Arc<AtomicU64>,
}

impl Request {
    /// Requests, without waiting.
    pub(crate) fn request(&self) {
        self.pending.store(true, Ordering::Release);
    }

    /// Whether there was a request since the last call.
    pub(crate) fn take(&self) -> bool {
        let pending = self.pending.load(Ordering::Acquire) && self.pending.swap(false, Ordering::AcqRel);
        if pending {
            self.taken.fetch_add(1, Ordering::Relaxed);
        }
        pending
    }

    /// The number of requests taken. Every change repeats a request.
    pub(crate) fn word(&self) -> Word {
        let request = self.clone();
        Word { taken: Arc::clone(&self.taken), repeat: Box::new(move |_| request.request()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_taken_once_and_repeated_by_its_word() {
        let request = Request::default();
        assert!(!request.take());
        request.request();
        assert!(request.take() && !request.take());
        let mut word = request.word();
        assert_eq!(word.taken.load(Ordering::Relaxed), 1);
        (word.repeat)(1);
        assert!(request.take());
    }
}
