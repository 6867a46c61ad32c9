//! Plausibility checks of answers: the reach of the motor, and answers that never change.

use std::time::Duration;

use can::Instant;
use serial::nfv2::Status;

use super::config::{AxisConfig, GroupConfig};
use super::stream::Answer;
use crate::step_check::{CounterStep, StepBounds, StepCheck};
use crate::{Increments, Milliamperes};

/// Answers in a row that must agree about a position beyond reach before it is accepted as a jump of the counter.
const ANSWERS_TO_JUMP: u32 = 3;

/// Answers in a row that must agree about a position that is implausible but within reach, or set by the index pulse.
const ANSWERS_TO_CONFIRM: u32 = 2;

/// Periods by which answers may be later than the tolerated number of missing ones.
const LATER: u32 = 2;

/// Answers in a row that may be the same in every bit after the set-points have changed.
const ANSWERS_TO_FREEZE: u32 = 25;

/// Plausibility check of measured positions, against the last accepted position.
///
/// - A position is *within reach* if the greatest velocity covers the distance in the time between the two requests. A
///   quarter of a period is added for telegrams that leave late.
/// - A position is *plausible* if it is within reach and the greatest acceleration covers the change of velocity.
///
/// Plausible positions are accepted at once. A position that is only within reach is accepted when the next answer
/// agrees with it. A position beyond reach is a jump of the counter when three answers agree about it. A step within
/// reach that the acceleration cannot explain is a jump when two further answers confirm it ([`StepCheck`]). A position
/// that waits for the next answer also takes part in this check, so that a step is judged over the time between two
/// answers.
#[derive(Clone, Debug)]
pub(super) struct PositionCheck {
    /// Increments/s.
    max_velocity: f64,
    /// Increments/s².
    max_acceleration: f64,
    /// s.
    period: f64,
    last: Option<Sample>,
    /// Velocity between the last two accepted positions, increments/s, and the time between them, s.
    velocity: Option<(f64, f64)>,
    candidate: Option<Candidate>,
    /// The last answer contradicted the one before.
    contradicted: bool,
    steps: StepCheck,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    position: i32,
    at: Instant,
}

/// A position that is not accepted yet, and that the last answers agree about.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    last: Sample,
    /// Of the last answer with a status.
    status: Option<Status>,
    answers: u32,
    /// The position is beyond reach, and the index pulse cannot have set it.
    beyond_reach: bool,
    /// Check of steps, which has taken the positions of these answers.
    steps: StepCheck,
}

/// Result of a plausibility check of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Plausible,
    Implausible,
    /// The position looks like the index pulse: the next answer decides.
    Unconfirmed,
    /// The index pulse set the counter. Contains the status of the answers before, which agrees, if they had one.
    Indexed(Option<Status>),
    /// The counter has changed for good, and not by motion, from the last accepted position. Contains the last status
    /// of the answers that agree, if they had one.
    Jumped {
        from: i32,
        status: Option<Status>,
    },
}

impl PositionCheck {
    pub(super) fn new(group: &GroupConfig, axis: &AxisConfig) -> Self {
        let counts = axis.scale.increments_per_radian().abs();
        Self {
            max_velocity: axis.max_velocity * counts,
            max_acceleration: axis.max_acceleration * counts,
            period: group.period.as_secs_f64(),
            last: None,
            velocity: None,
            candidate: None,
            contradicted: false,
            steps: StepCheck::new(StepBounds {
                max_acceleration: axis.max_acceleration * counts,
                latest: group.period.as_secs_f64() * f64::from(group.tolerated_missing.saturating_add(LATER)),
            }),
        }
    }

    /// Begins anew at an accepted position.
    pub(super) fn begin(&mut self, position: i32, at: Instant) {
        self.last = Some(Sample { position, at });
        self.velocity = None;
        self.candidate = None;
        self.contradicted = false;
        self.steps.forget();
    }

    /// Whether the last answer judged contradicts the one before, whose position was beyond reach.
    pub(super) fn contradicts(&self) -> bool {
        self.contradicted
    }

    /// Position that the velocity predicts at `at`, and the displacement per period, increments.
    pub(super) fn predicted(&self, at: Instant) -> Option<(f64, f64)> {
        let (last, velocity) = (self.last?, self.velocity());
        let dt = at.since(last.at).as_secs_f64();
        Some((f64::from(last.position) + velocity * dt, velocity * self.period))
    }

    /// Greatest distance in `periods`, increments.
    pub(super) fn reach_in(&self, periods: f64) -> f64 {
        self.reach(periods * self.period)
    }

    /// Judges an answer whose request left at `at`. `may_index` says that the index pulse may have zeroed the counter.
    pub(super) fn judge(&mut self, answer: Answer, at: Instant, may_index: bool) -> Verdict {
        let new = Sample { position: answer.position.0, at };
        let Some(last) = self.last else {
            self.begin(new.position, at);
            return Verdict::Plausible;
        };
        let dt = self.elapsed(last, new);
        let moved = f64::from(new.position.wrapping_sub(last.position));
        let within_reach = moved.abs() <= self.reach(dt);
        self.contradicted = self.candidate.is_some_and(|candidate| candidate.beyond_reach);
        let agree = self.candidate.filter(|candidate| {
            let moved = f64::from(new.position.wrapping_sub(candidate.last.position));
            moved.abs() <= self.reach(self.elapsed(candidate.last, new))
        });
        let (from, mut steps) = agree.map_or((last, self.steps), |before| (before.last, before.steps));
        let step = steps.take(new.position, self.elapsed(from, new));
        if within_reach && self.plausible(moved, dt) {
            return self.accept_motion(new, (moved, dt), answer.status, may_index, (steps, step));
        }
        self.contradicted = self.contradicted && agree.is_none();
        let answers = agree.map_or(0, |candidate| candidate.answers) + 1;
        let near_zero = f64::from(new.position).abs() <= self.reach(dt);
        let referenced = |status: Option<Status>| status.is_none_or(|status| status.any(Status::SYNCHRONIZED));
        let index = may_index && !within_reach && near_zero && referenced(answer.status);
        let status = answer.status.or(agree.and_then(|before| before.status));
        self.candidate = Some(Candidate { last: new, status, answers, beyond_reach: !within_reach && !index, steps });
        let Some(before) = agree.filter(|_| answers >= ANSWERS_TO_CONFIRM) else {
            return if index { Verdict::Unconfirmed } else { Verdict::Implausible };
        };
        if within_reach {
            return self.accept_motion(new, (moved, dt), status, may_index, (steps, step));
        }
        if index && status.is_none() {
            return Verdict::Unconfirmed;
        }
        if index && referenced(before.status) {
            let velocity = self.velocity.map(|(velocity, _)| velocity);
            self.accept(new, velocity, dt);
            self.steps.forget();
            return Verdict::Indexed(before.status);
        }
        if answers < ANSWERS_TO_JUMP {
            return Verdict::Implausible;
        }
        self.begin(new.position, at);
        Verdict::Jumped { from: last.position, status }
    }

    /// Velocity between the last two accepted positions, increments/s; zero at the beginning.
    pub(super) fn velocity(&self) -> f64 {
        self.velocity.map_or(0.0, |(velocity, _)| velocity)
    }

    /// Whether the motor can have moved to `position` from zero in `time`.
    pub(super) fn is_near_zero(&self, position: i32, time: Duration) -> bool {
        f64::from(position).abs() <= self.reach(time.as_secs_f64())
    }

    /// Whether the position of the last answer was beyond reach, which the next answers may confirm.
    pub(super) fn is_beyond_reach(&self) -> bool {
        self.candidate.is_some_and(|candidate| candidate.beyond_reach)
    }

    /// Accepts a position within reach, `moved` increments from the last accepted one in `dt` seconds. `checked` is the check
    /// of steps with all answers up to this one, and the step that the answer confirms. If these answers show no step, only
    /// the accepted positions are checked.
    fn accept_motion(
        &mut self,
        new: Sample,
        (moved, dt): (f64, f64),
        status: Option<Status>,
        may_index: bool,
        checked: (StepCheck, Option<CounterStep>),
    ) -> Verdict {
        self.accept(new, Some(moved / dt), dt);
        let (steps, step) = checked;
        let step = if step.is_some() || steps.is_undecided() {
            self.steps = steps;
            step
        } else {
            self.steps.take(new.position, dt)
        };
        match step {
            Some(step) if !may_index => Verdict::Jumped { from: new.position.wrapping_sub(step.moved), status },
            _ => Verdict::Plausible,
        }
    }

    fn accept(&mut self, new: Sample, velocity: Option<f64>, dt: f64) {
        self.velocity = velocity.map(|velocity| (velocity, dt));
        self.last = Some(new);
        self.candidate = None;
    }

    fn elapsed(&self, from: Sample, to: Sample) -> f64 {
        to.at.since(from.at).as_secs_f64().max(self.period / 2.0)
    }

    /// Greatest distance in `dt`, increments, one of them for the encoder's edge.
    fn reach(&self, dt: f64) -> f64 {
        self.max_velocity * (dt + self.period / 4.0) + 1.0
    }

    /// Whether the greatest acceleration covers the change between the mean velocities of two intervals, in the time
    /// between their middles. Each distance may be wrong by an encoder's edge, each time by a quarter of a period.
    fn plausible(&self, moved: f64, dt: f64) -> bool {
        let Some((velocity, before)) = self.velocity else {
            return true;
        };
        let accelerated = self.max_acceleration * (dt + before) / 2.0 * dt;
        let late = (velocity.abs() * 2.0 + self.max_acceleration * dt) * self.period / 4.0;
        let edges = 1.0 + dt / before;
        (moved - velocity * dt).abs() <= accelerated + late + edges
    }
}

/// The last measured values, of one answer or of several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Measured {
    pub(super) position: Increments,
    pub(super) current: Milliamperes,
    pub(super) status: Status,
}

impl Measured {
    /// Takes the values of an answer, and keeps those that the answer does not have.
    pub(super) fn take(&mut self, answer: Answer) {
        *self = Self {
            position: answer.position,
            current: answer.current.unwrap_or(self.current),
            status: answer.status.unwrap_or(self.status),
        };
    }
}

/// Plausibility check for a drive whose answers stay the same in every bit while its set-points change.
///
/// A motor at rest or stalled may send equal answers for hours. Answers count from the change of set-points on.
#[derive(Clone, Copy, Debug)]
pub(super) struct FreezeCheck {
    /// Change of the set-points from which on equal answers count, in the units of the drive.
    significant_change: i32,
    answer: Measured,
    /// Equal answers since the set-points changed.
    answers: u32,
    /// Least and greatest set-point since the answers are equal.
    setpoints: (i16, i16),
}

impl FreezeCheck {
    pub(super) fn new(full_scale: i16) -> Self {
        Self {
            significant_change: i32::from(full_scale) / 20,
            answer: Measured::default(),
            answers: 0,
            setpoints: (0, 0),
        }
    }

    /// Judges an answer that came while `setpoint` was the last one sent. `responsive` says that the motor should
    /// react to set-points. Returns the number of equal answers once there are too many.
    pub(super) fn judge(&mut self, answer: Measured, setpoint: i16, responsive: bool) -> Option<u32> {
        if answer != self.answer || !responsive {
            *self = Self { answer, answers: 0, setpoints: (setpoint, setpoint), ..*self };
            return None;
        }
        let (low, high) = self.setpoints;
        let (low, high) = (low.min(setpoint), high.max(setpoint));
        self.setpoints = (low, high);
        if i32::from(high) - i32::from(low) > self.significant_change {
            self.answers += 1;
        }
        (self.answers >= ANSWERS_TO_FREEZE).then_some(self.answers)
    }
}
