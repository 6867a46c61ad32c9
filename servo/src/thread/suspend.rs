//! Suspension of the machine: `CLOCK_MONOTONIC`, the clock of the deadlines, stops during a suspension, and
//! `CLOCK_BOOTTIME` continues.

use std::time::Duration;

use can::Instant;

/// The distance between both clocks.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SuspendWatch {
    /// Time by which `CLOCK_BOOTTIME` is ahead, ns; `None` before the first reading.
    ahead: Option<u64>,
}

impl SuspendWatch {
    /// Takes a reading of `CLOCK_BOOTTIME` between two readings of `CLOCK_MONOTONIC`. Returns for how long the machine was
    /// suspended since the last reading. A delay between the readings changes nothing: the distance is kept unless the
    /// readings refute it.
    pub(super) fn observe(&mut self, before: Instant, boot: Instant, after: Instant) -> Duration {
        let boot = boot.as_nanos();
        let (least, most) = (boot.saturating_sub(after.as_nanos()), boot.saturating_sub(before.as_nanos()));
        let known = self.ahead.unwrap_or(least);
        self.ahead = Some(known.clamp(least, most));
        Duration::from_nanos(least.saturating_sub(known))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_suspension_counts_and_it_counts_once() {
        let at = |micros: u64| Instant::from_nanos(micros * 1_000);
        let mut watch = SuspendWatch::default();
        // Readings in µs of the three clocks, and the suspension.
        let readings = [
            // An earlier suspension of 50 s.
            ((1_000, 50_001_000, 1_001), 0),
            ((3_000, 50_003_001, 3_001), 0),
            // The thread is preempted before, and then behind, the second reading.
            ((5_000, 50_005_900, 5_900), 0),
            ((7_000, 50_007_000, 7_900), 0),
            // Two seconds of suspension between two cycles.
            ((9_000, 52_009_000, 9_001), 1_999_999),
            ((11_000, 52_011_000, 11_001), 0),
            // A suspension between the readings is noticed at once, or in the next cycle.
            ((13_000, 53_013_000, 13_001), 999_999),
            ((15_000, 53_015_000, 15_001), 0),
        ];
        for ((before, boot, after), expected) in readings {
            let asleep = watch.observe(at(before), at(boot), at(after)).as_micros();
            assert!(asleep.abs_diff(expected) <= 2, "{before} {boot} {after}: {asleep}");
        }
    }
}
