//! Monitoring of the measured position of a motor that should move.
//!
//! If an encoder fails or a motor runs into a rigid obstacle, the measured position stops abruptly. A motor whose loop
//! works brakes with at most its greatest acceleration. The motor therefore moves on by a least distance, which follows
//! from its last measured speed. The position is *frozen* if at least four successive samples are equal and the least
//! distance is at least two increments.
//!
//! The speed is the mean speed over the last samples, less the speed that the motor may have lost during these samples.
//! A motor that ends a motion, reverses in a search, or sticks at low speed is therefore not frozen. The speed is
//! kept for twice the time that the motor needs to brake, and not over a standstill.
//!
//! A counter may also stand while its motor moves, and count again before another check finds it: the encoder failed
//! shortly before the end of a motion. Such a counter *starts at once*: after at least four equal samples, one step is
//! faster than a quarter of the greatest velocity, and faster than a motor that starts with four times its greatest
//! acceleration. No motor and no impact accelerates so. The counter has lost counts.
//!
//! # Floor
//! A position that stands still at once is not detected below a speed of 0.02 `max_velocity` + 2 `max_acceleration` ·
//! period: 11 rad/s at 250 rad/s, 1500 rad/s² and 2 ms. The first term is dry friction, which may hold a slow motor at
//! once. The second term is the speed that a motor may lose within four samples. The motor must also move on by at
//! least two increments while it brakes: with an encoder of 128 counts per turn, this motor must be faster than
//! 23 rad/s. At lower speeds, only the following error detects such a position, and in homing by the drive the group of the
//! drive ([`AxisState::stalled`]).

use drive::{AxisState, Increments};

/// Samples of the mean speed, and least number of equal samples in a row of a frozen position.
const SAMPLES: usize = 4;

/// Least distance, increments, of a motor whose position must have changed. One increment is the resolution.
const LEAST: f64 = 2.0;

/// Share of the greatest velocity below which dry friction may hold a motor at once.
const SLOW: f64 = 0.02;

/// Time for which a speed is remembered, in braking times of the motor, and least number of samples of this time.
const MEMORY: f64 = 2.0;
const LEAST_MEMORY: usize = 4 * SAMPLES;

/// Share of the greatest velocity, and multiple of the greatest acceleration, above which no motor starts within a sample.
const AT_ONCE: (f64, f64) = (0.25, 4.0);

/// The last samples of a measured position.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Progress {
    last: Option<Increments>,
    /// Increments and seconds of the last steps between two samples, the newest first.
    steps: [(f64, f64); SAMPLES],
    /// Time since the last sample, s.
    waited: f64,
    /// Steps up to the last change of the position: increments and s.
    change: (f64, f64),
    /// Samples since the last change, and the time since then, s.
    standing: (usize, f64),
    /// Increments and seconds of the last step, if it ended a standstill.
    start: Option<(f64, f64)>,
}

impl Progress {
    /// Takes the state of a cycle, `elapsed` seconds after the last cycle.
    pub(crate) fn observe(&mut self, state: &AxisState, elapsed: f64) {
        self.waited += elapsed;
        if state.age > 0 {
            return;
        }
        let waited = std::mem::take(&mut self.waited);
        let Some(last) = self.last.replace(state.increments) else {
            return;
        };
        let moved = f64::from(state.increments.0.wrapping_sub(last.0));
        self.steps.rotate_right(1);
        self.steps[0] = (moved, waited);
        self.start = (moved != 0.0 && self.standing.0 >= SAMPLES).then_some((moved, waited));
        if moved == 0.0 {
            self.standing = (self.standing.0.saturating_add(1), self.standing.1 + waited);
            return;
        }
        self.standing = (0, 0.0);
        self.change = self.steps.iter().fold((0.0, 0.0), |sum, step| (sum.0 + step.0, sum.1 + step.1));
    }

    /// Forgets the speed, because the counter was set.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Distance, rad, of the last step, if the position starts at once. The motor accelerates with at most
    /// `max_acceleration`, rad/s².
    pub(crate) fn started(&self, increments_per_radian: f64, max_velocity: f64, max_acceleration: f64) -> Option<f64> {
        let (moved, time) = self.start?;
        let distance = moved.abs() / increments_per_radian.abs();
        let speed = (AT_ONCE.0 * max_velocity).max(AT_ONCE.1 * 0.5 * max_acceleration * time);
        (moved.abs() > LEAST && distance > speed * time).then_some(distance)
    }

    /// Distance, rad, by which the motor must have moved since the measured position last changed, if the position is
    /// frozen. The motor has `increments_per_radian` and brakes with at most `max_acceleration`, rad/s².
    pub(crate) fn frozen(&self, increments_per_radian: f64, max_velocity: f64, max_acceleration: f64) -> Option<f64> {
        let (samples, standing) = self.standing;
        let (moved, time) = self.change;
        if samples < SAMPLES || time <= 0.0 {
            return None;
        }
        let scale = increments_per_radian.abs();
        let speed = moved.abs() / scale / time - 0.5 * max_acceleration * time;
        // No motor is faster than its greatest velocity: such a speed is that of a counter that was set.
        let memory = MEMORY * speed.min(max_velocity) / max_acceleration;
        if samples > LEAST_MEMORY && standing > memory {
            return None;
        }
        let braking = standing.min(speed / max_acceleration);
        let distance = braking * (speed - 0.5 * max_acceleration * braking);
        (speed > SLOW * max_velocity && distance * scale >= LEAST).then_some(distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.002;

    /// Whether and after how many samples the position is found frozen, of a motor with these counts per radian that
    /// moves as `angle` says, rad by s, and is observed for half a second.
    fn found(counts: f64, angle: impl Fn(f64) -> f64) -> Option<usize> {
        let mut progress = Progress::default();
        (0..250).find(|&number| {
            let increments = Increments((angle(number as f64 * DT) * counts).floor() as i32);
            progress.observe(&AxisState { increments, ..AxisState::default() }, DT);
            progress.frozen(counts, 250.0, 1500.0).is_some()
        })
    }

    /// Position at `t` of a motor that moves at `speed`, brakes with `deceleration` from 0.1 s, and reverses if it may.
    fn braking(speed: f64, deceleration: f64, reverses: bool, t: f64) -> f64 {
        let after = (t - 0.1).max(0.0);
        let after = if reverses { after } else { after.min(speed / deceleration) };
        speed * t.min(0.1) + after * (speed - 0.5 * deceleration * after)
    }

    #[test]
    fn a_position_that_freezes_in_motion_is_found_after_four_samples() {
        let fine = 4000.0 / std::f64::consts::TAU;
        for speed in [15.0, -15.0, 60.0, 240.0] {
            assert_eq!(found(fine, |t| speed * t.min(0.1)), Some(54), "{speed}");
        }
        // An encoder of 128 counts shows less than two counts in a period.
        let coarse = 128.0 / std::f64::consts::TAU;
        let found = found(coarse, |t| 40.0 * t.min(0.1));
        assert!(found.is_some_and(|at| at <= 60), "{found:?}");
    }

    #[test]
    fn a_motor_that_brakes_reverses_or_sticks_is_not_frozen() {
        for counts in [128.0, 500.0, 4000.0, 65_536.0].map(|counts| counts / std::f64::consts::TAU) {
            for speed in [0.5, 3.5, 15.0, 60.0, 240.0] {
                for deceleration in [50.0, 150.0, 1000.0, 1500.0] {
                    for reverses in [false, true] {
                        let angle = |t| braking(speed, deceleration, reverses, t);
                        assert_eq!(found(counts, angle), None, "{counts} {speed} {deceleration} {reverses}");
                    }
                }
                // Dry friction holds a slow motor at once.
                if speed < 5.0 {
                    assert_eq!(found(counts, |t| speed * t.min(0.1)), None);
                }
            }
        }
    }

    #[test]
    fn a_position_that_starts_at_once_after_a_standstill_is_found() {
        let fine = 4000.0 / std::f64::consts::TAU;
        // Samples of a counter that stands still for some samples, and the increments of its next step.
        for (samples, step, found) in [(4, 90, true), (4, -90, true), (3, 400, false), (50, 400, true), (50, 70, false)]
        {
            let mut progress = Progress::default();
            let mut take = |counter| {
                progress.observe(&AxisState { increments: Increments(counter), ..AxisState::default() }, DT);
                progress.started(fine, 250.0, 1500.0).is_some()
            };
            // The first sample of a counter has no step.
            assert!((0..=samples).all(|_| !take(7)));
            assert_eq!(take(7 + step), found, "{samples} samples, then {step}");
            assert!(!take(7 + 2 * step), "the next step of {step}");
        }
    }

    #[test]
    fn a_motor_starts_with_less_than_four_times_its_acceleration() {
        let fine = 4000.0 / std::f64::consts::TAU;
        for (max_acceleration, multiple, starts) in
            [(1500.0, 3.8, false), (150_000.0, 3.8, false), (150_000.0, 4.2, true)]
        {
            let mut progress = Progress::default();
            let begins = |number| {
                let time = (f64::from(number) * DT - 0.05).max(0.0);
                let increments = Increments((0.5 * multiple * max_acceleration * time * time * fine) as i32);
                progress.observe(&AxisState { increments, ..AxisState::default() }, DT);
                progress.started(fine, 250.0, max_acceleration).is_some()
            };
            let found = (0..100).map(begins).filter(|&begins| begins).count();
            assert_eq!(found, usize::from(starts), "{multiple} times {max_acceleration} rad/s²");
        }
    }

    #[test]
    fn a_step_of_two_increments_is_no_start() {
        // Both steps are faster than a quarter of 250 rad/s.
        for (step, found) in [(2, false), (3, true)] {
            let mut progress = Progress::default();
            for counter in [0, 0, 0, 0, 0, step] {
                progress.observe(&AxisState { increments: Increments(counter), ..AxisState::default() }, DT);
            }
            assert_eq!(progress.started(8.0, 250.0, 1500.0).is_some(), found, "{step}");
        }
    }

    #[test]
    fn the_speed_of_a_motor_that_brakes_in_three_samples_is_remembered_for_sixteen() {
        let fine = 4000.0 / std::f64::consts::TAU;
        let mut progress = Progress::default();
        let frozen: Vec<usize> = (0..100)
            .filter(|&number| {
                let increments = Increments((60.0 * DT * number.min(50) as f64 * fine) as i32);
                progress.observe(&AxisState { increments, ..AxisState::default() }, DT);
                progress.frozen(fine, 250.0, 10_000.0).is_some()
            })
            .collect();
        assert_eq!(frozen, Vec::from_iter(50 + SAMPLES..=50 + 4 * SAMPLES));
    }

    #[test]
    fn a_speed_is_not_remembered_over_a_standstill() {
        for speed in [15.0, 60.0, 240.0, 5000.0] {
            let mut progress = Progress::default();
            let frozen: Vec<bool> = (0..300)
                .map(|number| {
                    let angle = speed * DT * f64::from(number.min(50));
                    let increments = Increments((angle * 4000.0 / std::f64::consts::TAU) as i32);
                    progress.observe(&AxisState { increments, ..AxisState::default() }, DT);
                    progress.frozen(4000.0 / std::f64::consts::TAU, 250.0, 1500.0).is_some()
                })
                .collect();
            let remembered = if speed > 100.0 { 140 } else { 4 };
            assert!(frozen[54..54 + remembered].iter().all(|&found| found), "{speed}");
            // A motor brakes from its greatest speed in 84 samples.
            assert!(frozen[54 + 2 * 84..].iter().all(|&found| !found), "{speed}");
        }
    }

    #[test]
    fn dry_friction_may_hold_a_motor_below_a_fiftieth_of_its_greatest_speed() {
        let fine = 4000.0 / std::f64::consts::TAU;
        for (speed, expected) in [(3.5, false), (8.0, true)] {
            let mut progress = Progress::default();
            let stuck = (0..100).any(|number| {
                let increments = Increments((speed * DT * f64::from(number.min(50)) * fine) as i32);
                progress.observe(&AxisState { increments, ..AxisState::default() }, DT);
                progress.frozen(fine, 250.0, 100.0).is_some()
            });
            assert_eq!(stuck, expected, "{speed}");
        }
    }

    #[test]
    fn answers_that_are_missing_do_not_make_a_position_stand() {
        let mut progress = Progress::default();
        for number in 0..200 {
            // Three of four answers are missing.
            let state =
                AxisState { increments: Increments(20 * number), age: (number % 4) as u32, ..AxisState::default() };
            progress.observe(&state, DT);
            assert_eq!(progress.frozen(636.6, 250.0, 1500.0), None);
        }
        for number in 0..20 {
            progress.observe(&AxisState { increments: Increments(4000), age: number, ..AxisState::default() }, DT);
        }
        assert_eq!(progress.frozen(636.6, 250.0, 1500.0), None, "one sample");
    }
}
