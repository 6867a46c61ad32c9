//! The coordinator C0 of a team in tight coordination.

use std::fmt::Debug;
use std::time::Duration;

use thiserror::Error;

use super::LinkError;
use crate::generator::{Answer, Commands, GeneratorError, Message, Outputs, Readings, Sample, Tell};

/// Functions of the coordinator of `N` members, and the condition that ends the motion.
///
/// In macrostep *i* the coordinator reads its own sensors and the answers *a*j0(*i*) of all members, all from the same
/// step. The coordinator then gives the orders *a*0j(*i* + 1). As in a [`Generator`](crate::generator::Generator), next
/// steps must not block or allocate.
pub trait Coordinator<const N: usize>: Send + Sync + 'static {
    /// Order to a member, `a0`.
    type Order: Message;
    /// Answer of a member.
    type Answer: Message;
    /// Readings of the coordinator's own virtual sensors: `()` or [`V`](crate::generator::V).
    type Sensors: Readings;
    /// Command to a sensor of the coordinator: `()` or [`Tell`].
    type Out: Commands;
    /// The coordinator's own memory, `c0`.
    type Memory: Copy + Debug + Send + 'static;

    /// Plans the motion, and gives the orders for the first steps of the members. `macrostep` is the duration of the
    /// cell's macrostep, which all members keep. The members stand during this step. The time limit is the same as for
    /// the first step of a generator.
    fn first_step(&mut self, sensors: &Self::Sensors, macrostep: Duration) -> Result<Orders<Self, N>, GeneratorError>;

    /// Whether the motion ends. All members then end after the step to which these answers belong, and brake if they
    /// move.
    fn terminal(&self, memory: &Self::Memory, answers: &[Sample<Self::Answer>; N], sensors: &Self::Sensors) -> bool;

    /// The orders of the next step.
    fn next_step(
        &self,
        memory: &Self::Memory,
        answers: &[Sample<Self::Answer>; N],
        sensors: &Self::Sensors,
    ) -> Result<Orders<Self, N>, GeneratorError>;
}

/// Result of one step of the coordinator type `K` with `N` members.
pub type Orders<K, const N: usize> =
    NextOrders<<K as Coordinator<N>>::Order, <K as Coordinator<N>>::Memory, N, <K as Coordinator<N>>::Out>;

/// Result of one step of a coordinator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct NextOrders<C, M, const N: usize, O = ()> {
    /// The order to each member.
    pub orders: [C; N],
    /// The memory of the next step.
    pub memory: M,
    /// The command to a sensor.
    pub out: O,
}

impl<C, M, const N: usize> NextOrders<C, M, N> {
    /// These orders, and no command to a sensor.
    pub const fn new(orders: [C; N], memory: M) -> Self {
        Self { orders, memory, out: () }
    }

    /// The same orders with this command to a sensor.
    pub fn with<O: Commands>(self, out: O) -> NextOrders<C, M, N, O> {
        NextOrders { orders: self.orders, memory: self.memory, out }
    }
}

/// Outputs with an answer of type `R`. Sealed like [`Outputs`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no answer of type `{R}` to the coordinator",
    note = "a member of a team declares `type Out = Answer<..>` with the `Answer` type of its coordinator"
)]
pub trait Answers<R>: Outputs {}
impl<R: Message> Answers<R> for Answer<R> {}
impl<C: Message, R: Message> Answers<R> for (Tell<C>, Answer<R>) {}

/// Errors of a coordinator. After an error all members of the team brake.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum CoordinatorError {
    #[error("step {step}: {error}")]
    Generator { step: u64, error: GeneratorError },
    #[error("step {step}, link to member {member}: {error}")]
    Link { step: u64, member: usize, error: LinkError },
    #[error("step {step}: no answer of member {member} within {waited:?}")]
    Silent { step: u64, member: usize, waited: Duration },
    #[error("step {step}: no reading of a sensor within {waited:?}")]
    Unread { step: u64, waited: Duration },
    #[error("the first step takes longer than {waited:?}")]
    Unplanned { waited: Duration },
    #[error("step {step}: the queue of orders to member {member} is full")]
    Full { step: u64, member: usize },
}
