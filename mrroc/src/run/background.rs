//! A thread beside a run, for work that may be late. The thread waits, but blocks no other thread.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, Thread};
use std::time::Duration;

use super::{SMALL_STACK, crew};

/// A thread that works until this value is dropped, and then has a result.
pub(crate) struct Background<T> {
    over: Arc<AtomicBool>,
    told: Receiver<T>,
    thread: Thread,
}

impl<T: Send + 'static> Background<T> {
    /// Starts thread `name`. The thread calls `work` with `state` at least once per `period`, and `finish` at its end.
    pub(crate) fn start<S: Send + 'static>(
        name: &str,
        period: Duration,
        mut state: S,
        mut work: impl FnMut(&mut S) + Send + 'static,
        finish: impl FnOnce(S) -> T + Send + 'static,
    ) -> io::Result<Self> {
        let over = Arc::new(AtomicBool::new(false));
        let (tell, told) = sync_channel(1);
        let last = over.clone();
        let (crew, member) = (crew::current(), name.to_owned());
        let body = move || {
            let _member = crew::join(crew);
            while !last.load(Ordering::Relaxed) {
                std::thread::park_timeout(period);
                crew::point(&member);
                work(&mut state);
            }
            // The receiver may have stopped waiting.
            let _ = tell.send(finish(state));
        };
        let thread = Builder::new().name(name.to_owned()).stack_size(SMALL_STACK).spawn(body)?;
        Ok(Self { over, told, thread: thread.thread().clone() })
    }

    /// Ends the thread. The result is `None` if the thread does not end within `wait`.
    pub(crate) fn finish(self, wait: Duration) -> Option<T> {
        self.over.store(true, Ordering::Relaxed);
        self.thread.unpark();
        self.told.recv_timeout(wait).ok()
    }
}

impl<T> Drop for Background<T> {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}
