//! The tick: lets the controller act once after each servo cycle.
//!
//! The servo thread stores the time at which it sent, and makes no system call for the controller. The controller sleeps
//! until the next cycle is due, and looks again at short intervals while that cycle is late.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use can::{Instant, clock};

/// Longest wait for a cycle. After that the controller looks whether the run has ended.
const PATIENCE: Duration = Duration::from_millis(20);

/// Divisor of the period. The controller looks a period / `LOOKS` after the next cycle is due, then at this interval.
const LOOKS: u32 = 20;

/// Tells a controller that a cycle was sent.
#[derive(Debug)]
pub(super) struct Ticking(Arc<AtomicU64>);

/// Waits for cycles.
#[derive(Debug)]
pub(super) struct Tick {
    /// Time of the last sending, ns.
    sent: Arc<AtomicU64>,
    seen: u64,
    period: Duration,
}

/// Both ends, for cycles of this period.
pub(super) fn tick(period: Duration) -> (Ticking, Tick) {
    let sent = Arc::new(AtomicU64::new(0));
    (Ticking(Arc::clone(&sent)), Tick { sent, seen: 0, period })
}

impl Ticking {
    /// Records that the servo has just sent the set-points of a cycle.
    pub(super) fn sent(&self) {
        self.0.store(clock::now().as_nanos(), Ordering::Release);
    }
}

impl Tick {
    /// Waits for the next cycle. Returns at once if a cycle was sent since the last wait.
    pub(super) fn wait(&mut self) {
        let end = clock::now() + PATIENCE;
        loop {
            let sent = self.sent.load(Ordering::Acquire);
            let now = clock::now();
            if sent != self.seen || now >= end {
                self.seen = sent;
                return;
            }
            let look = self.period / LOOKS;
            let due = Instant::from_nanos(sent) + self.period + look;
            clock::sleep_until(due.max(now + look).min(end));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_that_was_sent_ends_the_wait_and_without_cycles_the_wait_ends_too() {
        let (ticking, mut tick) = tick(Duration::from_secs(3600));
        // The next look comes after an hour. Of many waits the fastest counts, because the host may delay any of them.
        let waits = (0..20).map(|_| {
            ticking.sent();
            let before = clock::now();
            tick.wait();
            clock::now().since(before)
        });
        assert!(waits.min().expect("there are twenty") < PATIENCE / 4);
        let before = clock::now();
        tick.wait();
        assert!(clock::now().since(before) >= PATIENCE);
    }

    #[test]
    fn a_cycle_that_is_sent_during_the_wait_ends_it() {
        let (ticking, mut tick) = tick(Duration::from_millis(2));
        let waits = (0..20).map(|_| {
            ticking.sent();
            tick.wait();
            let before = clock::now();
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    clock::sleep_until(before + Duration::from_millis(2));
                    ticking.sent();
                });
                tick.wait();
            });
            clock::now().since(before)
        });
        let fastest = waits.min().expect("there are twenty");
        assert!(fastest >= Duration::from_millis(2) && fastest < PATIENCE / 2, "{fastest:?}");
    }
}
