//! Detection of the step of a drive's counter when the drive sets the counter at the reference.

use drive::{AxisState, Homing};

/// The greatest step of the counter during a search that no motor can make.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ReferenceWatch {
    /// The last sample, rad and increments.
    last: Option<(f64, i64)>,
    /// Displacement per period up to the last sample, and the number of periods it covers.
    way: Option<(f64, f64)>,
    periods: f64,
    /// Displacement per period up to the sample before the last.
    earlier: Option<(f64, f64)>,
    /// Cycles without a sample since the last one.
    gap: u32,
    searching: bool,
    /// The step of the counter, increments. Samples taken early or late show steps too, but smaller ones.
    pub(crate) offset: i64,
}

impl ReferenceWatch {
    /// A step counts as a step of the counter if the motor would need this many times its greatest acceleration.
    const IMPOSSIBLE: f64 = 4.0;
    /// Steps up to this many counts are within the counter's resolution.
    const COARSE: f64 = 2.0;

    /// Takes a sample, and returns the step of the counter, rad, if the drive set the counter since the last sample.
    /// The criterion is a step that a motor cannot make, or the first sample in which the drive reports that it
    /// `attained` the reference.
    pub(crate) fn observe(
        &mut self,
        state: &AxisState,
        seeking: bool,
        attained: bool,
        max_acceleration: f64,
        dt: f64,
    ) -> Option<f64> {
        // The sample that reports success may be the first one after the step.
        let searching = seeking || state.homing == Homing::InProgress;
        let searched = std::mem::replace(&mut self.searching, searching) || searching;
        if state.age > 0 {
            self.gap = self.gap.saturating_add(1);
            return None;
        }
        let periods = f64::from(std::mem::take(&mut self.gap)) + 1.0;
        let sample = (state.position, i64::from(state.increments.0));
        let last = self.last.replace(sample)?;
        let moved = (sample.0 - last.0, (sample.1 - last.1) as f64);
        let last_periods = std::mem::replace(&mut self.periods, periods);
        let way = self.way.replace((moved.0 / periods, moved.1 / periods))?;
        let earlier = self.earlier.replace(way);
        let mut step = moved.0 - way.0 * periods;
        let possible = Self::IMPOSSIBLE * max_acceleration * (periods * dt).powi(2);
        // A coarse counter makes steps of one or two counts by itself.
        let seen = (moved.1 - way.1 * periods).abs() > Self::COARSE;
        let impossible = searched && seen && step.abs() > possible;
        if !attained && !impossible {
            return None;
        }
        let mut counts = way.1 * periods - moved.1;
        if attained
            && !impossible
            && let Some(earlier) = earlier
        {
            // The drive may report success one sample late. A step too small to be detected is then part of the
            // previous displacement.
            step += (way.0 - earlier.0) * (last_periods + periods);
            counts -= (way.1 - earlier.1) * (last_periods + periods);
        }
        let counts = counts.round() as i64;
        if counts.abs() > self.offset.abs() {
            self.offset = counts;
        }
        if impossible {
            // The displacement up to this sample mixes two counts.
            (self.way, self.earlier) = (None, None);
        }
        Some(step)
    }
}

#[cfg(test)]
mod tests {
    use drive::Increments;

    use super::*;

    const COUNTS: f64 = 4000.0 / std::f64::consts::TAU;

    /// The offset found in a sequence of homing states and counts, with a period of 2 ms.
    fn offset(samples: &[(Homing, i32)]) -> i64 {
        let mut watch = ReferenceWatch::default();
        for &(homing, counts) in samples {
            let state = AxisState {
                position: f64::from(counts) / COUNTS,
                increments: Increments(counts),
                homing,
                ..AxisState::default()
            };
            watch.observe(&state, false, false, 1500.0, 0.002);
        }
        watch.offset
    }

    #[test]
    fn a_small_step_is_taken_as_it_is_whether_the_word_comes_with_it_or_after() {
        use Homing::{Attained, InProgress};
        for jump in [-14, 9, 14, 500] {
            for late in [false, true] {
                let mut watch = ReferenceWatch::default();
                let (mut led, mut was) = (0.0, InProgress);
                for number in 0..8 {
                    let counts = 4 * number + if number >= 4 { jump } else { 0 };
                    let homing = match number {
                        5.. => Attained,
                        4 if !late => Attained,
                        _ => InProgress,
                    };
                    let state = AxisState {
                        position: f64::from(counts) / COUNTS,
                        increments: Increments(counts),
                        homing,
                        ..AxisState::default()
                    };
                    let attained = std::mem::replace(&mut was, homing) != homing;
                    led += watch.observe(&state, true, attained, 1500.0, 0.002).unwrap_or(0.0);
                }
                let led = led * COUNTS;
                assert!((led - f64::from(jump)).abs() < 0.5, "{jump}, {late}: {led}");
            }
        }
    }

    #[test]
    fn the_step_to_the_reference_is_the_offset_and_jitter_is_not() {
        use Homing::{Attained, InProgress};
        let search = [(InProgress, -100), (InProgress, -96), (InProgress, -92)];
        let home = [(Attained, 4), (Attained, 4), (Attained, 4)];
        assert_eq!(offset(&[&search[..], &home].concat()), -92);
        // The displacement of two periods in one: the sample was taken late.
        let late = [(InProgress, -140), (InProgress, -120), (InProgress, -80)];
        assert_eq!(offset(&[&late[..], &search, &home].concat()), -92);
        let fast = [(Attained, 100), (Attained, 200), (Attained, 400)];
        assert_eq!(offset(&[&search[..], &home, &fast].concat()), -92);
    }
}
