//! The coordinator C0 of a team in tight coordination.

use std::fmt::Debug;
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use thiserror::Error;

use super::{CoordinatorEnd, LinkError};
use crate::generator::{Answer, Chart, Functions, GeneratorError, Message, Outputs, Sample, Tell};

/// Functions of the coordinator of `N` members, and the condition that ends the motion.
///
/// In macrostep *i* the coordinator reads the answers *a*j0(*i*) of all members from one step, and gives the orders
/// *a*0j(*i* + 1). Next steps must not block or allocate, as those of a
/// [`Generator`](crate::generator::Generator).
pub trait Coordinator<const N: usize>: Send + Sync + 'static {
    /// Order to a member, `a0`.
    type Order: Message;
    /// Answer of a member.
    type Answer: Message;
    /// The coordinator's own memory, `c0`.
    type Memory: Copy + Debug + Send + 'static;

    /// Plans the motion, and gives the orders for the first steps of the members. `macrostep` is that of the cell, and
    /// members keep it. Computed in the turn of the task: a plan that takes longer than a servo period delays all robots.
    fn first_step(&mut self, macrostep: Duration) -> Result<NextOrders<Self::Order, Self::Memory, N>, GeneratorError>;

    /// Whether the motion ends. All members end after step *i*, whose answers are given, and brake if they move.
    fn terminal(&self, memory: &Self::Memory, answers: &[Sample<Self::Answer>; N]) -> bool;

    /// The orders of the next step.
    fn next_step(
        &self,
        memory: &Self::Memory,
        answers: &[Sample<Self::Answer>; N],
    ) -> Result<NextOrders<Self::Order, Self::Memory, N>, GeneratorError>;
}

/// Result of one step of a coordinator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NextOrders<C, M, const N: usize> {
    /// The order to each member.
    pub orders: [C; N],
    /// The memory of the next step.
    pub memory: M,
}

/// Outputs with an answer of type `R`. Sealed like [`Outputs`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no answer of type `{R}` to the coordinator",
    note = "a member of a team declares `type Out = Answer<..>` with the `Answer` type of its coordinator"
)]
pub trait Answers<R>: Outputs {}
impl<R: Message> Answers<R> for Answer<R> {}
impl<C: Message, R: Message> Answers<R> for (Tell<C>, Answer<R>) {}

/// Errors of a coordinator. All members of its team brake.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum CoordinatorError {
    #[error("step {step}: {error}")]
    Generator { step: u64, error: GeneratorError },
    #[error("step {step}, link to member {member}: {error}")]
    Link { step: u64, member: usize, error: LinkError },
    #[error("step {step}: no answer of member {member} within {waited:?}")]
    Silent { step: u64, member: usize, waited: Duration },
    #[error("step {step}: the queue of orders to member {member} is full")]
    Full { step: u64, member: usize },
}

/// A coordinator as functions of the flow chart.
pub(crate) struct Lead<K, const N: usize>(K);

impl<K: Coordinator<N>, const N: usize> Functions for Lead<K, N> {
    type First = ();
    type Every = [Sample<K::Answer>; N];
    type Memory = K::Memory;
    type Results = [K::Order; N];

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<([K::Order; N], K::Memory), GeneratorError> {
        self.0.first_step(macrostep).map(|next| (next.orders, next.memory))
    }

    fn terminal(&self, memory: &K::Memory, answers: &Self::Every) -> bool {
        self.0.terminal(memory, answers)
    }

    fn next_step(
        &self,
        memory: &K::Memory,
        answers: &Self::Every,
    ) -> Result<([K::Order; N], K::Memory), GeneratorError> {
        self.0.next_step(memory, answers).map(|next| (next.orders, next.memory))
    }
}

/// A coordinator at work on the links to its members.
pub(crate) struct Conduct<K: Coordinator<N>, const N: usize> {
    chart: Chart<Lead<K, N>>,
    links: [CoordinatorEnd<K::Order, K::Answer>; N],
    answers: [Option<Sample<K::Answer>>; N],
    macrostep: Duration,
    /// Longest wait for an answer, in addition to two macrosteps. The answers of the first steps have no limit of their own,
    /// because the members plan.
    deadline: Duration,
    /// Number of the last orders, and their time; `None` before the first.
    sent: Option<(u64, Instant)>,
}

impl<K: Coordinator<N>, const N: usize> Conduct<K, N> {
    pub(crate) fn new(
        coordinator: K,
        links: [CoordinatorEnd<K::Order, K::Answer>; N],
        macrostep: Duration,
        deadline: Duration,
    ) -> Self {
        Self { chart: Chart::new(Lead(coordinator)), links, answers: [None; N], macrostep, deadline, sent: None }
    }

    /// Advances the coordinator at `now`. `slowed`: the motion time of the cell runs slower than the clock. Ready at the
    /// end of the motion.
    pub(crate) fn poll(&mut self, now: Instant, slowed: bool) -> Poll<Result<(), CoordinatorError>> {
        match self.advance(now, slowed) {
            Ok(false) => Poll::Pending,
            Ok(true) => Poll::Ready(Ok(())),
            Err(error) => Poll::Ready(Err(error)),
        }
    }

    fn advance(&mut self, now: Instant, slowed: bool) -> Result<bool, CoordinatorError> {
        let Some((step, since)) = self.sent else {
            let first = self.chart.first_step(&(), self.macrostep);
            let orders = first.map_err(|error| CoordinatorError::Generator { step: 0, error })?;
            self.give(0, orders, now)?;
            return Ok(false);
        };
        for (member, (link, answer)) in self.links.iter_mut().zip(&mut self.answers).enumerate() {
            if answer.is_none() {
                let came = link.answer().map_err(|error| CoordinatorError::Link { step, member, error })?;
                *answer = came.map(|(_, sample)| sample);
            }
        }
        if let Some(member) = self.answers.iter().position(Option::is_none) {
            let waited = now.since(since);
            if slowed {
                self.sent = Some((step, now));
            } else if step > 0 && waited > self.deadline + self.macrostep * 2 {
                return Err(CoordinatorError::Silent { step, member, waited });
            }
            return Ok(false);
        }
        let answers = std::mem::replace(&mut self.answers, [None; N]).map(|answer| answer.expect("all have answered"));
        let next = self.chart.next_step(&answers.map(|answer| answer.aged(now)));
        match next.map_err(|error| CoordinatorError::Generator { step: step + 1, error })? {
            Some(orders) => self.give(step + 1, orders, now)?,
            None => {
                // A member that has ended by itself takes no message.
                self.links.iter_mut().for_each(|link| _ = link.end_motion(now));
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn give(&mut self, step: u64, orders: [K::Order; N], now: Instant) -> Result<(), CoordinatorError> {
        for (member, (link, order)) in self.links.iter_mut().zip(orders).enumerate() {
            if !link.order(now, order) {
                return Err(CoordinatorError::Full { step, member });
            }
        }
        self.sent = Some((step, now));
        Ok(())
    }
}
