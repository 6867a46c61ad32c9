//! A learnt quantile of durations.

use std::time::Duration;

/// One in this many observations exceeds the learnt bound.
const RARE: u32 = 1000;
/// Number of too long observations in a row that raise the bound from zero to its ceiling.
const RISES: u32 = 32;

/// A bound, learnt from durations as they are observed, that all but about one in 1000 keep within.
///
/// An observation above the bound raises the bound by a fixed step. Every other observation lowers the bound by a
/// thousandth of the step. The bound follows a host that slows down within some tens of observations, and a host that
/// recovers within some ten thousand. One observation moves the bound by one step at most, however long the observation
/// was.
#[derive(Clone, Copy, Debug)]
pub(super) struct LearntQuantile {
    value: Duration,
    ceiling: Duration,
}

impl LearntQuantile {
    /// A bound that starts at `value` and never exceeds `ceiling`.
    pub(super) fn new(value: Duration, ceiling: Duration) -> Self {
        let value = value.min(ceiling);
        Self { value, ceiling }
    }

    pub(super) fn observe(&mut self, observed: Duration) {
        let rise = (self.ceiling / RISES).max(Duration::from_nanos(1));
        self.value = if observed > self.value {
            (self.value + rise).min(self.ceiling)
        } else {
            let fall = (rise / RARE).max(Duration::from_nanos(1));
            self.value.saturating_sub(fall)
        };
    }

    pub(super) fn get(&self) -> Duration {
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CEILING: Duration = Duration::from_micros(200);

    /// Durations from 20 µs up, of which one in 100 exceeds 66 µs and one in 1000 exceeds 89 µs.
    fn latencies(mut seed: u64) -> impl Iterator<Item = Duration> {
        std::iter::repeat_with(move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let uniform = ((seed >> 11) as f64 + 1.0) / (1u64 << 53) as f64;
            Duration::from_secs_f64(20e-6 - 10e-6 * uniform.ln())
        })
    }

    #[test]
    fn about_one_in_a_thousand_exceeds_what_is_learnt() {
        let mut learnt = LearntQuantile::new(CEILING, CEILING);
        let mut exceeding = 0;
        for (count, latency) in latencies(1).take(140_000).enumerate() {
            exceeding += u32::from(count >= 40_000 && latency > learnt.get());
            learnt.observe(latency);
        }
        assert!((80..120).contains(&exceeding), "{exceeding}");
        let micros = learnt.get().as_micros();
        assert!((80..105).contains(&micros), "{micros}");
    }

    #[test]
    fn it_rises_within_tens_and_falls_within_ten_thousands() {
        let mut learnt = LearntQuantile::new(Duration::ZERO, CEILING);
        let long = CEILING * 7 / 10;
        let mut observe = |duration, count| {
            (0..count).for_each(|_| learnt.observe(duration));
            learnt.get()
        };
        assert!(observe(long, 22) < long);
        assert!(observe(long, 2) >= long);
        let short = Duration::from_micros(10);
        assert!(observe(short, 1000) > long * 9 / 10);
        assert!(observe(short, 30_000) < short * 2);
    }

    #[test]
    fn one_outlier_moves_it_by_one_step_and_none_beyond_the_ceiling() {
        let mut learnt = LearntQuantile::new(Duration::ZERO, CEILING);
        learnt.observe(Duration::MAX);
        assert_eq!(learnt.get(), CEILING / RISES);
        (0..100).for_each(|_| learnt.observe(Duration::MAX));
        assert_eq!(learnt.get(), CEILING);
        assert_eq!(LearntQuantile::new(Duration::MAX, CEILING).get(), CEILING);
    }

    #[test]
    fn a_ceiling_of_nothing_teaches_nothing() {
        let mut learnt = LearntQuantile::new(CEILING, Duration::ZERO);
        learnt.observe(CEILING);
        assert_eq!(learnt.get(), Duration::ZERO);
    }
}
