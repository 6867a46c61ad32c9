//! Loose coordination: the task gives orders to one effector at any time.

use can::Instant;

use super::Agents;
use crate::coordination::{CoordinatorEnd, LinkError};
use crate::generator::{Message, Sample};

/// The task's end of a link to one agent. Orders of type `C` are the image [`A`](crate::generator::A) of the agent's
/// generators, and answers of type `R` are their output [`Answer`](crate::generator::Answer).
pub struct LooseLink<C, R> {
    agents: Agents,
    end: CoordinatorEnd<C, R>,
}

impl<C: Message, R: Message> LooseLink<C, R> {
    pub(super) fn new(agents: Agents, end: CoordinatorEnd<C, R>) -> Self {
        Self { agents, end }
    }

    /// Gives an order. A step of the agent takes the newest order and drops older orders. Fails with [`LinkError::Full`] if
    /// no step has taken the last four orders.
    pub fn order(&mut self, order: C) -> Result<(), LinkError> {
        let now = self.now();
        self.end.order(now, order).then_some(()).ok_or(LinkError::Full)
    }

    /// Ends the present motion of the agent, or its next motion if there is none. Fails like [`order`](Self::order).
    pub fn end_motion(&mut self) -> Result<(), LinkError> {
        let now = self.now();
        self.end.end_motion(now).then_some(()).ok_or(LinkError::Full)
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
