//! Curves of bounded size over a run of any length.

/// Most buckets of a curve, each with two points; an even number.
const BUCKETS: usize = 2000;

/// Most points of a path.
const POINTS: usize = 4000;

/// A value over time. Each bucket keeps the least and the greatest value of as many samples as the length of the run asks
/// for: no peak is lost.
#[derive(Debug, Default)]
pub(crate) struct Curve {
    buckets: Vec<Bucket>,
    /// How often the samples of a full bucket were doubled, from one.
    doublings: u32,
    /// Samples of the last bucket.
    filled: u64,
}

/// The samples with the least and the greatest value: time, s, and value.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    least: (f64, f64),
    greatest: (f64, f64),
}

impl Bucket {
    fn merge(&mut self, other: Self) {
        if other.least.1 < self.least.1 {
            self.least = other.least;
        }
        if other.greatest.1 > self.greatest.1 {
            self.greatest = other.greatest;
        }
    }
}

impl Curve {
    pub(crate) fn push(&mut self, time: f64, value: f64) {
        let sample = Bucket { least: (time, value), greatest: (time, value) };
        if self.filled < 1 << self.doublings
            && let Some(last) = self.buckets.last_mut()
        {
            last.merge(sample);
            self.filled += 1;
            return;
        }
        if self.buckets.len() == BUCKETS {
            for pair in 0..BUCKETS / 2 {
                let [mut first, second] = [self.buckets[2 * pair], self.buckets[2 * pair + 1]];
                first.merge(second);
                self.buckets[pair] = first;
            }
            self.buckets.truncate(BUCKETS / 2);
            self.doublings += 1;
        }
        self.buckets.push(sample);
        self.filled = 1;
    }

    /// At most 4000 points: time, s, and value.
    #[cfg(any(test, feature = "pages"))]
    pub(crate) fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.buckets.iter().flat_map(|bucket| {
            let [mut first, mut second] = [bucket.least, bucket.greatest];
            if second.0 < first.0 {
                (first, second) = (second, first);
            }
            let two = second.0 > first.0;
            [Some(first), two.then_some(second)].into_iter().flatten()
        })
    }
}

/// Positions along a path, evenly thinned as the run goes on.
#[derive(Debug, Default)]
pub(crate) struct Path {
    points: Vec<[f64; 3]>,
    /// Samples left out between two points, and since the last.
    skipped: u64,
    since: u64,
}

impl Path {
    pub(crate) fn push(&mut self, point: [f64; 3]) {
        if self.since > 0 {
            self.since -= 1;
            return;
        }
        if self.points.len() == POINTS {
            let mut number = 0;
            self.points.retain(|_| {
                number += 1;
                number % 2 == 1
            });
            self.skipped = 2 * self.skipped + 1;
        }
        self.points.push(point);
        self.since = self.skipped;
    }

    #[cfg(any(test, feature = "pages"))]
    pub(crate) fn points(&self) -> &[[f64; 3]] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_of_any_length_has_at_most_4000_points_and_keeps_its_peaks() {
        for samples in [1u32, 10, 4000, 4001, 1_000_003] {
            let (mut curve, mut path) = (Curve::default(), Path::default());
            for number in 0..samples {
                let value = match number {
                    777 => 9.0,
                    778 => -9.0,
                    _ => (f64::from(number) * 0.01).sin(),
                };
                curve.push(f64::from(number), value);
                path.push([f64::from(number), 0.0, 0.0]);
            }
            let points: Vec<_> = curve.points().collect();
            assert!(points.len() <= 4000, "{samples}: {}", points.len());
            assert!(points.is_sorted_by(|one, next| one.0 < next.0));
            for peak in [(777.0, 9.0), (778.0, -9.0)] {
                assert_eq!(points.contains(&peak), samples > 778, "{samples}");
            }
            let path = path.points();
            assert!(path.len() <= 4000 && !path.is_empty(), "{samples}");
            let step = |two: &[[f64; 3]]| two[1][0] - two[0][0];
            let steps: Vec<_> = path.windows(2).map(step).collect();
            assert!(steps.iter().all(|step| *step == steps[0]), "{samples}");
        }
    }
}
