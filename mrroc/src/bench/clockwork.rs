//! A servo by the wall clock, with the emulated world that hangs on its cycles where there is one.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can::Instant;
use servo::thread::{self, CellTime, Realtime, Running, StartError};
use servo::{NotUp, Servo, lockstep};

use crate::bench::emulation::Emulation;

/// Brings the drives up. Emulated ones do so in their own time, as fast as they can; returns when that then is.
pub fn bring_up(
    servo: &mut Servo,
    emulation: &mut Option<Emulation>,
) -> Result<Option<Instant>, NotUp> {
    match emulation {
        None => thread::bring_up(servo, |_| {}).map(|()| None),
        Some(emulation) => {
            let between = |next| emulation.advance(next);
            lockstep::bring_up(servo, Instant::ZERO, between).map(Some)
        }
    }
}

/// Starts the servo thread of a cell that is up since `emulated_since` of its emulation's time.
pub fn start(
    servo: Servo,
    emulation: Option<Emulation>,
    emulated_since: Option<Instant>,
    realtime: Realtime,
    trace_request: Arc<AtomicBool>,
    until: impl FnMut(&Servo) -> bool + Send + 'static,
) -> Result<Running, StartError> {
    match emulation.zip(emulated_since) {
        None => thread::start(
            servo,
            realtime,
            CellTime::Wall,
            trace_request,
            |_| {},
            until,
        ),
        Some((mut emulation, first)) => {
            let between = move |next| emulation.advance(next);
            thread::start(
                servo,
                realtime,
                CellTime::Nominal(first),
                trace_request,
                between,
                until,
            )
        }
    }
}
