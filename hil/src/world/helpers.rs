//! Threads that share the work of an advance.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::{hint, io};

use rayon::{Scope, ThreadPool, ThreadPoolBuilder, Yield};

/// Threads that help a thread to advance a [`World`](crate::World).
///
/// Only robots that cannot influence each other are shared out.
///
/// A helper waits for work without sleeping, and occupies a processor until this value is dropped. A helper that slept
/// would wake later than an advance lasts.
pub struct Helpers {
    pool: ThreadPool,
    over: Arc<AtomicBool>,
}

impl Helpers {
    /// Iterations between two looks for work.
    const PAUSE: u32 = 20;

    /// Starts `count` helpers of the calling thread. Fails if the thread has had helpers before, or if a thread cannot be
    /// started.
    pub fn of_this_thread(count: usize) -> io::Result<Self> {
        let pool = ThreadPoolBuilder::new().num_threads(count + 1).use_current_thread();
        let pool = pool.thread_name(|number| format!("helper-{number}")).build().map_err(io::Error::other)?;
        let over = Arc::new(AtomicBool::new(false));
        let told = over.clone();
        pool.spawn_broadcast(move |thread| {
            // Number 0 is the thread that is helped. It looks at its broadcasts when it waits for helpers.
            while thread.index() > 0 && !told.load(Ordering::Relaxed) {
                if rayon::yield_now() == Some(Yield::Idle) {
                    (0..Self::PAUSE).for_each(|_| hint::spin_loop());
                }
            }
        });
        Ok(Self { pool, over })
    }

    /// Runs jobs on all threads, and waits for their end.
    pub(super) fn share<'a>(&self, jobs: impl IntoIterator<Item: FnOnce() + Send + 'a> + Send) {
        self.pool.scope(|scope: &Scope<'a>| {
            for job in jobs {
                scope.spawn(move |_| job());
            }
        });
    }
}

impl Drop for Helpers {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}
