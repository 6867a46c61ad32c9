//! The servo thread of a run, braked and joined however the run ends.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use servo::thread::{Finished, Running};

/// A servo thread that is stopped in order and waited for when this is dropped, by a panic too.
pub struct Turning {
    running: Option<Running>,
    over: Over,
}

impl Turning {
    /// A servo thread that ends once `over` is set.
    pub fn of(running: Running, over: Arc<AtomicBool>) -> Self {
        Self {
            running: Some(running),
            over: Over(over),
        }
    }

    /// Whether the servo thread has ended.
    pub fn is_finished(&self) -> bool {
        self.running.as_ref().is_none_or(Running::is_finished)
    }

    /// Stops the servo thread in order and waits for its end.
    pub fn end(mut self) -> Finished {
        self.over.raise();
        let running = self.running.take();
        running.expect("taken at its end alone").join()
    }
}

impl Drop for Turning {
    fn drop(&mut self) {
        self.over.raise();
        if let Some(running) = self.running.take() {
            let _ = running.join();
        }
    }
}

/// Ends the cycles when it is raised or dropped: the servo thread brakes the arms and switches them off.
pub(super) struct Over(pub(super) Arc<AtomicBool>);

impl Over {
    fn raise(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Drop for Over {
    fn drop(&mut self) {
        self.raise();
    }
}
