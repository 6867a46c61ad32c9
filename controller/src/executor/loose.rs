//! Loose coordination: the task gives orders to one effector at any time.

use can::Instant;

use super::Agents;
use crate::coordination::{CoordinatorEnd, LinkError};
use crate::generator::{Message, Sample};

/// The task's end of a link to one agent. Orders of type `C` are the image [`A`](crate::generator::A) of the agent's
/// generators, and answers of type `R` are their output [`Answer`](crate::generator::Answer).
pub struct LooseLink<C, R> {
    agents: Agents,
    robot: usize,
    end: CoordinatorEnd<C, R>,
}

impl<C: Message, R: Message> LooseLink<C, R> {
    pub(super) fn new(agents: Agents, robot: usize, end: CoordinatorEnd<C, R>) -> Self {
        Self { agents, robot, end }
    }

    /// Gives an order. A step of the agent takes the newest order and drops the older ones.
    ///
    /// An agent in motion takes orders in every servo cycle. Without a motion, and in a motion of a team, up to four
    /// messages (orders and ends) wait. Fails with [`LinkError::Full`] for the fifth message, and with
    /// [`LinkError::Gone`] if a newer link has replaced this link.
    pub fn order(&mut self, order: C) -> Result<(), LinkError> {
        let now = self.now();
        let sent = self.end.order(now, order);
        self.told(sent)
    }

    /// Ends the present motion of the agent with success. The agent acts in the next servo cycle, also in a pause: the
    /// effector brakes, and macrosteps sent ahead are dropped. A motion that has not begun ends without a movement.
    ///
    /// The order of the calls decides which motion ends:
    ///
    /// - While the effector brakes at the end of a motion or after a dropped motion, the call is for this motion and
    ///   has no further effect.
    /// - A call before [`Replacer::replace`](super::Replacer::replace) is for the replaced motion. A call after
    ///   `replace` ends the replacement.
    /// - Without a motion, and once the task awaits its next instruction, the call ends the next motion.
    ///
    /// Fails like [`order`](Self::order), and with [`LinkError::InTeam`] in a motion of a team: the team's coordinator ends
    /// the motion of all members.
    pub fn end_motion(&mut self) -> Result<(), LinkError> {
        if self.agents.is_in_team(self.robot) {
            return Err(LinkError::InTeam);
        }
        let now = self.now();
        let sent = self.end.end_motion(now);
        self.told(sent)
    }

    /// The result of a call that has sent a message, or not.
    fn told(&self, sent: bool) -> Result<(), LinkError> {
        if self.end.is_abandoned() {
            return Err(LinkError::Gone);
        }
        sent.then_some(()).ok_or(LinkError::Full)
    }

    /// The latest answer, with its age; `None` if no step has answered since the last call.
    pub fn answer(&mut self) -> Result<Option<Sample<R>>, LinkError> {
        let answer = self.end.answer()?;
        Ok(answer.map(|(_, sample)| sample.aged(self.now())))
    }

    fn now(&self) -> Instant {
        self.agents.now()
    }
}
