//! Quadrature encoder with an index pulse.

use std::f64::consts::TAU;

use super::noise::Noise;

/// A quadrature encoder on the motor shaft with one index pulse per revolution.
///
/// The counter is the floor of angle · counts / 2π, minus that value at power-on. The index pulse is one count wide,
/// and therefore marks the same count in both directions.
///
/// Edge jitter comes with a hysteresis of the same width, as in the comparators behind the disc. The counter leaves a
/// count only beyond the band of the edge. The counter of a turning shaft changes somewhere within the band. The
/// counter of a shaft at standstill does not change.
///
/// A fault of the counter changes the difference between counter and disc. The difference remains at the end of the
/// fault, because an incremental encoder does not know the counts that it lost. The index pulse keeps its place on the
/// disc.
///
/// Counts are whole numbers in `f64`, exact up to 2⁵¹. The counter is read in each sub-step, and integers would need four
/// conversions.
#[derive(Clone, Debug)]
pub(crate) struct Encoder {
    counts_per_radian: f64,
    counts_per_revolution: f64,
    /// Counts from the zero of the disc at which the counter is zero: its position at power-on, until a fault.
    zero: f64,
    jitter: f64,
    /// Counts from the zero of the disc.
    counts: f64,
    /// The nearest index at or below `counts`.
    index_below: f64,
    /// The counter at the last index pulse since the latch was armed.
    pub(super) latched: Option<i32>,
}

impl Encoder {
    pub(crate) fn new(counts_per_revolution: u32, index_angle: f64, jitter: f64, angle: f64) -> Self {
        let counts_per_radian = f64::from(counts_per_revolution) / TAU;
        let counts_per_revolution = f64::from(counts_per_revolution);
        let counts = floor(angle * counts_per_radian);
        let index = floor(index_angle * counts_per_radian);
        Self {
            counts_per_radian,
            counts_per_revolution,
            zero: counts,
            jitter,
            counts,
            index_below: counts - (counts - index).rem_euclid(counts_per_revolution),
            latched: None,
        }
    }

    /// Reads the shaft at `angle`, rad.
    #[inline]
    pub(crate) fn read(&mut self, angle: f64, noise: &mut Noise) {
        let mut at = angle * self.counts_per_radian;
        if self.jitter > 0.0 {
            at += self.jitter * noise.symmetric();
        }
        let before = self.counts;
        // The counter stays within the hysteresis. The comparisons are instructions without branches: a branch on the
        // angle of a moving shaft cannot be predicted.
        let (low, high) = (floor(at - self.jitter), floor(at + self.jitter));
        let above = if before > low { before } else { low };
        self.counts = if above < high { above } else { high };
        while self.counts >= self.index_below + self.counts_per_revolution {
            self.index_below += self.counts_per_revolution;
            self.latch(self.index_below);
        }
        if self.counts <= self.index_below && before > self.index_below {
            self.latch(self.index_below);
        }
        while self.counts < self.index_below {
            self.index_below -= self.counts_per_revolution;
            if self.counts <= self.index_below {
                self.latch(self.index_below);
            }
        }
    }

    fn latch(&mut self, index: f64) {
        self.latched = Some(wrapped(index - self.zero));
    }

    /// Reads the shaft at `angle` while the encoder gives no signal: neither counter nor index latch change.
    #[cold]
    pub(super) fn read_frozen(&mut self, angle: f64, noise: &mut Noise) {
        let (before, latched) = (self.counts, self.latched);
        self.read(angle, noise);
        self.zero += self.counts - before;
        self.latched = latched;
    }

    /// Reads the shaft at `angle` while the encoder counts backwards.
    #[cold]
    pub(super) fn read_inverted(&mut self, angle: f64, noise: &mut Noise) {
        let (before, counter, latched) = (self.counts, self.since_power_on(), self.latched.take());
        self.read(angle, noise);
        self.zero += 2.0 * (self.counts - before);
        // The counter at the index pulse lies on the other side of the counter before.
        let index = self.latched.map(|index| wrapped(2.0 * counter).wrapping_sub(index));
        self.latched = index.or(latched);
    }

    /// Changes the counter by `increments`, without a motion.
    pub(super) fn jump(&mut self, increments: i32) {
        self.zero -= f64::from(increments);
    }

    /// The counter, which wraps at 32 bits.
    pub(crate) fn counts(&self) -> i32 {
        wrapped(self.since_power_on())
    }

    /// The counter before it wraps.
    pub(crate) fn since_power_on(&self) -> f64 {
        self.counts - self.zero
    }
}

fn wrapped(counts: f64) -> i32 {
    counts as i64 as i32
}

/// `f64::floor` is a function call on targets without a rounding instruction. This function is inlined, and is valid up to
/// 2⁵¹.
fn floor(x: f64) -> f64 {
    // Beyond 2⁵² the distance between two numbers is 1, so the sum is rounded to a whole number.
    const WHOLE: f64 = 1.5 * (1_u64 << 52) as f64;
    let nearest = x + WHOLE - WHOLE;
    if nearest > x { nearest - 1.0 } else { nearest }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::{Encoder, floor};
    use crate::plant::Noise;

    /// Angle of the middle of a count of a 4000-count disc.
    fn middle(count: i64) -> f64 {
        (count as f64 + 0.5) * TAU / 4000.0
    }

    #[test]
    fn floor_rounds_down_on_both_sides_of_zero() {
        for x in [0.0, 0.5, 1.0, -0.1, -1.0, -1.5, 1e9 + 0.25, -1e9 - 0.25] {
            assert_eq!(floor(x), x.floor(), "{x}");
        }
    }

    #[test]
    fn counter_starts_at_zero_wherever_the_shaft_stands() {
        for start in [-16.0, 0.0, 0.0015, 791.0] {
            let mut encoder = Encoder::new(4000, 0.0, 0.0, start);
            assert_eq!(encoder.counts(), 0);
            encoder.read(start + TAU, &mut Noise::new(0));
            assert_eq!(encoder.counts(), 4000);
            encoder.read(start - TAU, &mut Noise::new(0));
            assert_eq!(encoder.counts(), -4000);
        }
    }

    #[test]
    fn shaft_that_stands_is_counted_as_standing() {
        let count = TAU / 4000.0;
        for off in [-0.05, -0.02, -0.01, 0.0, 0.01, 0.02, 0.05] {
            // The encoder arrives from below, arrives from above, or is switched on there, on the edge of a count.
            for from in [-3.0, 0.0, 3.0] {
                let mut noise = Noise::new(1);
                let mut encoder = Encoder::new(4000, 0.0, 0.02, (100.0 + off + from) * count);
                let angle = (100.0 + off) * count;
                for _ in 0..1000 {
                    encoder.read(angle, &mut noise);
                }
                let stood = encoder.counts();
                for _ in 0..10_000 {
                    encoder.read(angle, &mut noise);
                    assert_eq!(encoder.counts(), stood, "{off} of an edge from {from}");
                }
            }
        }
    }

    #[test]
    fn edges_tremble_under_a_shaft_that_turns() {
        let mut noise = Noise::new(1);
        let mut encoder = Encoder::new(4000, 0.0, 0.02, 0.5 * TAU / 4000.0);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut before = 0;
        for k in 0..100_000 {
            let at = 0.5 + f64::from(k) * 1e-3;
            encoder.read(at * TAU / 4000.0, &mut noise);
            if encoder.counts() != before {
                before = encoder.counts();
                let off = at - f64::from(before);
                low = low.min(off);
                high = high.max(off);
            }
        }
        assert_eq!(before, 100, "no count is lost");
        assert!((-1e-9..0.02).contains(&low) && (low..=0.041).contains(&high), "{low} to {high}");
        assert!(high - low > 0.01, "{low} to {high}");
    }

    #[test]
    fn index_marks_the_same_count_from_either_side() {
        // The index of the disc lies at count 10. Power-on is at count 0 unless a case says otherwise.
        let cases: &[(&[i64], Option<i32>)] = &[
            (&[9], None),
            (&[10], Some(10)),
            (&[12], Some(10)),
            (&[4009], Some(10)),
            (&[4010], Some(4010)),
            (&[8100], Some(8010)),
            (&[-3989], None),
            (&[-3990], Some(-3990)),
            (&[-3995], Some(-3990)),
            (&[-8000], Some(-7990)),
            (&[12, 11], Some(10)),
            (&[4012, 4011], Some(4010)),
            (&[4012, 4009], Some(4010)),
            (&[4012, 9], Some(10)),
        ];
        for (path, expected) in cases {
            let mut encoder = Encoder::new(4000, middle(10), 0.0, middle(0));
            for count in *path {
                encoder.read(middle(*count), &mut Noise::new(0));
            }
            assert_eq!(encoder.latched, *expected, "{path:?}");
        }
    }

    #[test]
    fn taken_index_comes_back_only_with_the_next_pulse() {
        let mut noise = Noise::new(0);
        let mut encoder = Encoder::new(4000, middle(10), 0.0, middle(10));
        assert_eq!(encoder.latched.take(), None, "standing on the index at power-on is no passing");
        let steps = [(11, None), (10, Some(0)), (10, None), (9, None), (10, Some(0)), (3, None), (15, Some(0))];
        for (count, expected) in steps {
            encoder.read(middle(count), &mut noise);
            assert_eq!(encoder.latched.take(), expected, "at {count}");
        }
    }
}
