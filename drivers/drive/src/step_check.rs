//! Detection of steps of a position counter in motion: encoder faults that lose or gain counts.
//!
//! A motor has inertia. A step of its counter that the acceleration cannot explain, with nearly the same speed before and
//! after, is no motion. Other causes look different:
//! - An answer that came or was sampled late moves the position by at most the speed times the delay, and the next answer
//!   in time takes the displacement back.
//! - An obstacle or a counter that stands still takes the speed away. A shock gives the motor another speed.
//! - A damaged answer is contradicted by the next one.
//!
//! Two answers after the step therefore decide. The loop may take the step back in this time. The displacements after
//! the step then change by no more than the acceleration permits, and half of the step is left at the first answer.
//!
//! # Smallest step
//! A step counts from `max_acceleration` · period² + `latest` · speed + 2 increments per sample on, where `latest` is
//! the longest delay of an answer that the group tolerates. Smaller steps are not found. The size of a step is measured
//! at the first answer after the step. The loop may have taken back a part of the step by then.

/// Answers after a step that must confirm the step.
const ANSWERS_TO_CONFIRM: u32 = 2;

/// Greatest change of the displacement of an answer after the step, as a fraction of the step.
const UNCHANGED: f64 = 1.0 / 3.0;

/// Least part of the step that must be left at each answer after the step.
const LEFT: f64 = 1.0 / 2.0;

/// Error of a displacement from rounding both positions, increments.
const ROUNDING: f64 = 2.0;

/// Number of displacements whose speed bounds the effect of a delay.
const REMEMBERED: usize = 8;

/// Bounds of one axis, in increments and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepBounds {
    /// Greatest acceleration of the motor, increments/s².
    pub(crate) max_acceleration: f64,
    /// Longest delay of an answer, s.
    pub(crate) latest: f64,
}

/// A step that the answers have confirmed, increments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CounterStep {
    pub(crate) moved: i32,
    /// Greatest displacement that the motor can have made.
    pub(crate) most: u32,
}

/// Detection of steps of one counter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepCheck {
    bounds: StepBounds,
    last: Option<i32>,
    /// The last displacement, increments, and its time, s.
    displacement: Option<(f64, f64)>,
    /// Speeds of the last displacements, increments/s.
    speeds: [f64; REMEMBERED],
    next: usize,
    candidate: Option<Candidate>,
}

/// A step that the next answers confirm or contradict.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    step: CounterStep,
    /// Difference between the displacement and that of the speed before, increments.
    residual: f64,
    /// Speed before the step, increments/s.
    velocity: f64,
    /// The last residual since the step, and the sum of all residuals since the step, increments.
    last: f64,
    left: f64,
    answers: u32,
}

impl StepCheck {
    pub(crate) fn new(bounds: StepBounds) -> Self {
        Self { bounds, last: None, displacement: None, speeds: [0.0; REMEMBERED], next: 0, candidate: None }
    }

    /// Forgets all samples. The next sample is the first.
    pub(crate) fn forget(&mut self) {
        *self = Self::new(self.bounds);
    }

    /// Takes a position sampled `dt` seconds after the last one. Returns a step that this answer confirms.
    pub(crate) fn take(&mut self, position: i32, dt: f64) -> Option<CounterStep> {
        let last = self.last.replace(position)?;
        let moved = position.wrapping_sub(last);
        let displacement = f64::from(moved);
        if let Some(candidate) = &mut self.candidate {
            let residual = displacement - candidate.velocity * dt;
            let before = std::mem::replace(&mut candidate.last, residual);
            candidate.left += residual;
            candidate.answers += 1;
            let sign = candidate.residual.signum();
            let same_speed = residual.abs() <= UNCHANGED * candidate.residual.abs();
            let stays = candidate.left * sign >= LEFT * candidate.residual.abs();
            let accelerated = self.bounds.max_acceleration * dt * dt + 2.0 * ROUNDING;
            let is_back = residual * sign < 0.0 && (residual - before).abs() <= accelerated;
            let is_taken_back = is_back && (stays || candidate.answers > 1);
            let confirms = dt > 0.0 && (same_speed && stays || is_taken_back);
            let decided = candidate.answers >= ANSWERS_TO_CONFIRM;
            let step = candidate.step;
            if !confirms || decided {
                self.candidate = None;
            }
            self.remember(displacement, dt);
            return (confirms && decided).then_some(step);
        }
        if let Some((before, time)) = self.displacement.filter(|_| dt > 0.0) {
            let velocity = before / time;
            let residual = displacement - velocity * dt;
            let fastest = self.speeds.iter().fold(0.0_f64, |most, speed| most.max(*speed));
            let accelerated = self.bounds.max_acceleration * dt * (dt + time) / 2.0;
            let bound = accelerated + self.bounds.latest * fastest + ROUNDING * (1.0 + dt / time);
            if residual.abs() > bound {
                let most = (velocity.abs() * dt + bound).ceil() as u32;
                let step = CounterStep { moved, most };
                self.candidate = Some(Candidate { step, residual, velocity, last: 0.0, left: residual, answers: 0 });
                return None;
            }
        }
        self.remember(displacement, dt);
        None
    }

    /// Whether the last answers look like a step, which the next answers confirm or contradict.
    pub(crate) fn is_undecided(&self) -> bool {
        self.candidate.is_some()
    }

    fn remember(&mut self, displacement: f64, dt: f64) {
        if dt <= 0.0 {
            return;
        }
        self.displacement = Some((displacement, dt));
        self.speeds[self.next] = displacement.abs() / dt;
        self.next = (self.next + 1) % REMEMBERED;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 0.002;
    /// 200 000 increments/s² are 0.8 increments per period². Answers are up to 6 ms late.
    const BOUNDS: StepBounds = StepBounds { max_acceleration: 200_000.0, latest: 0.006 };

    /// The step found in positions of successive periods, and the number of the answer that confirms it.
    fn found(positions: impl IntoIterator<Item = i32>) -> Option<(usize, CounterStep)> {
        let mut check = StepCheck::new(BOUNDS);
        positions.into_iter().enumerate().find_map(|(number, at)| Some((number, check.take(at, PERIOD)?)))
    }

    /// Positions at `speed`, increments per period, with an offset from answer 20 on.
    fn cruise(speed: i32, offset: impl Fn(i32) -> i32) -> Vec<i32> {
        (0..60).map(|number| speed * number + if number >= 20 { offset(number - 20) } else { 0 }).collect()
    }

    #[test]
    fn a_step_at_rest_and_in_motion_is_found_two_answers_later() {
        // The bound is 0.8 increments, three periods of the speed, and four increments.
        for (speed, least) in [(0, 5), (10, 35), (-10, 35), (100, 305)] {
            for sign in [1, -1] {
                assert_eq!(found(cruise(speed, |_| sign * (least - 1))), None, "{speed}");
                for step in [least, 2 * least, 10_000] {
                    let moved = speed + sign * step;
                    let most = (speed.abs() + least) as u32;
                    let step = CounterStep { moved, most };
                    assert_eq!(found(cruise(speed, |_| moved - speed)), Some((22, step)), "{speed}");
                }
            }
        }
        let before_the_wrap = cruise(10, |_| 1_000).into_iter().map(|at| at.wrapping_add(i32::MAX - 100));
        assert_eq!(found(before_the_wrap).map(|(number, _)| number), Some(22));
    }

    #[test]
    fn motion_and_damaged_answers_are_no_step() {
        // Damaged answers; two in a row.
        assert_eq!(found(cruise(10, |number| if number == 0 { 5_000 } else { 0 })), None);
        assert_eq!(found(cruise(10, |number| if number < 2 { 5_000 } else { 0 })), None);
        // An obstacle, one that the motor bounces off, a counter that stands still and goes on, a shock.
        assert_eq!(found(cruise(100, |number| -100 * (number + 1))), None);
        assert_eq!(found(cruise(100, |number| -180 * (number + 1))), None);
        assert_eq!(found(cruise(100, |number| -100 * (number + 1).min(10))), None);
        assert_eq!(found(cruise(0, |number| 500 * (number + 1))), None);
        // Answers become two or three periods late, and are in time again.
        for late in [2, 3] {
            assert_eq!(found(cruise(100, |_| -100 * late)), None);
            assert_eq!(found(cruise(100, |number| if number < 9 { -100 * late } else { 0 })), None);
        }
        // A motor accelerates, and turns round, as fast as it can.
        let turns = (0..200).map(|number: i32| (0.4 * f64::from((number - 100).pow(2))) as i32);
        assert_eq!(found(turns), None);
    }

    #[test]
    fn a_step_that_a_loop_begins_to_correct_is_found() {
        let corrected = cruise(10, |number| 1_000 - 100 * number);
        assert_eq!(found(corrected).map(|(number, _)| number), Some(22));
    }

    /// The drive of a light motor takes a step back within four answers, with half of the greatest acceleration and more.
    #[test]
    fn a_step_that_a_stiff_loop_takes_back_is_found() {
        let bounds = StepBounds { max_acceleration: 12_700_000.0, ..BOUNDS };
        let found = |offsets: &[i32]| {
            let mut check = StepCheck::new(bounds);
            let after = *offsets.last().unwrap();
            let positions = [0; 20].iter().chain(offsets).copied().chain([after; 20]);
            positions.enumerate().find_map(|(number, at)| check.take(at, PERIOD).map(|_| number))
        };
        for sign in [1, -1] {
            for taken_back in [[71, 37, 6, -9], [71, 50, 20, -5], [71, 71, 40, 0], [71, 60, 51, 40]] {
                assert_eq!(found(&taken_back.map(|at| sign * at)), Some(22), "{taken_back:?}");
            }
            // Damaged answers, a blow with a rebound, a blow, and a counter that begins to count again.
            for other in [[71, 0, 0, 0], [71, 71, 0, 0], [71, 20, 0, 0], [71, 5, -40, -80], [71, 105, 130, 150]] {
                assert_eq!(found(&other.map(|at| sign * at)), None, "{other:?}");
            }
        }
    }

    #[test]
    fn answers_in_a_burst_are_no_step() {
        let mut check = StepCheck::new(BOUNDS);
        let positions = (0..40).map(|number| (100 * number, PERIOD));
        // Three answers are missing. All of them come at the end of the fourth period, as samples of the last SYNC.
        let burst = [(4_000, 4.0 * PERIOD), (4_100, 0.0), (4_200, 0.0), (4_300, 0.0)];
        let after = (44..60).map(|number| (100 * number, PERIOD));
        for (position, dt) in positions.chain(burst).chain(after) {
            assert_eq!(check.take(position, dt), None, "{position}");
        }
    }
}
