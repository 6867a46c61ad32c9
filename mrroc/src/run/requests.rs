//! Requests to a run under way: stop, and keep the cycles around this moment.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use servo::StopRequest;

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
