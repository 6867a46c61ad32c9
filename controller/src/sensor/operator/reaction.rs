//! The virtual sensor of the operator's reaction.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;

use can::Instant;

use super::link::Text;
use super::question::Answer;
use super::{Asking, OperatorError, OperatorLink, Question};
use crate::generator::SensorReading;
use crate::sensor::{VirtualSensor, try_lock};

/// Reading of an [`Operator`]: the reaction to a question. There is no reading before the reaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// The choice with this index; 0 if every line is an answer.
    Answered(u8),
    /// The input is closed.
    Closed,
    /// The deadline has passed.
    Late,
}

impl SensorReading for Reaction {}

impl Reaction {
    fn of(result: &Result<Answer, OperatorError>) -> Self {
        match result {
            Ok(Answer { choice, .. }) => Self::Answered(u8::try_from(*choice).unwrap_or(u8::MAX)),
            Err(OperatorError::Closed) => Self::Closed,
            Err(OperatorError::Late { .. }) => Self::Late,
        }
    }
}

/// Command of a generator to an [`Operator`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorCommand {
    /// Ask the question, in place of a question that is still open.
    Ask,
    /// Wait for the answer.
    Wait,
}

/// Virtual sensor of the operator's reaction to a question, for
/// [`OperatorReaction`](crate::generator::OperatorReaction). A generator tells the sensor when to ask.
///
/// The sensor neither waits nor allocates in a step. A step in which a task reads the answer has no reading.
#[derive(Debug)]
pub struct Operator {
    link: OperatorLink,
    question: Arc<Question>,
    inquiry: Arc<Mutex<Inquiry>>,
    /// Whether a command to ask was not carried out yet.
    asked: bool,
}

/// The answer to the question of an [`Operator`]. A question under way is withdrawn when this handle is dropped.
#[derive(Debug)]
pub struct OperatorAnswer {
    question: Arc<Question>,
    inquiry: Arc<Mutex<Inquiry>>,
}

/// A question of a sensor and its answer, shared by the sensor and the task. The sensor does not wait for the lock.
#[derive(Debug, Default)]
pub(super) struct Inquiry {
    asking: Option<Asking>,
    answered: Option<(Instant, Result<Answer, OperatorError>)>,
}

impl Operator {
    /// A sensor for this question, and the handle of its answer.
    pub fn new(link: &OperatorLink, question: Question) -> (Self, OperatorAnswer) {
        let (question, inquiry) = (Arc::new(question), Arc::default());
        let answer = OperatorAnswer { question: Arc::clone(&question), inquiry: Arc::clone(&inquiry) };
        (Self { link: link.clone(), question, inquiry, asked: false }, answer)
    }

    /// Begins the question, if a command asked for it.
    fn begin(&mut self) {
        if !self.asked {
            return;
        }
        let Some(mut inquiry) = try_lock(&self.inquiry) else {
            return;
        };
        self.asked = false;
        inquiry.asking = Some(Asking::of(&self.link, &self.question));
        if let Some((_, Ok(answer))) = inquiry.answered.take() {
            self.link.tell(Text::Spent(answer.line));
        }
    }
}

impl VirtualSensor for Operator {
    type Reading = Reaction;
    type Command = OperatorCommand;

    fn configure(&mut self, command: &OperatorCommand) {
        self.asked |= *command == OperatorCommand::Ask;
        self.begin();
    }

    fn poll(&mut self, now: Instant) -> Option<(Instant, Reaction)> {
        self.begin();
        let mut inquiry = try_lock(&self.inquiry).filter(|_| !self.asked)?;
        if let Some(asking) = &mut inquiry.asking
            && let Poll::Ready(result) = asking.advance(now)
        {
            (inquiry.asking, inquiry.answered) = (None, Some((now, result)));
        }
        let (at, result) = inquiry.answered.as_ref()?;
        Some((*at, Reaction::of(result)))
    }
}

impl OperatorAnswer {
    /// The answer to the last question that was asked; `None` before the answer.
    pub fn get(&self) -> Option<Result<String, OperatorError>> {
        let inquiry = self.inquiry();
        let (_, result) = inquiry.answered.as_ref()?;
        Some(result.as_ref().map(|Answer { line, choice }| self.question.worded(*choice, line)).map_err(|error| *error))
    }

    pub(super) fn inquiry(&self) -> MutexGuard<'_, Inquiry> {
        self.inquiry.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for OperatorAnswer {
    fn drop(&mut self) {
        self.inquiry().asking = None;
    }
}
