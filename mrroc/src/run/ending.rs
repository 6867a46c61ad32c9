//! The end of a run: requests to a run under way, and the servo thread, braked and joined however the run ends. A servo
//! thread that hangs is left behind.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use std::time::Duration;

use can::{Instant, clock};
use servo::thread::{Finished, POWER_OFF_WAIT, Running};
use servo::{Servo, SpeedOverride, StopRequest};

use super::crew::Crew;
use super::watch::{ServoHang, ServoWatch};
#[cfg(feature = "recording")]
use crate::recording::FlightRequest;

/// Requests to a run, from a signal handler or another thread.
#[derive(Clone, Debug, Default)]
pub struct Requests {
    /// The end of the run.
    pub(super) stop: Arc<AtomicBool>,
    /// Set to keep the servo cycles around this moment (`--spikes`).
    pub spikes: Arc<AtomicBool>,
    /// Set to write the last seconds ([`RunOptions::flight`](super::RunOptions::flight)).
    #[cfg(feature = "recording")]
    pub flight: FlightRequest,
    /// Speed of all motion by the operator: override, pause and resume. A task can slow further, and cannot lift it.
    pub speed: SpeedOverride,
    servo: Arc<Mutex<Option<StopRequest>>>,
    /// The threads of the run.
    pub(crate) crew: Crew,
}

impl Requests {
    /// Requests to a run that ends once `stop` is set.
    pub(crate) fn stopped_by(stop: &Arc<AtomicBool>) -> Self {
        Self { stop: Arc::clone(stop), ..Self::default() }
    }

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

/// Time between two looks at a servo thread that is to end.
const END_LOOK: Duration = Duration::from_millis(1);

/// A servo thread that is stopped in order and waited for when this is dropped, by a panic too. A thread that hangs is
/// left behind: no set-point leaves it any more, and it ends with the process.
pub struct Turning {
    servo: State,
    over: Arc<AtomicBool>,
    stop: StopRequest,
    watch: ServoWatch,
}

enum State {
    Running(Running),
    Left(ServoHang),
    Joined,
}

impl Turning {
    /// A servo thread that ends once `over` is set, and brakes by `stop`. The thread hangs if no cycle ends for
    /// `limit`: see [`hang_limit`](super::hang_limit).
    pub fn of(running: Running, over: Arc<AtomicBool>, stop: StopRequest, limit: Duration) -> Self {
        Self { servo: State::Running(running), over, stop, watch: ServoWatch::of(limit, clock::now()) }
    }

    /// Whether the servo thread has ended, or hangs and was left behind. With calls less often than every 100 ms, a
    /// hang is found later.
    pub fn is_over(&mut self) -> bool {
        let State::Running(running) = &self.servo else {
            return true;
        };
        if running.is_finished() {
            return true;
        }
        let Err(hang) = self.watch.look(running.cycles(), clock::now()) else {
            return false;
        };
        self.over.store(true, Ordering::Relaxed);
        self.stop.request();
        if let State::Running(running) = std::mem::replace(&mut self.servo, State::Left(hang)) {
            running.leave();
        }
        true
    }

    /// Stops the servo thread in order and waits for its end, unless it hangs.
    pub fn end(mut self) -> Result<Finished, ServoHang> {
        self.join().expect("it is joined once")
    }

    fn join(&mut self) -> Option<Result<Finished, ServoHang>> {
        self.over.store(true, Ordering::Relaxed);
        while !self.is_over() {
            clock::sleep_until(clock::now() + END_LOOK);
        }
        match std::mem::replace(&mut self.servo, State::Joined) {
            State::Running(running) => Some(Ok(running.join())),
            State::Left(hang) => Some(Err(hang)),
            State::Joined => None,
        }
    }
}

impl Drop for Turning {
    fn drop(&mut self) {
        let _ = self.join();
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
