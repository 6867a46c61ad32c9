//! Histogram of durations.

use std::{fmt, time::Duration};

/// A histogram of durations from 1 ns to 10 s in three significant digits.
///
/// All memory is allocated at the start, and recording neither allocates nor resizes. Durations above 10 s count as 10
/// s. The number of these durations and the exact maximum are kept.
#[derive(Clone)]
pub struct Histogram {
    counts: hdrhistogram::Histogram<u64>,
    /// Number of durations above [`LONGEST`], and the longest of them.
    beyond: (u64, Duration),
}

const LONGEST: u64 = 10_000_000_000;

impl Histogram {
    /// Counts one duration.
    pub fn record(&mut self, duration: Duration) {
        let nanos = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        self.counts.saturating_record(nanos.min(LONGEST));
        if nanos > LONGEST {
            self.beyond = (self.beyond.0 + 1, self.beyond.1.max(duration));
        }
    }

    /// Number of recorded durations.
    pub fn count(&self) -> u64 {
        self.counts.len()
    }

    /// The duration that the fraction `quantile`, 0 ..= 1, of all recorded durations does not exceed; zero without
    /// records.
    pub fn quantile(&self, quantile: f64) -> Duration {
        Duration::from_nanos(self.counts.value_at_quantile(quantile))
    }

    /// The longest recorded duration, also above 10 s; zero without records.
    pub fn max(&self) -> Duration {
        Duration::from_nanos(self.counts.max()).max(self.beyond.1)
    }

    /// Number of recorded durations above 10 s.
    pub fn beyond(&self) -> u64 {
        self.beyond.0
    }

    /// The mean of the recorded durations; zero without records.
    pub fn mean(&self) -> Duration {
        Duration::from_nanos(self.counts.mean() as u64)
    }

    /// Each occupied bin's longest duration and its count, ascending.
    pub fn bins(&self) -> impl Iterator<Item = (Duration, u64)> {
        self.counts.iter_recorded().map(|bin| (Duration::from_nanos(bin.value_iterated_to()), bin.count_at_value()))
    }
}

/// An empty histogram of about 200 kB.
impl Default for Histogram {
    fn default() -> Self {
        let histogram = hdrhistogram::Histogram::new_with_bounds(1, LONGEST, 3);
        let counts = histogram.expect("the bounds are constants that the library accepts");
        Self { counts, beyond: (0, Duration::ZERO) }
    }
}

/// Count, median, tails and maximum on one line.
impl fmt::Debug for Histogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [median, p99, p999] = [0.5, 0.99, 0.999].map(|quantile| self.quantile(quantile));
        write!(f, "{} × p50 {median:?} ", self.count())?;
        write!(f, "p99 {p99:?} p99.9 {p999:?} max {:?}", self.max())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_what_was_recorded() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.max(), Duration::ZERO);
        (1..=1000).for_each(|micros| histogram.record(Duration::from_micros(micros)));
        for (quantile, micros) in [(0.5, 500.0), (0.99, 990.0), (1.0, 1000.0)] {
            let found = histogram.quantile(quantile).as_secs_f64() * 1e6;
            assert!((found / micros - 1.0).abs() < 2e-3, "{quantile}: {found}");
        }
        assert_eq!(histogram.bins().map(|bin| bin.1).sum::<u64>(), 1000);
    }

    #[test]
    fn what_is_out_of_bounds_is_counted_at_the_bound() {
        let mut histogram = Histogram::default();
        histogram.record(Duration::ZERO);
        histogram.record(Duration::MAX);
        assert_eq!(histogram.count(), 2);
        assert!(histogram.quantile(1.0) >= Duration::from_secs(10));
        assert!(histogram.quantile(1.0) < Duration::from_millis(10_020));
    }

    #[test]
    fn the_maximum_is_true_beyond_the_bound_and_what_is_beyond_is_counted() {
        let mut histogram = Histogram::default();
        for seconds in [1, 10, 14, 12] {
            histogram.record(Duration::from_secs(seconds));
        }
        assert_eq!((histogram.max(), histogram.beyond()), (Duration::from_secs(14), 2));
        assert_eq!(histogram.count(), 4);
    }
}
