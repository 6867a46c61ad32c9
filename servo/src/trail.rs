//! The last set-points of an effector, and the commanded motion at a given time.

use std::array;

use can::Instant;

use crate::MAX_AXES;
use crate::axis::REMEMBERED;

/// Words of a trail: time, period and delays, then the set-points of each axis.
pub(crate) const WORDS: usize = words_of(MAX_AXES);

/// Words of the trail of an effector of `axes` axes.
pub(crate) const fn words_of(axes: usize) -> usize {
    3 + axes * REMEMBERED
}

/// Set-points of the last 16 cycles of an effector.
///
/// Set-points are smooth, unlike differences of measured positions. The acceleration at the time of a sensor's sample
/// therefore follows from set-points ([`around`](Self::around)).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trail {
    /// Time of the cycle that sent the newest set-points.
    pub(crate) at: Instant,
    /// Servo period, s; zero before the first cycle.
    pub(crate) period: f64,
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) of each axis.
    pub(crate) delays: [u8; MAX_AXES],
    /// Motor positions of each axis, rad, the newest first.
    pub(crate) positions: [[f64; REMEMBERED]; MAX_AXES],
}

impl Trail {
    /// A trail of motors that follow `path` in every period of `period` seconds up to `at`: motor positions, rad, at a time
    /// in seconds after `at`. `delay`: [`DriveGroup::delay`](drive::DriveGroup::delay) of all axes.
    pub fn along(at: Instant, period: f64, delay: u8, path: impl Fn(f64) -> [f64; MAX_AXES]) -> Self {
        let past: [_; REMEMBERED] = array::from_fn(|age| path(-(age as f64) * period));
        let positions = array::from_fn(|axis| past.map(|motors| motors[axis]));
        Self { at, period, delays: [delay; MAX_AXES], positions }
    }

    /// Servo period, s; zero before the first cycle.
    pub fn period(&self) -> f64 {
        self.period
    }

    /// Motor positions, rad, that the set-points command one period before `time`, at `time`, and one period after it.
    ///
    /// A motor takes a set-point `delay − 1` periods after the cycle that sent the set-point, with the
    /// [delay](drive::DriveGroup::delay) of its group: a sample is read one cycle after the drive took it. The lag of the
    /// drive's loops is not included. Between set-points, positions are interpolated linearly. A time older than the trail
    /// gives the oldest three set-points, and a time after the newest set-point gives the newest three.
    pub fn around(&self, time: Instant) -> [[f64; MAX_AXES]; 3] {
        let passed = (self.at.as_nanos() as f64 - time.as_nanos() as f64) * 1e-9;
        let mut around = [[0.0; MAX_AXES]; 3];
        for (axis, past) in self.positions.iter().enumerate() {
            let age = if self.period > 0.0 { passed / self.period } else { 0.0 };
            let age = (age + f64::from(self.delays[axis]) - 1.0).clamp(1.0, (REMEMBERED - 2) as f64);
            let newer = age as usize;
            let share = age - newer as f64;
            let older = |number: usize| past[number.min(REMEMBERED - 1)];
            for (place, first) in around.iter_mut().zip([newer + 1, newer, newer - 1]) {
                place[axis] = past[first] + share * (older(first + 1) - past[first]);
            }
        }
        around
    }

    pub(crate) fn words(&self) -> [u64; WORDS] {
        let mut words = [0; WORDS];
        words[..3].copy_from_slice(&[self.at.as_nanos(), self.period.to_bits(), u64::from_le_bytes(self.delays)]);
        let positions = self.positions.iter().flatten();
        words[3..].iter_mut().zip(positions).for_each(|(word, position)| *word = position.to_bits());
        words
    }

    pub(crate) fn from_words(words: &[u64; WORDS]) -> Self {
        Self {
            at: Instant::from_nanos(words[0]),
            period: f64::from_bits(words[1]),
            delays: words[2].to_le_bytes(),
            positions: array::from_fn(|axis| array::from_fn(|age| f64::from_bits(words[3 + REMEMBERED * axis + age]))),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const PERIOD: f64 = 0.002;

    /// A trail up to 100 ms, of motors that move with half an acceleration of 6 rad/s², from 0 on.
    fn trail(delay: u8) -> Trail {
        let path = |after: f64| array::from_fn(|axis| 3.0 * (0.1 + after).powi(2) + axis as f64);
        Trail::along(Instant::from_nanos(100_000_000), PERIOD, delay, path)
    }

    #[test]
    fn a_set_point_takes_effect_one_period_before_its_sample_is_read() {
        for (delay, micros) in [(3, 98_000), (2, 96_000), (3, 92_000), (3, 90_900)] {
            let time = Instant::ZERO + Duration::from_micros(micros);
            let around = trail(delay).around(time);
            for (number, place) in around.into_iter().enumerate() {
                let sent = time.as_nanos() as f64 * 1e-9 + (number as f64 - 1.0 - f64::from(delay) + 1.0) * PERIOD;
                for (axis, position) in place.into_iter().enumerate() {
                    let expected = 3.0 * sent * sent + axis as f64;
                    // Linear interpolation misses the parabola by an eighth of the acceleration times the period squared.
                    assert!((position - expected).abs() < 3.1e-6, "{delay}, {micros}, {number}: {position} {expected}");
                }
            }
            let [before, there, after] = around.map(|place| place[5]);
            assert!(((before - 2.0 * there + after) / (PERIOD * PERIOD) - 6.0).abs() < 1e-6);
        }
    }

    #[test]
    fn times_beyond_the_trail_give_its_ends() {
        let trail = trail(3);
        for (millis, newest) in [(200, 0), (0, REMEMBERED - 3)] {
            let around = trail.around(Instant::ZERO + Duration::from_millis(millis));
            let expected = [2, 1, 0].map(|age| trail.positions[1][newest + age]);
            assert_eq!(around.map(|place| place[1]), expected, "{millis} ms");
        }
        assert_eq!(Trail::default().around(Instant::ZERO), [[0.0; MAX_AXES]; 3]);
    }

    #[test]
    fn what_is_published_is_read() {
        let trail = trail(2);
        assert_eq!(Trail::from_words(&trail.words()), trail);
    }
}
