//! A servo on the wall clock, together with the emulated world that its cycles advance, if there is one.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can::Instant;
use servo::thread::{self, CellTime, Realtime, Running, StartError};
use servo::{NotUp, Servo, lockstep};

use crate::bench::emulation::Emulation;

/// Brings the drives up. Emulated drives come up in their own time, as fast as possible. Returns that time.
pub fn bring_up(servo: &mut Servo, emulation: &mut Option<Emulation>) -> Result<Option<Instant>, NotUp> {
    match emulation {
        None => thread::bring_up(servo, |_| {}).map(|()| None),
        Some(emulation) => {
            let between = |next| emulation.advance(next);
            lockstep::bring_up(servo, Instant::ZERO, between).map(Some)
        }
    }
}

/// Starts the servo thread of a cell. `emulated_since` is the emulated time at the end of bring-up. `sent` is called
/// after each cycle, before emulated drives advance.
pub fn start(
    servo: Servo,
    mut emulation: Option<Emulation>,
    emulated_since: Option<Instant>,
    realtime: Realtime,
    trace_request: Arc<AtomicBool>,
    mut sent: impl FnMut() + Send + 'static,
    until: impl FnMut(&Servo) -> bool + Send + 'static,
) -> Result<Running, StartError> {
    let time = emulated_since.map_or(CellTime::Wall, CellTime::Nominal);
    let between = move |next| {
        sent();
        if let Some(emulation) = &mut emulation {
            emulation.advance(next);
        }
    };
    thread::start(servo, realtime, time, trace_request, between, until)
}
