//! The end of a run: requests to a run under way, and the servo thread, braked and joined however the run ends.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use servo::StopRequest;
use servo::thread::{Finished, Running};

/// Requests to a run, from a signal handler or another thread.
#[derive(Clone, Debug, Default)]
pub struct Requests {
    /// The end of the run.
    pub(super) stop: Arc<AtomicBool>,
    /// The cycles around this moment.
    pub(super) spikes: Arc<AtomicBool>,
    servo: Arc<Mutex<Option<StopRequest>>>,
}

impl Requests {
    /// Ends the run: the servo brakes every robot within its limits and switches it off.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
        let servo = self.servo.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(servo) = &*servo {
            servo.request();
        }
    }

    /// Whether the end of the run was requested.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Set to keep the servo cycles around this moment (`--spikes`).
    pub fn spikes(&self) -> Arc<AtomicBool> {
        self.spikes.clone()
    }

    /// Lets a stop reach the servo of the run that begins.
    pub(super) fn stop_through(&self, servo: StopRequest) {
        if self.is_stopped() {
            servo.request();
        }
        *self.servo.lock().unwrap_or_else(PoisonError::into_inner) = Some(servo);
    }
}

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
