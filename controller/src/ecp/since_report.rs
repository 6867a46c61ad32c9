//! Motion time since the last report of the servo, which stands still in a pause.

use std::time::Duration;

use can::Instant;

/// Motion time since the last report. The time is rather too long than too short.
#[derive(Default)]
pub(super) struct SinceReport {
    passed: Duration,
    /// Time up to which motion time is counted, and the speed of motion time then.
    counted: Instant,
    rate: f64,
}

impl SinceReport {
    /// Counts from a report of the cycle at `at`.
    pub(super) fn restart(&mut self, at: Instant) {
        self.passed = self.counted.since(at);
        self.counted = self.counted.max(at);
    }

    /// Counts up to the cycle at `now`, at whose end motion time has this speed.
    pub(super) fn count(&mut self, now: Instant, rate: f64) {
        self.passed += now.since(self.counted).mul_f64(self.rate.max(rate).clamp(0.0, 1.0));
        (self.counted, self.rate) = (self.counted.max(now), rate);
    }

    /// Motion time up to the last cycle counted.
    pub(super) fn passed(&self) -> Duration {
        self.passed
    }
}
