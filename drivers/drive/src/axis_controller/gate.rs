//! Plausibility check of measured positions.

use can::Instant;
use serial::nfv2::Status;

use super::config::{AxisConfig, GroupConfig};
use super::stream::Answer;

/// Answers in a row that must agree about a place that the motor cannot have reached before it is believed.
pub(super) const ANSWERS_TO_JUMP: u32 = 3;

/// Answers in a row that must agree about a place which is strange and yet possible, or where the index put it.
pub(super) const ANSWERS_TO_CONFIRM: u32 = 2;

/// Lets positions pass that the motor can have reached since the last one that passed.
///
/// A place is within reach if the greatest velocity gets there in the time between the requests that sampled both, and a
/// quarter of a period more, for telegrams that leave late. It is plausible if the greatest acceleration gets
/// there too, from the velocity between the last two that passed. What is within reach only passes once the
/// next answer agrees with it; what is beyond reach never does, and after three answers that agree it is a jump.
#[derive(Clone, Debug)]
pub(super) struct Gate {
    /// Increments/s.
    max_velocity: f64,
    /// Increments/s².
    max_acceleration: f64,
    /// s.
    period: f64,
    last: Option<Sample>,
    /// Between the last two that passed, increments/s, and the time between them, s.
    velocity: Option<(f64, f64)>,
    doubtful: Option<Doubt>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    position: i32,
    at: Instant,
}

/// What the last refused answers agree about.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    last: Sample,
    status: Status,
    answers: u32,
    /// It is beyond reach, and not where the index may have put it.
    beyond: bool,
}

/// What a position is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// One to go by.
    Passed,
    /// Not to go by.
    Refused,
    /// Not to go by yet: it looks like the index, and the next answer decides.
    Awaited,
    /// The index put the counter there; the status of the answer before, which agrees.
    Indexed(Status),
    /// The counter is there for good, and not by motion; where it was.
    Jumped(i32),
}

impl Gate {
    pub(super) fn new(group: &GroupConfig, axis: &AxisConfig) -> Self {
        let counts = axis.scale.increments_per_radian().abs();
        Self {
            max_velocity: axis.max_velocity * counts,
            max_acceleration: axis.max_acceleration * counts,
            period: group.period.as_secs_f64(),
            last: None,
            velocity: None,
            doubtful: None,
        }
    }

    /// Begins anew at a position that is believed.
    pub(super) fn begin(&mut self, position: i32, at: Instant) {
        self.last = Some(Sample { position, at });
        self.velocity = None;
        self.doubtful = None;
    }

    /// Judges an answer whose request left at `at`. `indexing` says that the drive may have set its counter to zero.
    pub(super) fn judge(&mut self, answer: Answer, at: Instant, indexing: bool) -> Verdict {
        let new = Sample {
            position: answer.position.0,
            at,
        };
        let Some(last) = self.last else {
            self.begin(new.position, at);
            return Verdict::Passed;
        };
        let dt = self.elapsed(last, new);
        let moved = f64::from(new.position.wrapping_sub(last.position));
        let within_reach = moved.abs() <= self.reach(dt);
        if within_reach && self.plausible(moved, dt) {
            self.pass(new, Some(moved / dt), dt);
            return Verdict::Passed;
        }
        let agree = self.doubtful.filter(|doubt| {
            let moved = f64::from(new.position.wrapping_sub(doubt.last.position));
            moved.abs() <= self.reach(self.elapsed(doubt.last, new))
        });
        let answers = agree.map_or(0, |doubt| doubt.answers) + 1;
        let near_zero = f64::from(new.position).abs() <= self.reach(dt);
        let referenced = |status: Status| status.any(Status::SYNCHRONIZED);
        let index = indexing && !within_reach && near_zero && referenced(answer.status);
        self.doubtful = Some(Doubt {
            last: new,
            status: answer.status,
            answers,
            beyond: !within_reach && !index,
        });
        let Some(before) = agree.filter(|_| answers >= ANSWERS_TO_CONFIRM) else {
            return if index {
                Verdict::Awaited
            } else {
                Verdict::Refused
            };
        };
        if within_reach {
            self.pass(new, Some(moved / dt), dt);
            return Verdict::Passed;
        }
        if index && referenced(before.status) {
            let velocity = self.velocity.map(|(velocity, _)| velocity);
            self.pass(new, velocity, dt);
            return Verdict::Indexed(before.status);
        }
        if answers < ANSWERS_TO_JUMP {
            return Verdict::Refused;
        }
        self.begin(new.position, at);
        Verdict::Jumped(last.position)
    }

    /// Velocity between the last two that passed, increments/s; zero at the beginning.
    pub(super) fn velocity(&self) -> f64 {
        self.velocity.map_or(0.0, |(velocity, _)| velocity)
    }

    /// Whether the last answer had a position beyond reach, which the next ones confirm or belie.
    pub(super) fn leapt(&self) -> bool {
        self.doubtful.is_some_and(|doubt| doubt.beyond)
    }

    fn pass(&mut self, new: Sample, velocity: Option<f64>, dt: f64) {
        self.velocity = velocity.map(|velocity| (velocity, dt));
        self.last = Some(new);
        self.doubtful = None;
    }

    fn elapsed(&self, from: Sample, to: Sample) -> f64 {
        to.at.since(from.at).as_secs_f64().max(self.period / 2.0)
    }

    /// Increments, one of them for the encoder's edge.
    fn reach(&self, dt: f64) -> f64 {
        self.max_velocity * (dt + self.period / 4.0) + 1.0
    }

    /// The mean velocities of two intervals differ by what the acceleration makes of the time between their
    /// middles. Either may be wrong by an encoder's edge and by a quarter of a period in its length.
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
