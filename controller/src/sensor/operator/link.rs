//! The connection of tasks with an operator: a queue of lines, and a queue of texts that the panel formats.

use std::fmt::{self, Display, Formatter};
use std::iter;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};

use super::{OperatorError, Question};
use crate::sensor::try_lock;

/// The operator's end of an [`OperatorLink`]. A dropped queue of lines is a closed input.
#[derive(Debug)]
pub struct OperatorPanel {
    /// Queue of the operator's lines. Use `try_send`: if a thread waits for room in `send`, a step must make a system
    /// call to wake this thread.
    pub lines: SyncSender<String>,
    /// Questions and messages for the operator, one line each.
    pub texts: OperatorTexts,
}

/// Queue of the texts for an operator. The texts are formatted when they are read.
#[derive(Debug)]
pub struct OperatorTexts(Receiver<Text>);

impl OperatorTexts {
    /// The oldest text that was not read. The call does not wait.
    pub fn try_recv(&self) -> Result<String, TryRecvError> {
        loop {
            match self.0.try_recv()? {
                Text::Spent(line) => drop(line),
                text => return Ok(text.to_string()),
            }
        }
    }

    /// The texts that were not read, oldest first. The iterator does not wait.
    pub fn try_iter(&self) -> impl Iterator<Item = String> {
        iter::from_fn(|| self.try_recv().ok())
    }
}

/// A text for the operator before it is formatted.
#[derive(Debug)]
pub(super) enum Text {
    Message(String),
    Asked(Arc<Question>),
    Refused {
        question: Arc<Question>,
        line: String,
    },
    TooLate(String),
    Withdrawn(Arc<Question>),
    Unanswered(Arc<Question>, OperatorError),
    /// No text, but the line of an earlier answer. The panel frees the memory of the line.
    Spent(String),
}

impl Display for Text {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Message(text) => f.write_str(text),
            Self::Asked(question) if question.choices().is_empty() => f.write_str(question.text()),
            Self::Asked(question) => write!(f, "{} [{}]", question.text(), question.choices().join("/")),
            Self::Refused { question, line } => {
                write!(f, "{:?} is no answer; answers are {}", line.trim(), question.choices().join(", "))
            }
            Self::TooLate(line) => write!(f, "{:?} came too late for the question before", line.trim()),
            Self::Withdrawn(question) => write!(f, "{}: the question is withdrawn", question.text()),
            Self::Unanswered(question, error) => write!(f, "{}: {error}", question.text()),
            Self::Spent(_) => Ok(()),
        }
    }
}

/// A task's end of the connection with an operator. Clones share the connection.
#[derive(Clone, Debug)]
pub struct OperatorLink(Arc<Desk>);

#[derive(Debug)]
struct Desk {
    /// The open question takes lines from this queue. No caller waits for the lock.
    lines: Mutex<Receiver<String>>,
    texts: SyncSender<Text>,
    /// Whether a question is open.
    open: AtomicBool,
    /// Whether the last question ended without an answer. One late line must not answer the next question.
    unanswered: AtomicBool,
}

impl OperatorLink {
    /// A link with room for this number of lines, and of texts, at least one of each. A text that does not fit is not
    /// shown.
    pub fn new(capacity: usize) -> (Self, OperatorPanel) {
        // A queue without room would make both ends wait for each other.
        let (line_end, lines) = sync_channel(capacity.max(1));
        let (texts, text_end) = sync_channel(capacity.max(1));
        let (open, unanswered) = (AtomicBool::new(false), AtomicBool::new(false));
        let link = Self(Arc::new(Desk { lines: Mutex::new(lines), texts, open, unanswered }));
        (link, OperatorPanel { lines: line_end, texts: OperatorTexts(text_end) })
    }

    /// A link to an operator who gives this answer, once, and sees nothing: for rehearsals.
    pub fn rehearsed(answer: &str) -> Self {
        let (link, panel) = Self::new(1);
        // The queue has room for one line.
        let _ = panel.lines.try_send(answer.to_owned());
        link
    }

    /// Shows a text to the operator.
    pub fn show(&self, text: impl Into<String>) {
        self.tell(Text::Message(text.into()));
    }

    /// Queues a text. The call neither waits nor allocates.
    pub(super) fn tell(&self, text: Text) {
        // A full queue or a closed panel: the text is not shown.
        let _ = self.0.texts.try_send(text);
    }

    /// The queue of lines; `None` while another thread has the queue.
    pub(super) fn lines(&self) -> Option<MutexGuard<'_, Receiver<String>>> {
        try_lock(&self.0.lines)
    }

    /// Opens a question, unless another question is open. Returns whether a waiting line may be a late answer to the
    /// previous question.
    pub(super) fn open(&self) -> Option<bool> {
        let opened = !self.0.open.swap(true, Ordering::AcqRel);
        opened.then(|| self.0.unanswered.swap(false, Ordering::AcqRel))
    }

    /// Closes the open question. A line may come late for a question that is `unanswered`.
    pub(super) fn close(&self, unanswered: bool) {
        self.0.unanswered.store(unanswered, Ordering::Release);
        self.0.open.store(false, Ordering::Release);
    }
}
