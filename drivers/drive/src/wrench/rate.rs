//! Comparison of the rate of samples with the declared rate.

use std::time::Duration;

use can::Instant;

/// Samples of one comparison in operation.
const SAMPLES: u32 = 64;

/// Samples of the comparison that ends bring-up.
const FIRST_SAMPLES: u32 = 16;

/// Divisor of the tolerance: the period of the samples may differ from the declared period by at most a quarter.
const TOLERANCE: u32 = 4;

/// Cause of the samples, and their period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pace {
    /// Every n-th request: a query, or a SYNC. Requests are `period` apart.
    Requested { every: u32, period: Duration },
    /// The sensor's own clock. The host reads once per `period`.
    Own { declared: Duration, period: Duration },
}

impl Pace {
    /// Declared time between two samples.
    pub(super) fn declared(self) -> Duration {
        match self {
            Self::Requested { every, period } => period * every,
            Self::Own { declared, .. } => declared,
        }
    }

    /// Cycles without a sample after which more than `tolerated` samples in a row are missing.
    pub(super) fn silent_after(self, tolerated: u32) -> u32 {
        let due = tolerated.saturating_add(1);
        match self {
            Self::Requested { every, .. } => due.saturating_mul(every),
            Self::Own { declared, period } => {
                let cycles = (declared.as_nanos() * u128::from(due)).div_ceil(period.as_nanos().max(1));
                // A sample is read up to a period after its reception.
                u32::try_from(cycles).unwrap_or(u32::MAX).saturating_add(1)
            }
        }
    }

    /// Time that the comparison of bring-up takes at the declared rate.
    pub(super) fn first_comparison(self) -> Duration {
        match self {
            Self::Requested { .. } => self.declared() * FIRST_SAMPLES,
            Self::Own { declared, period } => declared.max(period) * FIRST_SAMPLES,
        }
    }
}

/// Result of a comparison with the declared rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Comparison {
    /// The mean period agrees with the declared period.
    Agrees,
    /// Most samples follow their predecessor by the declared period, but too many samples are missing.
    Missing { missing: u32, of: u32 },
    /// The mean period, which differs from the declared period.
    Differs { found: Duration },
}

/// Count of the samples of a comparison.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rate {
    pace: Pace,
    /// Samples of this comparison at the declared rate.
    length: u32,
    requests: u32,
    samples: u32,
    /// Number of samples that followed their predecessor by the declared period.
    regular: u32,
    /// Number of requests up to the last sample.
    answered: u32,
    /// Times of the first and the last sample.
    first: Instant,
    last: Instant,
}

impl Rate {
    /// The comparison that ends bring-up.
    pub(super) fn first(pace: Pace) -> Self {
        Self::of(pace, FIRST_SAMPLES)
    }

    /// The comparisons in operation.
    pub(super) fn new(pace: Pace) -> Self {
        Self::of(pace, SAMPLES)
    }

    fn of(pace: Pace, length: u32) -> Self {
        Self {
            pace,
            length,
            requests: 0,
            samples: 0,
            regular: 0,
            answered: 0,
            first: Instant::ZERO,
            last: Instant::ZERO,
        }
    }

    /// Counts a request whose answer is due by now.
    pub(super) fn requested(&mut self) {
        self.requests += 1;
    }

    /// Counts a sample with the time `at`.
    pub(super) fn sampled(&mut self, at: Instant) {
        if self.samples == 0 {
            self.first = at;
        }
        let declared = self.pace.declared();
        self.regular += u32::from(match self.pace {
            Pace::Requested { every, .. } => self.requests - self.answered == every,
            Pace::Own { .. } => self.samples > 0 && at.since(self.last).abs_diff(declared) <= declared / TOLERANCE,
        });
        (self.last, self.answered) = (at, self.requests);
        self.samples += 1;
    }

    /// Mean time between two samples so far. `None` without a sample, or with less than two samples of a sensor with
    /// its own clock.
    pub(super) fn found(&self) -> Option<Duration> {
        match self.pace {
            Pace::Requested { period, .. } => (self.samples > 0).then(|| period * self.requests / self.samples),
            Pace::Own { .. } => (self.samples > 1).then(|| self.last.since(self.first) / (self.samples - 1)),
        }
    }

    /// Ends the comparison if it has enough requests or samples, and begins the next.
    pub(super) fn compare(&mut self) -> Option<Comparison> {
        let complete = match self.pace {
            Pace::Requested { every, .. } => self.requests >= self.length.saturating_mul(every),
            // The time of a sample may be the time of its reading, which is up to a period late.
            Pace::Own { period, .. } => {
                self.samples > self.length && self.last.since(self.first) >= period * self.length
            }
        };
        if !complete {
            return None;
        }
        let declared = self.pace.declared();
        // A comparison without a sample passes here: the count of missing samples detects silence.
        let found = self.found().unwrap_or(declared);
        let due = match self.pace {
            Pace::Requested { every, .. } => self.requests / every,
            Pace::Own { .. } => {
                let periods = self.last.since(self.first).as_secs_f64() / declared.as_secs_f64();
                periods.round() as u32 + 1
            }
        };
        let ended = std::mem::replace(self, Self::of(self.pace, self.length));
        Some(if found.abs_diff(declared) <= declared / TOLERANCE {
            Comparison::Agrees
        } else if found > declared && 2 * ended.regular > ended.samples {
            Comparison::Missing { missing: due.saturating_sub(ended.samples), of: due }
        } else {
            Comparison::Differs { found }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(2);

    #[test]
    fn requests_without_a_sample_and_samples_without_a_request_change_the_rate() {
        // Of 64 requests so many gave a sample, or of 16 requests for the first comparison.
        let differs = |samples| Comparison::Differs { found: PERIOD * 64 / samples };
        for (samples, expected) in [
            (64, Comparison::Agrees),
            (52, Comparison::Agrees),
            (51, Comparison::Missing { missing: 13, of: 64 }),
            (43, Comparison::Missing { missing: 21, of: 64 }),
            (32, differs(32)),
            (16, differs(16)),
            (80, Comparison::Agrees),
            (90, differs(90)),
        ] {
            let mut rate = Rate::new(Pace::Requested { every: 1, period: PERIOD });
            for request in 0..64_u32 {
                assert_eq!(rate.compare(), None);
                rate.requested();
                let before = samples * request / 64;
                (before..samples * (request + 1) / 64).for_each(|_| rate.sampled(Instant::ZERO));
            }
            assert_eq!(rate.compare(), Some(expected), "{samples}");
            assert_eq!(rate.compare(), None);
        }
    }

    #[test]
    fn a_sample_every_third_sync_is_compared_over_three_times_as_many_syncs() {
        for (every, right) in [(3, true), (2, false), (4, false), (1, false)] {
            let mut rate = Rate::first(Pace::Requested { every: 3, period: PERIOD });
            let result = (1..=48).find_map(|sync| {
                rate.requested();
                if sync % every == 0 {
                    rate.sampled(Instant::ZERO);
                }
                rate.compare()
            });
            let differs = Comparison::Differs { found: PERIOD * every };
            assert_eq!(result, Some(if right { Comparison::Agrees } else { differs }), "{every}");
        }
    }

    #[test]
    fn a_sensor_with_a_clock_of_its_own_is_compared_by_the_times_of_its_samples() {
        let micros = Duration::from_micros;
        let declared = micros(1_000);
        for (found, right) in [(1_000, true), (1_240, true), (760, true), (1_260, false), (740, false), (100, false)] {
            let mut rate = Rate::first(Pace::Own { declared, period: PERIOD });
            let mut now = Instant::ZERO;
            let result = (0..1_000).find_map(|_| {
                now += micros(found);
                rate.sampled(now);
                rate.compare()
            });
            let differs = Comparison::Differs { found: micros(found) };
            assert_eq!(result, Some(if right { Comparison::Agrees } else { differs }));
            // At least 16 readings, so that a time of reading in place of reception does not count.
            assert!(now.since(Instant::ZERO) >= PERIOD * 16);
        }
    }

    #[test]
    fn missing_samples_of_a_clock_are_counted() {
        let mut rate = Rate::new(Pace::Own { declared: PERIOD, period: PERIOD });
        // Every third sample is missing.
        let result = (1..200).filter(|sample| sample % 3 > 0).find_map(|sample| {
            rate.sampled(Instant::ZERO + PERIOD * sample);
            rate.compare()
        });
        // Every second interval is the declared period, and the first as well.
        assert_eq!(result, Some(Comparison::Differs { found: PERIOD * 3 / 2 }));
        // Every fourth is missing.
        let result = (1..200).filter(|sample| sample % 4 > 0).find_map(|sample| {
            rate.sampled(Instant::ZERO + PERIOD * sample);
            rate.compare()
        });
        assert_eq!(result, Some(Comparison::Missing { missing: 21, of: 86 }));
    }

    #[test]
    fn silence_is_counted_in_samples_that_are_due() {
        let own = |declared| Pace::Own { declared, period: PERIOD };
        let requested = |every| Pace::Requested { every, period: PERIOD };
        for (pace, tolerated, cycles) in [
            (requested(1), 0, 1),
            (requested(1), 3, 4),
            (requested(5), 3, 20),
            (own(PERIOD), 3, 5),
            (own(PERIOD * 5), 1, 11),
            (own(PERIOD / 4), 0, 2),
        ] {
            assert_eq!(pace.silent_after(tolerated), cycles, "{pace:?} {tolerated}");
        }
    }
}
