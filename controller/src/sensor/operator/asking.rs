//! A question under way.

use std::sync::Arc;
use std::sync::mpsc::TryRecvError;
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use thiserror::Error;

use super::link::Text;
use super::question::Answer;
use super::{OperatorLink, Question};

/// Greatest number of lines that one poll takes. Further lines wait for the next poll.
const LINES_PER_POLL: usize = 16;

/// Reasons why a question has no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum OperatorError {
    /// The input has ended, and no line is left.
    #[error("the operator's input is closed")]
    Closed,
    /// The deadline of the question has passed.
    #[error("the operator gave no answer within {limit:?}")]
    Late {
        /// The deadline.
        limit: Duration,
    },
}

/// A question to the operator that is under way. A question that is dropped without an answer is withdrawn.
#[derive(Debug)]
pub struct Asking {
    link: OperatorLink,
    question: Arc<Question>,
    /// Time at which the question was shown.
    since: Option<Instant>,
}

impl Asking {
    /// A question that the first poll shows, unless another question is open.
    pub fn new(link: &OperatorLink, question: Question) -> Self {
        Self::of(link, &Arc::new(question))
    }

    pub(super) fn of(link: &OperatorLink, question: &Arc<Question>) -> Self {
        Self { link: link.clone(), question: Arc::clone(question), since: None }
    }

    /// Shows the question once no other question is open, and takes the lines that are there. A line that is no answer
    /// is refused with a message. If the previous question ended without an answer, the oldest line that already waits
    /// is taken for a late answer to that question, and is dropped.
    pub fn poll(&mut self, now: Instant) -> Poll<Result<String, OperatorError>> {
        self.advance(now).map_ok(|Answer { line, choice }| self.question.worded(choice, &line))
    }

    /// As [`poll`](Self::poll). The call neither waits, allocates nor formats.
    pub(super) fn advance(&mut self, now: Instant) -> Poll<Result<Answer, OperatorError>> {
        let Self { link, question, since } = self;
        let Some(lines) = link.lines() else {
            return Poll::Pending;
        };
        let shown = match *since {
            Some(shown) => shown,
            None => {
                let Some(may_be_late) = link.open() else {
                    return Poll::Pending;
                };
                if may_be_late && let Ok(line) = lines.try_recv() {
                    link.tell(Text::TooLate(line));
                }
                link.tell(Text::Asked(Arc::clone(question)));
                *since.insert(now)
            }
        };
        let mut result = None;
        for _ in 0..LINES_PER_POLL {
            result = match lines.try_recv() {
                Ok(line) => match question.choice_of(&line) {
                    Some(choice) => Some(Ok(Answer { line, choice })),
                    None => {
                        link.tell(Text::Refused { question: Arc::clone(question), line });
                        continue;
                    }
                },
                Err(TryRecvError::Disconnected) => Some(Err(OperatorError::Closed)),
                Err(TryRecvError::Empty) => None,
            };
            break;
        }
        let late = question.deadline().filter(|limit| now.since(shown) > *limit);
        let Some(result) = result.or(late.map(|limit| Err(OperatorError::Late { limit }))) else {
            return Poll::Pending;
        };
        if let Err(error) = result {
            link.tell(Text::Unanswered(Arc::clone(question), error));
        }
        // No line comes after the end of the input.
        link.close(matches!(result, Err(OperatorError::Late { .. })));
        *since = None;
        Poll::Ready(result)
    }
}

impl Drop for Asking {
    fn drop(&mut self) {
        if self.since.is_some() {
            self.link.close(true);
            self.link.tell(Text::Withdrawn(Arc::clone(&self.question)));
        }
    }
}
