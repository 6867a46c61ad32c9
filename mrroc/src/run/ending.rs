//! The end of a run: requests to a run under way, and the servo thread, braked and joined however the run ends.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use can::Instant;
use servo::thread::{Finished, POWER_OFF_WAIT, Running};
use servo::{Servo, SpeedOverride, StopRequest};

use super::crew::Crew;
use crate::recording::FlightRequest;

/// Requests to a run, from a signal handler or another thread.
#[derive(Clone, Debug, Default)]
pub struct Requests {
    /// The end of the run.
    pub(super) stop: Arc<AtomicBool>,
    /// Set to keep the servo cycles around this moment (`--spikes`).
    pub spikes: Arc<AtomicBool>,
    /// Set to write the last seconds ([`RunOptions::flight`](super::RunOptions::flight)).
    pub flight: FlightRequest,
    /// Speed of all motion by the operator: override, pause and resume. A task can slow further, and cannot lift it.
    pub speed: SpeedOverride,
    servo: Arc<Mutex<Option<StopRequest>>>,
    /// The threads of the run.
    pub(crate) crew: Crew,
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
    over: Arc<AtomicBool>,
}

impl Turning {
    /// A servo thread that ends once `over` is set.
    pub fn of(running: Running, over: Arc<AtomicBool>) -> Self {
        Self { running: Some(running), over }
    }

    /// Whether the servo thread has ended.
    pub fn is_finished(&self) -> bool {
        self.running.as_ref().is_none_or(Running::is_finished)
    }

    /// Stops the servo thread in order and waits for its end.
    pub fn end(mut self) -> Finished {
        self.stop().expect("it is stopped once")
    }

    fn stop(&mut self) -> Option<Finished> {
        self.over.store(true, Ordering::Relaxed);
        self.running.take().map(Running::join)
    }
}

impl Drop for Turning {
    fn drop(&mut self) {
        let _ = self.stop();
    }
}

/// Ends the cycles when it is dropped: the servo thread brakes the arms and switches them off.
pub(super) struct Over(pub(super) Arc<AtomicBool>);

impl Drop for Over {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The end of a servo in lockstep that is stopped once `over` holds: its drives are off, or did not report so in time.
pub fn stopped_once(mut over: impl FnMut() -> bool) -> impl FnMut(&Servo, Instant) -> bool {
    let mut latest = None;
    move |servo, now| {
        if !over() {
            return false;
        }
        let latest = *latest.get_or_insert_with(|| {
            servo.stop_request().request();
            now + servo.longest_stop() + POWER_OFF_WAIT
        });
        servo.is_off() || now >= latest
    }
}
