//! Late cycles: counts by cause, and the worst.

use std::time::Duration;

use super::Cause;

/// How many late cycles are kept one by one.
const KEPT: usize = 8;

/// One late cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateCycle {
    /// Its number, from 0.
    pub cycle: u64,
    /// When it was due, from the first deadline.
    pub due: Duration,
    /// How late it was.
    pub late: Duration,
    /// Who took the time.
    pub cause: Cause,
}

/// Who made cycles late, and the worst of them. Of fixed size: recording does not allocate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LateCycles {
    counts: [u64; Cause::ALL.len()],
    /// The latest first, then the earlier; none where there were fewer.
    worst: [Option<LateCycle>; KEPT],
}

impl LateCycles {
    /// Counts one, and keeps it if it is among the latest.
    pub fn record(&mut self, late: LateCycle) {
        self.counts[late.cause as usize] += 1;
        self.keep(late);
    }

    /// Counts those of another run as well; the numbers and times of its cycles are its own.
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

    /// How many there were.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// How many each cause made, in the order of [`Cause::ALL`].
    pub fn causes(&self) -> impl Iterator<Item = (Cause, u64)> {
        Cause::ALL.into_iter().zip(self.counts)
    }

    /// The eight latest, the worst first.
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
        let kept = late
            .worst()
            .map(|worst| (worst.late.as_micros(), worst.cycle));
        let expected = [
            (9, 1),
            (9, 6),
            (8, 4),
            (7, 3),
            (6, 9),
            (5, 8),
            (4, 7),
            (3, 0),
        ];
        assert!(kept.eq(expected), "{late:?}");
        assert_eq!(late.count(), 11);
        assert!(
            late.causes()
                .map(|(_, count)| count)
                .eq([2, 2, 2, 2, 1, 1, 1])
        );
        for (place, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause as usize, place, "counts go by the place of a cause");
        }
    }
}
