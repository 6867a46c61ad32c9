//! Monitoring of the counter of a drive that searches for its reference.
//!
//! A drive whose encoder fails at standstill begins a search with a motor that no loop holds. The motor runs away, and the
//! drive has no following error while its search turns round at a switch that the motor passes. If the encoder works again,
//! the drive may find an index pulse far from the switch. The counter of such a drive stands still, and that of a search
//! does not.
//!
//! # Limit
//! A search stands still where it begins and where it turns round. The counter then changes after at most the time of one
//! increment from standstill under the homing acceleration, once before and once after the turn, and the time of one
//! increment at the slower search speed. The limit is twice these times and 50 ms for the loop of the drive, which must
//! overcome stiction.

use std::time::Duration;

use can::Instant;

use super::config::AxisConfig;
use crate::Increments;

/// Time for the loop of the drive.
const LOOP: f64 = 0.05;
/// Factor on the times of one increment.
const MARGIN: f64 = 2.0;

/// The last change of the counter in a search.
#[derive(Clone, Copy, Debug)]
pub(super) struct SearchWatch {
    limit: Duration,
    /// The slower search speed, rad/s.
    speed: f64,
    /// The counter, and the time of its first sample; `None` outside a search.
    last: Option<(Increments, Instant)>,
}

impl SearchWatch {
    pub(super) fn new(config: &AxisConfig) -> Self {
        let homing = &config.homing;
        let (speed, increment) =
            (homing.search_speed.min(homing.zero_speed), 1.0 / config.scale.increments_per_radian().abs());
        let times = increment / speed + 2.0 * (2.0 * increment / homing.acceleration).sqrt();
        // A speed or acceleration of zero is refused before operation.
        let limit = Duration::try_from_secs_f64(LOOP + MARGIN * times).unwrap_or(Duration::MAX);
        Self { limit, speed, last: None }
    }

    /// Takes the counter sampled at `sampled`. Returns the distance, rad, by which the motor must have moved since the
    /// counter last changed, if the counter stands still for too long.
    pub(super) fn look(&mut self, searches: bool, counter: Increments, sampled: Instant) -> Option<f64> {
        if !searches {
            self.last = None;
            return None;
        }
        let since = match self.last {
            Some((before, since)) if before == counter => since,
            _ => {
                self.last = Some((counter, sampled));
                sampled
            }
        };
        let standing = sampled.since(since);
        (standing > self.limit).then_some(self.speed * standing.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::bench::axis_config;
    use super::*;

    const PERIOD: Duration = Duration::from_millis(2);

    /// Time after which a counter of `counts` per turn, which moves as `counter` says by the time, s, is found to stand
    /// still in a search at 3.5 rad/s and 150 rad/s².
    fn found(counts: i32, searches: bool, counter: impl Fn(f64) -> f64) -> Option<Duration> {
        let mut config = axis_config(2);
        config.scale = crate::Scale::new(counts, 0.0).expect("counts");
        (config.homing.search_speed, config.homing.zero_speed, config.homing.acceleration) = (15.0, 3.5, 150.0);
        let mut watch = SearchWatch::new(&config);
        let per_radian = config.scale.increments_per_radian();
        (0..500).map(|cycle| cycle * PERIOD).find(|&time| {
            let increments = Increments((counter(time.as_secs_f64()) * per_radian).floor() as i32);
            watch.look(searches, increments, Instant::ZERO + time).is_some()
        })
    }

    #[test]
    fn a_counter_that_stands_still_in_a_search_is_found() {
        assert_eq!(found(4000, true, |_| 1.0), Some(Duration::from_millis(70)));
        assert_eq!(found(4000, true, |time| 15.0 * time.min(0.5)), Some(Duration::from_millis(570)));
        assert_eq!(found(4000, false, |_| 1.0), None, "no search");
        assert!(found(128, true, |_| 1.0).is_some_and(|time| time < Duration::from_millis(190)));
    }

    #[test]
    fn a_search_that_begins_turns_round_and_slows_down_does_not_stand_still() {
        // The motor begins at rest, turns round with the homing acceleration, and goes on at the slower speed.
        let search = |time: f64| {
            let turn = (time - 0.3).max(0.0);
            let falling = turn.min(18.5 / 150.0);
            let after = (turn - falling).max(0.0);
            15.0 * (time - 0.05).clamp(0.0, 0.25) + 15.0 * falling - 75.0 * falling * falling - 3.5 * after
        };
        for counts in [128, 500, 4000, 65_536] {
            assert_eq!(found(counts, true, search), None, "{counts}");
        }
    }
}
