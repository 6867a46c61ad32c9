//! Motion time since the last report of the servo. Motion time does not advance in a pause.

use std::time::Duration;

use can::Instant;

/// Motion time since the last report: an upper bound.
#[derive(Default)]
pub(super) struct SinceReport {
    passed: Duration,
    /// Time of the last counted cycle, and the rate of motion time at the end of this cycle.
    counted: Instant,
    rate: f64,
}

impl SinceReport {
    /// Counts from a report of the cycle at `at`.
    pub(super) fn restart(&mut self, at: Instant) {
        self.passed = self.counted.since(at);
        self.counted = self.counted.max(at);
    }

    /// Counts up to the cycle at `now`. `rate`: rate of motion time at the end of this cycle.
    pub(super) fn count(&mut self, now: Instant, rate: f64) {
        self.passed += now.since(self.counted).mul_f64(self.rate.max(rate).clamp(0.0, 1.0));
        (self.counted, self.rate) = (self.counted.max(now), rate);
    }

    /// Motion time up to the last cycle counted.
    pub(super) fn passed(&self) -> Duration {
        self.passed
    }
}
