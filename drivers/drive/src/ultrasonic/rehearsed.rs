//! An ultrasonic matrix of a rehearsal: no wire and no echo.

use std::time::Duration;

use can::Instant;
use serial::ultrasonic::NO_ECHO;

use super::state::{Scan, StatePublisher, UltrasonicLink, UltrasonicState};

/// A matrix without a wire, for the ideal drives of a rehearsal. The matrix completes scans at their rate, and receives no
/// echo: a rehearsal has no surroundings.
pub struct RehearsedUltrasonic {
    state: UltrasonicState,
    publisher: StatePublisher,
    scan_time: Duration,
}

impl RehearsedUltrasonic {
    /// A matrix in operation that completes a scan every `scan_time`, and the controller's end of it.
    pub fn new(scan_time: Duration) -> (Self, UltrasonicLink) {
        let (mut publisher, _, link) = UltrasonicLink::new();
        let state = UltrasonicState { fault: None, ..UltrasonicState::NOT_STARTED };
        publisher.publish(&state.words());
        (Self { state, publisher, scan_time }, link)
    }

    /// Completes a scan at `now`, for benchmarks: `echo` gives the echo time of each shot and number ([`Scan::echo`]).
    pub fn scan(&mut self, now: Instant, echo: impl Fn(usize, usize) -> Option<Duration>) {
        let scan = &mut self.state.scan;
        (scan.number, scan.ended) = (scan.number + 1, now);
        for (shot, times) in scan.times.iter_mut().enumerate() {
            for (number, time) in times.iter_mut().enumerate() {
                *time = echo(shot, number).map_or(NO_ECHO, |echo| echo.as_micros() as u16);
            }
        }
        self.advance(now);
    }

    /// Advances the matrix by one cycle, to `now`.
    pub fn advance(&mut self, now: Instant) {
        let state = &mut self.state;
        if now.since(state.scan.ended) >= self.scan_time {
            state.scan = Scan { number: state.scan.number + 1, ended: now, ..Scan::NONE };
        }
        state.at = now;
        self.publisher.publish(&state.words());
        state.cycle += 1;
    }
}
