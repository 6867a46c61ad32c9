//! Bring-up of one axis controller.

use std::time::Duration;

use can::Instant;
use serial::Line;
use serial::nfv2::Status;

use super::config::{AxisConfig, GroupConfig, Protocol};
use super::fault::AxisControllerError;
use super::objects::Objects;
use super::plausibility::{PositionCheck, Verdict};
use super::stream::{Answer, Stream, speaks};
use super::telegram::{ControllerMode, Dialect, Telegram};
use super::{AxisCounters, axis::Learnt};

/// Last address of the search for a drive: the IRp-6's drives have 0 to 15.
const LAST_ADDRESS: u8 = 15;

/// Calls that wait for silence on the line before the first request goes out anyway.
const CALLS_TO_DRAIN: u8 = 3;

/// How often a request is made before its silence counts.
const ATTEMPTS: u8 = 3;

/// Answers that are judged if one of the script took more than a period.
const ANSWERS_IN_DOUBT: usize = 40;

/// Brings one drive up: to manual mode, where latched errors clear, with its limits set.
///
/// ```text
/// drain → manual → manual → greatest current → manual → ready
///           each until it is answered, three times
///                └ silence → probe of every address, then of the other protocol → the error that names the drive
/// ```
///
/// Operation begins with the last answer: the plausibility check has accepted it, and the power stage is on. A line is
/// refused if most answers took more than a period, since in operation an answer has to come within one. If some did,
/// the last request is repeated until 40 answers are judged. The line is then refused if more than a quarter of the
/// periods had no answer, as in operation. An answer to a repeated request took more than a period. Calls of a host
/// that catches up with its deadlines do not count as periods.
#[derive(Clone, Debug)]
pub(super) struct BringUp {
    dialect: Dialect,
    period: Duration,
    answer_timeout: Duration,
    script: [Telegram; 5],
    /// Answers until the end of bring-up.
    questions: usize,

    stage: Stage,
    stream: Stream,
    position_check: PositionCheck,
    attempts: u8,
    asked_at: Instant,
    since: Instant,
    /// Bytes heard since the last answer.
    heard: u32,
    /// Calls since the question.
    calls: u32,
    /// Answers that took more than one call and more than a period.
    late: usize,
    last: Option<Answer>,
    /// Why the last answer was refused.
    objection: Option<AxisControllerError>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Draining(u8),
    /// The request of this step is next, or waits for its answer.
    Asking(usize),
    /// A request was repeated: both answers have to arrive before the next request.
    Settling(usize),
    /// A drive is searched for in this protocol and at this address.
    Probing(Protocol, u8),
    Ready,
}

impl BringUp {
    /// Begins at `now`. The configuration is checked.
    pub(super) fn new(group: &GroupConfig, config: &AxisConfig, dialect: Dialect, now: Instant) -> Self {
        let manual = dialect.rest(ControllerMode::Manual, 1, false);
        let limit = config.limit().expect("an axis without a current is refused");
        let limit = dialect.max_current(limit.0);
        Self {
            dialect,
            period: group.period,
            answer_timeout: group.answer_timeout,
            script: [dialect.opening(), manual, manual, limit, manual],
            questions: 5,
            stage: Stage::Draining(0),
            stream: Stream::new(dialect.protocol, dialect.address),
            position_check: PositionCheck::new(group, config),
            attempts: 0,
            asked_at: now,
            since: now,
            heard: 0,
            calls: 0,
            late: 0,
            last: None,
            objection: None,
        }
    }

    /// Start of operation, once the drive is ready.
    pub(super) fn learnt(self) -> Option<Learnt> {
        let answer = self.last.filter(|_| self.stage == Stage::Ready)?;
        Some(Learnt { answer, at: self.asked_at, stream: self.stream })
    }

    /// Reads the line and sends the next request. Returns whether the drive is ready.
    pub(super) fn advance(
        &mut self,
        line: &mut impl Line,
        buffer: &mut [u8],
        counters: &mut AxisCounters,
        now: Instant,
    ) -> Result<bool, AxisControllerError> {
        let count = line.read(now, buffer).map_err(AxisControllerError::Line)?;
        let bytes = &buffer[..count];
        let late = now.since(self.asked_at) >= self.answer_timeout;
        let next = match self.stage {
            Stage::Ready => return Ok(true),
            Stage::Draining(calls) if count > 0 && calls < CALLS_TO_DRAIN => {
                self.stage = Stage::Draining(calls + 1);
                None
            }
            Stage::Draining(_) => Some(Stage::Asking(0)),
            Stage::Asking(step) => {
                self.heard = self.heard.saturating_add(count as u32);
                self.calls = self.calls.saturating_add(1);
                if self.answered(bytes, counters, step) {
                    let took = now.since(self.asked_at);
                    // Halfway to the second period: calls are not punctual.
                    let late = self.attempts > 0 || self.calls > 1 && took > self.period * 3 / 2;
                    self.late += usize::from(late);
                    if step + 1 == self.questions {
                        self.judge_late_answers()?;
                    }
                    let repeated = self.attempts > 0;
                    (self.heard, self.attempts, self.since) = (0, 0, now);
                    if repeated {
                        self.stage = Stage::Settling(step + 1);
                        None
                    } else {
                        Some(self.step(step + 1))
                    }
                } else if !late {
                    None
                } else {
                    self.attempts += 1;
                    Some(if self.attempts < ATTEMPTS { self.stage } else { self.unanswered()? })
                }
            }
            Stage::Settling(step) => late.then(|| self.step(step)),
            Stage::Probing(protocol, address) => match speaks(protocol, bytes) {
                Some(found) => return Err(self.stranger(protocol, found)),
                None if !late => None,
                None => match self.next_probe(protocol, address) {
                    Some(probe) => Some(probe),
                    None => {
                        let waited = now.since(self.since);
                        return Err(AxisControllerError::Silent { waited });
                    }
                },
            },
        };
        let telegram = match next {
            None => return Ok(false),
            Some(Stage::Asking(step)) => self.script[step.min(self.script.len() - 1)],
            Some(Stage::Probing(protocol, address)) => self.dialect.probe(protocol, address),
            Some(Stage::Draining(_) | Stage::Settling(_) | Stage::Ready) => Telegram::NONE,
        };
        self.stage = next.unwrap_or(self.stage);
        if self.stage != Stage::Ready {
            (self.asked_at, self.calls) = (now, 0);
            // What the line does not take is not answered either.
            line.write(now, telegram.bytes()).map_err(AxisControllerError::Line)?;
        }
        Ok(self.stage == Stage::Ready)
    }

    /// Whether the request is answered. The last answer must come from a drive that has power.
    fn answered(&mut self, bytes: &[u8], counters: &mut AxisCounters, step: usize) -> bool {
        let all = |answer: &Answer| answer.objects() == Objects::All;
        let Some(answer) = self.stream.take(bytes, 1, Objects::All, counters).answer.filter(all) else {
            return false;
        };
        self.stream.learn(bytes);
        let before = self.last.map(|last| last.position.0);
        self.objection = match self.position_check.judge(answer, self.asked_at, false) {
            Verdict::Implausible | Verdict::Unconfirmed | Verdict::Jumped { .. } | Verdict::Indexed(_) => {
                let to = answer.position.0;
                let from = before.unwrap_or(to);
                Some(AxisControllerError::Unsteady { from, to })
            }
            Verdict::Plausible if step + 1 < self.script.len() => None,
            Verdict::Plausible => {
                let dark = answer.status.is_some_and(|status| status.any(Status::POWER_STAGE_FAULT));
                dark.then_some(AxisControllerError::PowerStage)
            }
        };
        if self.objection.is_none() {
            self.last = Some(answer);
        }
        self.objection.is_none()
    }

    /// Refuses a line whose answers come too late for a cycle. Asks on where too few answers were judged.
    fn judge_late_answers(&mut self) -> Result<(), AxisControllerError> {
        let (late, answers) = (self.late, self.questions);
        // Each late answer adds a period without one.
        if late > answers / 2 || answers == ANSWERS_IN_DOUBT && 4 * late > answers + late {
            return Err(AxisControllerError::Late { late, answers });
        }
        if late > 0 {
            self.questions = ANSWERS_IN_DOUBT;
        }
        Ok(())
    }

    /// The stage of a step of the script, or of its end.
    fn step(&self, step: usize) -> Stage {
        if step < self.questions { Stage::Asking(step) } else { Stage::Ready }
    }

    /// The probe after `address` did not answer. NFv2 addresses are probed one by one, as drives obey a broadcast
    /// without an answer. The older protocol has no addresses.
    fn next_probe(&self, protocol: Protocol, address: u8) -> Option<Stage> {
        if protocol == Protocol::Nfv2 && address < LAST_ADDRESS {
            Some(Stage::Probing(protocol, address + 1))
        } else {
            (protocol == self.dialect.protocol).then_some(Stage::Probing(protocol.other(), 0))
        }
    }

    /// The stage after a request without an answer in any attempt.
    fn unanswered(&self) -> Result<Stage, AxisControllerError> {
        if let Some(objection) = self.objection {
            return Err(objection);
        }
        if let Some(found) = self.stream.foreign() {
            return Err(self.stranger(Protocol::Nfv2, found));
        }
        if self.heard > 0 {
            let bytes = self.heard;
            return Err(AxisControllerError::Garbled { bytes });
        }
        Ok(Stage::Probing(self.dialect.protocol, 0))
    }

    fn stranger(&self, found: Protocol, address: u8) -> AxisControllerError {
        let expected = self.dialect.protocol;
        if found != expected {
            return AxisControllerError::OtherProtocol { expected, found };
        }
        if address == self.dialect.address || found == Protocol::HiMoxa {
            // It answers late.
            return AxisControllerError::Silent { waited: self.asked_at.since(self.since) };
        }
        AxisControllerError::OtherAddress { expected: self.dialect.address, found: address }
    }
}
