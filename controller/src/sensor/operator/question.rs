//! Questions to an operator.

use std::time::Duration;

/// A question to the operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    text: String,
    choices: Vec<String>,
    rehearsed: Option<String>,
    deadline: Option<Duration>,
}

/// A line that answers a question.
#[derive(Debug)]
pub(super) struct Answer {
    /// The line of the operator.
    pub(super) line: String,
    /// Index of the choice; 0 if every line is an answer.
    pub(super) choice: usize,
}

impl Question {
    /// A question with a choice of answers. Upper and lower case are the same.
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

    /// The answer of a line: a choice as it is written in the question, or the line.
    pub fn answer_of(&self, line: &str) -> Option<String> {
        self.choice_of(line).map(|choice| self.worded(choice, line))
    }

    pub(super) fn deadline(&self) -> Option<Duration> {
        self.deadline
    }

    /// Index of the choice in a line; 0 if every line is an answer.
    pub(super) fn choice_of(&self, line: &str) -> Option<usize> {
        if self.choices.is_empty() {
            return Some(0);
        }
        self.choices.iter().position(|choice| choice.eq_ignore_ascii_case(line.trim()))
    }

    /// The answer of a line with this choice.
    pub(super) fn worded(&self, choice: usize, line: &str) -> String {
        self.choices.get(choice).cloned().unwrap_or_else(|| line.trim().to_owned())
    }
}
