//! Threads that share the work of an advance.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::{hint, io, iter};

use rayon_core::{ThreadPool, ThreadPoolBuilder, Yield};

/// Threads that help a thread to advance a [`World`](crate::World).
///
/// The threads share only robots, buses and lines that cannot influence each other.
///
/// A helper waits for work without sleeping, and occupies a processor until this value is dropped. To wake a sleeping
/// helper would take longer than an advance. More threads than processors make an advance slower.
pub struct Helpers {
    pool: ThreadPool,
    over: Arc<AtomicBool>,
}

impl Helpers {
    /// Iterations of the spin loop between two checks for work.
    const PAUSE: u32 = 20;

    /// Starts `count` helpers of the calling thread. Fails if the thread has had helpers before, or if a thread cannot be
    /// started.
    pub fn of_this_thread(count: usize) -> io::Result<Self> {
        let pool = ThreadPoolBuilder::new().num_threads(count + 1).use_current_thread();
        let pool = pool.thread_name(|number| format!("helper-{number}")).build().map_err(io::Error::other)?;
        let over = Arc::new(AtomicBool::new(false));
        let told = over.clone();
        pool.spawn_broadcast(move |thread| {
            // Thread 0 is the helped thread. This thread executes the closure while it waits for helpers, and must
            // leave the closure at once.
            while thread.index() > 0 && !told.load(Ordering::Relaxed) {
                if rayon_core::yield_now() == Some(Yield::Idle) {
                    (0..Self::PAUSE).for_each(|_| hint::spin_loop());
                }
            }
        });
        let helpers = Self { pool, over };
        // Thread 0 executes its closure here. The helpers then end even if no work is ever shared.
        helpers.pool.broadcast(|_| ());
        Ok(helpers)
    }

    /// Number of threads, including the helped thread.
    pub(super) fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Lets the threads advance all items of the shares, and waits until all items are done. `shares` has one element for
    /// each thread. The helped thread first does `work`. Each thread begins with the items of its own share. A thread that
    /// has finished takes items of other shares, from the last one on: the host may have given the processor of another
    /// thread to another program. Any other calling thread does `work` and all shares alone.
    pub(super) fn share<T: Send>(&self, shares: Vec<VecDeque<T>>, work: impl FnOnce(), advance: impl Fn(T) + Sync) {
        if self.pool.current_thread_index() != Some(0) {
            // The pool would wait for the share of thread 0, but thread 0 executes shares only in its own calls.
            work();
            shares.into_iter().flatten().for_each(advance);
            return;
        }
        let shares: Vec<_> = shares.into_iter().map(Mutex::new).collect();
        let locked = |thread: usize| shares[thread].lock().unwrap_or_else(PoisonError::into_inner);
        let help = || {
            let own = rayon_core::current_thread_index().unwrap_or(0);
            let of_others = || (0..shares.len()).find_map(|other| locked(other).pop_back());
            let next = || {
                // The lock is free again before another share is locked.
                let mine = locked(own).pop_front();
                mine.or_else(of_others)
            };
            iter::from_fn(next).for_each(&advance);
        };
        self.pool.in_place_scope(|scope| {
            (1..shares.len()).for_each(|_| scope.spawn(|_| help()));
            work();
            help();
        });
    }
}

impl Drop for Helpers {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread;
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_thread_without_work_takes_over_what_another_has_not_begun() {
        // A thread has helpers once, so the helped thread is a new one.
        let helped = thread::spawn(|| {
            let helpers = Helpers::of_this_thread(1).unwrap();
            let (tell, told) = mpsc::channel();
            let told = Mutex::new(told);
            // Both items are in the share of the helper. The first one ends after the second one.
            let shares = vec![VecDeque::new(), VecDeque::from([0, 1])];
            let done = Mutex::new(Vec::new());
            let advance = |item| {
                done.lock().unwrap().push(item);
                match item {
                    0 => told.lock().unwrap().recv_timeout(Duration::from_secs(20)).unwrap(),
                    _ => tell.send(()).unwrap(),
                }
            };
            helpers.share(shares, || {}, advance);
            let mut done = done.into_inner().unwrap();
            done.sort_unstable();
            assert_eq!(done, [0, 1]);
        });
        helped.join().unwrap();
    }
}
