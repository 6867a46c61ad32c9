//! Questions of a task to its operator, and the jog of a robot.

use std::mem::replace;
use std::task::Poll;
use std::time::Duration;

use anyhow::Context;
use controller::generator::{Jog, OperatorReaction};
use controller::sensor::{
    Asking, JogHandle, JogPanel, JogReading, Operator, OperatorError, OperatorLink, Question, Reaction, Shell,
};

use super::{Cell, Robot, TaskError};

/// The operator of a task.
#[derive(Clone)]
pub(super) struct Desk {
    pub(super) link: Option<OperatorLink>,
    /// Where messages go without an operator.
    pub(super) texts: Option<OperatorLink>,
    pub(super) rehearsing: bool,
    /// Whether there are contact and objects before the sensors.
    pub(super) surroundings: bool,
}

impl Desk {
    /// The link on which a question is asked: in a rehearsal a link with the answer for rehearsals.
    fn link(&self, question: &Question) -> Result<OperatorLink, TaskError> {
        let text = || question.text().to_owned();
        let Some(link) = &self.link else {
            return Err(TaskError::NoOperator { question: text() });
        };
        if !self.rehearsing {
            return Ok(link.clone());
        }
        let answer = question.rehearsed_answer();
        let answer = answer.ok_or(TaskError::NotRehearsed { why: "the task waits for an answer of the operator" })?;
        if question.answer_of(answer).is_none() {
            let choices = question.choices().join(", ");
            return Err(TaskError::RehearsedAnswer { question: text(), answer: answer.to_owned(), choices });
        }
        Ok(OperatorLink::rehearsed(answer))
    }
}

impl Cell {
    /// Asks the operator, and waits for the answer: a choice of the question, or a line if the question has no choices.
    /// A line that is not a choice is refused with a message, and the operator is asked again.
    ///
    /// A rehearsal takes the [answer for rehearsals](Question::rehearsed). Without this answer, the rehearsal ends
    /// here with success. A run without an operator refuses the question, before any motion if the rehearsal reaches the
    /// question. A closed input and a passed deadline are errors of the class non-fatal.
    pub async fn ask(&self, question: Question) -> Result<String, TaskError> {
        let (link, text) = (self.desk.link(&question)?, question.text().to_owned());
        let (mut asking, mut first) = (Asking::new(&link, question), true);
        // A loop over questions passes time.
        let answered =
            self.agents.until(|now, _| if replace(&mut first, false) { Poll::Pending } else { asking.poll(now) });
        answered.await.map_err(|error| TaskError::Unanswered { question: text, error })
    }

    /// Shows a message, with and without an operator (`--operator`): `mrroc run` prints the message on standard error. A
    /// rehearsal shows nothing.
    pub fn tell(&self, message: impl Into<String>) {
        let link = self.desk.link.as_ref().or(self.desk.texts.as_ref());
        if let Some(link) = link.filter(|_| !self.rehearsing()) {
            link.show(message);
        }
    }
}

impl Robot {
    /// Asks the operator as [`Cell::ask`] does, and holds the robot until the reaction: a motion by [`OperatorReaction`],
    /// which reads the virtual sensor [`Operator`].
    pub async fn ask(&mut self, question: Question) -> Result<String, TaskError> {
        let (link, text) = (self.desk.link(&question)?, question.text().to_owned());
        let (sensor, answer) = Operator::new(&link, question);
        // The sensor of an earlier question.
        self.remove_sensor::<Reaction>();
        self.sense(sensor, Shell::NonInteractive, 1)?;
        self.execute(OperatorReaction).await?;
        let answered = answer.get().unwrap_or(Err(OperatorError::Closed));
        answered.map_err(|error| TaskError::Unanswered { question: text, error })
    }

    /// A [`Jog`] of the robot within the limits of its joints, and the handle of its operator. Without a command for
    /// the time `dead_man`, the robot brakes. The robot gets the virtual sensor [`JogPanel`], which the jog reads.
    pub fn jog(&mut self, dead_man: Duration) -> anyhow::Result<(Jog, JogHandle)> {
        let motions = self.motions();
        let jog = Jog::new(motions.arm().clone(), motions.limits(), dead_man).context("the robot cannot be jogged")?;
        let (panel, handle) = JogPanel::new();
        // The panel of an earlier jog.
        self.remove_sensor::<JogReading>();
        self.sense(panel, Shell::NonInteractive, 1)?;
        Ok((jog, handle))
    }
}
