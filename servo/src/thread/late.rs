//! Late cycles: counts by cause, and the worst cycles.

use std::time::Duration;

use super::Cause;

/// Number of late cycles that are kept individually.
const KEPT: usize = 8;

/// One late cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateCycle {
    /// Number of the cycle, counted from 0.
    pub cycle: u64,
    /// Due time, from the first deadline.
    pub due: Duration,
    /// Lateness.
    pub late: Duration,
    /// Cause of the lateness.
    pub cause: Cause,
}

/// Counts of late cycles by cause, and the worst cycles. The size is fixed: recording does not allocate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LateCycles {
    counts: [u64; Cause::ALL.len()],
    /// The worst cycles in descending order of lateness; the rest is `None`.
    worst: [Option<LateCycle>; KEPT],
}

impl LateCycles {
    /// Counts a late cycle, and keeps it if it is among the worst.
    pub fn record(&mut self, late: LateCycle) {
        self.counts[late.cause as usize] += 1;
        self.keep(late);
    }

    /// Adds the late cycles of another run. Their numbers and times still refer to that run.
    pub fn add(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(other.counts) {
            *count += more;
        }
        other.worst().for_each(|late| self.keep(late));
    }

    fn keep(&mut self, late: LateCycle) {
        let later = |kept: &Option<LateCycle>| kept.is_none_or(|kept| late.late > kept.late);
        if let Some(place) = self.worst.iter().position(later) {
            self.worst[place..].rotate_right(1);
            self.worst[place] = Some(late);
        }
    }

    /// Number of late cycles.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Number of late cycles per cause, in the order of [`Cause::ALL`].
    pub fn causes(&self) -> impl Iterator<Item = (Cause, u64)> {
        Cause::ALL.into_iter().zip(self.counts)
    }

    /// The eight cycles with the greatest lateness, the worst first.
    pub fn worst(&self) -> impl Iterator<Item = LateCycle> {
        self.worst.iter().copied().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_late_cycle_is_counted_and_the_worst_are_kept_in_order() {
        let mut parts = [LateCycles::default(), LateCycles::default()];
        for (cycle, micros) in (0..).zip([3, 9, 1, 7, 8, 2, 9, 4, 5, 6, 1]) {
            parts[usize::from(cycle > 6)].record(LateCycle {
                cycle,
                due: Duration::from_millis(cycle),
                late: Duration::from_micros(micros),
                cause: Cause::ALL[cycle as usize % Cause::ALL.len()],
            });
        }
        let [mut late, more] = parts;
        late.add(&more);
        let kept = late.worst().map(|worst| (worst.late.as_micros(), worst.cycle));
        let expected = [(9, 1), (9, 6), (8, 4), (7, 3), (6, 9), (5, 8), (4, 7), (3, 0)];
        assert!(kept.eq(expected), "{late:?}");
        assert_eq!(late.count(), 11);
        assert!(late.causes().map(|(_, count)| count).eq([2, 2, 2, 2, 1, 1, 1]));
        for (place, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause as usize, place, "counts go by the place of a cause");
        }
    }
}
