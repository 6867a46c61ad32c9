//! The operator: questions, answers, and the operator's reaction as a virtual sensor.
//!
//! An [`OperatorLink`] connects tasks with an [`OperatorPanel`]. The link never waits: threads of the panel read lines
//! and show texts. Each line is the answer to the open question, or to the next question. One question is open at a time,
//! and other questions wait.

use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use thiserror::Error;

use super::VirtualSensor;
use crate::generator::SensorReading;

/// The operator's end of an [`OperatorLink`]. Dropping `lines` closes the input.
#[derive(Debug)]
pub struct OperatorPanel {
    /// Queue of the operator's lines.
    pub lines: SyncSender<String>,
    /// Questions and messages for the operator, one line each.
    pub texts: Receiver<String>,
}

/// A task's end of the connection with an operator. Clones share the connection.
#[derive(Clone, Debug)]
pub struct OperatorLink(Arc<Mutex<Desk>>);

#[derive(Debug)]
struct Desk {
    lines: Receiver<String>,
    texts: SyncSender<String>,
    /// Whether a question is open.
    open: bool,
    /// Whether the last question ended without an answer. A late line must not answer the next question.
    unanswered: bool,
}

/// A question to the operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    text: String,
    choices: Vec<String>,
    rehearsed: Option<String>,
    deadline: Option<Duration>,
}

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

impl OperatorLink {
    /// A link with room for `capacity` lines and `capacity` texts. A text that does not fit is not shown.
    pub fn new(capacity: usize) -> (Self, OperatorPanel) {
        let (line_end, lines) = sync_channel(capacity);
        let (texts, text_end) = sync_channel(capacity);
        let link = Self(Arc::new(Mutex::new(Desk { lines, texts, open: false, unanswered: false })));
        (link, OperatorPanel { lines: line_end, texts: text_end })
    }

    /// A link for rehearsals, without an operator: gives `answer` once, and shows no texts.
    pub fn rehearsed(answer: &str) -> Self {
        let (link, panel) = Self::new(1);
        // The queue has room for one line.
        let _ = panel.lines.try_send(answer.to_owned());
        link
    }

    /// Shows a text to the operator.
    pub fn show(&self, text: impl Into<String>) {
        self.desk().show(text);
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Desk {
    fn show(&self, text: impl Into<String>) {
        // A full queue or a closed panel: the text is not shown.
        let _ = self.texts.try_send(text.into());
    }
}

impl Question {
    /// A question with a choice of answers. Upper and lower case are not distinguished.
    pub fn new(text: impl Into<String>, choices: impl IntoIterator<Item = impl Into<String>>) -> Self {
        let choices = choices.into_iter().map(Into::into).collect();
        Self { text: text.into(), choices, rehearsed: None, deadline: None }
    }

    /// A question to which every line is an answer.
    pub fn open(text: impl Into<String>) -> Self {
        Self::new(text, [""; 0])
    }

    /// The same question with an answer for rehearsals. Without such an answer, a rehearsal ends at the question.
    #[must_use]
    pub fn rehearsed(self, answer: impl Into<String>) -> Self {
        Self { rehearsed: Some(answer.into()), ..self }
    }

    /// The same question with a deadline, by the time of the servo cycles, from the moment at which the question is
    /// shown.
    #[must_use]
    pub fn within(self, deadline: Duration) -> Self {
        Self { deadline: Some(deadline), ..self }
    }

    /// The text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The answers; empty if every line is an answer.
    pub fn choices(&self) -> &[String] {
        &self.choices
    }

    /// The answer in a rehearsal.
    pub fn rehearsed_answer(&self) -> Option<&str> {
        self.rehearsed.as_deref()
    }

    /// The answer in a line: the choice as written in the question, or the line itself if the question has no choices.
    pub fn answer_of(&self, line: &str) -> Option<String> {
        let line = line.trim();
        if self.choices.is_empty() {
            return Some(line.to_owned());
        }
        self.choices.iter().find(|choice| choice.eq_ignore_ascii_case(line)).cloned()
    }
}

/// A question to the operator that is under way. A question that is dropped without an answer is withdrawn.
#[derive(Debug)]
pub struct Asking {
    link: OperatorLink,
    question: Question,
    /// Time at which the question was shown.
    since: Option<Instant>,
}

impl Asking {
    /// A question that the first poll shows, unless another question is open.
    pub fn new(link: &OperatorLink, question: Question) -> Self {
        Self { link: link.clone(), question, since: None }
    }

    /// Shows the question once no other question is open, and takes the lines received so far. A line that is not an answer
    /// is refused with a message.
    pub fn poll(&mut self, now: Instant) -> Poll<Result<String, OperatorError>> {
        let mut desk = self.link.desk();
        let Question { text, choices, deadline, .. } = &self.question;
        let since = match self.since {
            Some(since) => since,
            None if desk.open => return Poll::Pending,
            None => {
                if std::mem::replace(&mut desk.unanswered, false) {
                    while let Ok(line) = desk.lines.try_recv() {
                        desk.show(format!("{:?} came too late for the question before", line.trim()));
                    }
                }
                desk.open = true;
                let choices = if choices.is_empty() { String::new() } else { format!(" [{}]", choices.join("/")) };
                desk.show(format!("{text}{choices}"));
                *self.since.insert(now)
            }
        };
        let result = loop {
            match desk.lines.try_recv() {
                Ok(line) => match self.question.answer_of(&line) {
                    Some(answer) => break Ok(answer),
                    None => desk.show(format!("{:?} is no answer; answers are {}", line.trim(), choices.join(", "))),
                },
                Err(TryRecvError::Disconnected) => break Err(OperatorError::Closed),
                Err(TryRecvError::Empty) => match *deadline {
                    Some(limit) if now.since(since) > limit => break Err(OperatorError::Late { limit }),
                    _ => return Poll::Pending,
                },
            }
        };
        if let Err(error) = result {
            desk.show(format!("{text}: {error}"));
        }
        (desk.open, desk.unanswered, self.since) = (false, result.is_err(), None);
        Poll::Ready(result)
    }
}

impl Drop for Asking {
    fn drop(&mut self) {
        if self.since.is_some() {
            let mut desk = self.link.desk();
            (desk.open, desk.unanswered) = (false, true);
            desk.show(format!("{}: the question is withdrawn", self.question.text));
        }
    }
}

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

/// Command of a generator to an [`Operator`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorCommand {
    /// Ask the question. A question under way is withdrawn.
    Ask,
    /// Wait for the answer.
    Wait,
}

/// Virtual sensor of the operator's reaction to a question, for
/// [`OperatorReaction`](crate::generator::OperatorReaction). A generator tells the sensor when to ask.
#[derive(Debug)]
pub struct Operator {
    link: OperatorLink,
    question: Question,
    inquiry: Arc<Mutex<Inquiry>>,
}

/// The answer to the question of an [`Operator`]. A question under way is withdrawn when this handle is dropped.
#[derive(Debug)]
pub struct OperatorAnswer(Arc<Mutex<Inquiry>>);

#[derive(Debug, Default)]
struct Inquiry {
    asking: Option<Asking>,
    answered: Option<(Instant, Result<String, OperatorError>)>,
}

impl Operator {
    /// A sensor for this question, and the handle of its answer.
    pub fn new(link: &OperatorLink, question: Question) -> (Self, OperatorAnswer) {
        let inquiry = Arc::default();
        let answer = OperatorAnswer(Arc::clone(&inquiry));
        (Self { link: link.clone(), question, inquiry }, answer)
    }

    fn reaction(&self, result: &Result<String, OperatorError>) -> Reaction {
        match result {
            Ok(answer) => {
                let index = self.question.choices.iter().position(|choice| choice == answer).unwrap_or(0);
                Reaction::Answered(index.try_into().unwrap_or(u8::MAX))
            }
            Err(OperatorError::Closed) => Reaction::Closed,
            Err(OperatorError::Late { .. }) => Reaction::Late,
        }
    }
}

impl VirtualSensor for Operator {
    type Reading = Reaction;
    type Command = OperatorCommand;

    fn configure(&mut self, command: &OperatorCommand) {
        if *command == OperatorCommand::Ask {
            let asking = Some(Asking::new(&self.link, self.question.clone()));
            *lock(&self.inquiry) = Inquiry { asking, answered: None };
        }
    }

    fn poll(&mut self, now: Instant) -> Option<(Instant, Reaction)> {
        let mut inquiry = lock(&self.inquiry);
        if let Some(asking) = &mut inquiry.asking
            && let Poll::Ready(result) = asking.poll(now)
        {
            *inquiry = Inquiry { asking: None, answered: Some((now, result)) };
        }
        let (at, result) = inquiry.answered.as_ref()?;
        Some((*at, self.reaction(result)))
    }
}

impl OperatorAnswer {
    /// The answer to the last question asked; `None` before the answer.
    pub fn get(&self) -> Option<Result<String, OperatorError>> {
        lock(&self.0).answered.as_ref().map(|(_, result)| result.clone())
    }
}

impl Drop for OperatorAnswer {
    fn drop(&mut self) {
        lock(&self.0).asking = None;
    }
}

fn lock(inquiry: &Mutex<Inquiry>) -> MutexGuard<'_, Inquiry> {
    inquiry.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    //! Questions and their answers, without threads.

    use super::*;

    const fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn at(milliseconds: u64) -> Instant {
        Instant::ZERO + ms(milliseconds)
    }

    fn asked() -> (Asking, OperatorLink, OperatorPanel) {
        let (link, panel) = OperatorLink::new(8);
        (Asking::new(&link, Question::new("Next motion?", ["yes", "no"]).within(ms(100))), link, panel)
    }

    fn texts(panel: &OperatorPanel) -> Vec<String> {
        panel.texts.try_iter().collect()
    }

    #[test]
    fn a_line_that_is_no_choice_is_refused_and_the_question_stays_open() {
        let (mut asking, _link, panel) = asked();
        panel.lines.send("perhaps".to_owned()).unwrap();
        assert_eq!(asking.poll(at(0)), Poll::Pending);
        assert_eq!(texts(&panel), ["Next motion? [yes/no]", "\"perhaps\" is no answer; answers are yes, no"]);
        panel.lines.send(" YES ".to_owned()).unwrap();
        assert_eq!(asking.poll(at(1)), Poll::Ready(Ok("yes".to_owned())));
        drop(asking);
        assert!(texts(&panel).is_empty(), "an answered question is not withdrawn");
    }

    #[test]
    fn a_deadline_ends_a_question_without_an_answer() {
        let (mut asking, _link, _panel) = asked();
        // The deadline counts from the poll that shows the question.
        assert_eq!(asking.poll(at(500)), Poll::Pending);
        assert_eq!(asking.poll(at(600)), Poll::Pending);
        let limit = ms(100);
        assert_eq!(asking.poll(at(601)), Poll::Ready(Err(OperatorError::Late { limit })));
    }

    #[test]
    fn a_line_that_comes_after_its_question_does_not_answer_the_next_one() {
        let (mut asking, link, panel) = asked();
        assert_eq!(asking.poll(at(0)), Poll::Pending);
        assert!(asking.poll(at(101)).is_ready());
        panel.lines.send("yes".to_owned()).unwrap();
        let mut next = Asking::new(&link, Question::new("Drives off?", ["yes", "no"]));
        assert_eq!(next.poll(at(200)), Poll::Pending);
        panel.lines.send("no".to_owned()).unwrap();
        assert_eq!(next.poll(at(300)), Poll::Ready(Ok("no".to_owned())));
        assert!(texts(&panel).contains(&"\"yes\" came too late for the question before".to_owned()));
    }

    #[test]
    fn lines_before_the_end_of_the_input_are_answers_and_then_the_input_is_closed() {
        let (mut asking, link, panel) = asked();
        panel.lines.send("no".to_owned()).unwrap();
        drop(panel);
        assert_eq!(asking.poll(at(0)), Poll::Ready(Ok("no".to_owned())));
        let mut again = Asking::new(&link, Question::open("Name?"));
        assert_eq!(again.poll(at(0)), Poll::Ready(Err(OperatorError::Closed)));
    }

    #[test]
    fn one_question_is_open_at_a_time_and_a_dropped_question_is_withdrawn() {
        let (mut first, link, panel) = asked();
        let mut second = Asking::new(&link, Question::open("Name?"));
        assert_eq!(first.poll(at(0)), Poll::Pending);
        assert_eq!(second.poll(at(0)), Poll::Pending);
        assert_eq!(texts(&panel), ["Next motion? [yes/no]"]);
        drop(first);
        assert_eq!(second.poll(at(1)), Poll::Pending);
        panel.lines.send("a name".to_owned()).unwrap();
        assert_eq!(second.poll(at(2)), Poll::Ready(Ok("a name".to_owned())));
        assert_eq!(texts(&panel), ["Next motion?: the question is withdrawn", "Name?"]);
    }

    #[test]
    fn the_sensor_reads_the_reaction_to_each_question_that_it_is_told_to_ask() {
        let (link, panel) = OperatorLink::new(8);
        let (mut sensor, answer) = Operator::new(&link, Question::new("Next motion?", ["yes", "no"]));
        assert_eq!(sensor.poll(at(0)), None);
        assert!(texts(&panel).is_empty(), "only a command of a generator asks");
        for (line, reaction, now) in [("yes", 0, 1), ("no", 1, 2)] {
            sensor.configure(&OperatorCommand::Ask);
            assert_eq!(sensor.poll(at(now)), None);
            sensor.configure(&OperatorCommand::Wait);
            panel.lines.send(line.to_owned()).unwrap();
            assert_eq!(sensor.poll(at(now)), Some((at(now), Reaction::Answered(reaction))));
            assert_eq!(answer.get(), Some(Ok(line.to_owned())));
        }
        drop(panel.lines);
        sensor.configure(&OperatorCommand::Ask);
        assert_eq!(sensor.poll(at(3)), Some((at(3), Reaction::Closed)));
    }

    #[test]
    fn a_question_of_the_sensor_is_withdrawn_with_the_handle_of_its_answer() {
        let (link, panel) = OperatorLink::new(8);
        let (mut sensor, answer) = Operator::new(&link, Question::open("Name?"));
        sensor.configure(&OperatorCommand::Ask);
        assert_eq!(sensor.poll(at(0)), None);
        drop(answer);
        assert_eq!(texts(&panel), ["Name?", "Name?: the question is withdrawn"]);
        assert!(matches!(Asking::new(&link, Question::open("Next?")).poll(at(0)), Poll::Pending));
    }
}
