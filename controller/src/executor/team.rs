//! A team of effectors under one coordinator.

use std::cell::Cell;
use std::task::Poll;

use thiserror::Error;

use super::join::Part;
use super::{Agent, InstructionError, join_all};
use crate::coordination::{Answers, Conduct, Coordinator, CoordinatorError, Disturbance, LinkConfig, link};
use crate::ecp::Task;
use crate::generator::Generator;

/// Effectors that execute motions together: tight coordination.
///
/// The servo begins each macrostep of all members in the same cycle. Whatever stops one member brakes all members in the
/// same cycle.
pub struct Team<'a, const N: usize> {
    members: [&'a mut Agent; N],
    link: LinkConfig,
    disturbed: Option<DisturbedMessage>,
}

/// A message of a team that is disturbed, for tests.
#[derive(Clone, Copy, Debug)]
pub struct DisturbedMessage {
    /// Index of the member in the team.
    pub member: usize,
    /// Whether the message is an answer of the member. Otherwise it is an order to the member.
    pub answer: bool,
    /// Number of the step.
    pub step: u64,
    /// What happens to the message.
    pub disturbance: Disturbance,
}

/// Errors of a motion of a team. All members stand or are faulted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum TeamError {
    /// The motion of a member failed.
    #[error("{0}")]
    Member(InstructionError),
    /// The coordinator failed.
    #[error("coordinator: {0}")]
    Coordinator(CoordinatorError),
}

impl<'a, const N: usize> Team<'a, N> {
    /// A team of these members. `link` is the configuration of each link to the coordinator.
    pub fn new(members: [&'a mut Agent; N], link: LinkConfig) -> Self {
        Self { members, link, disturbed: None }
    }

    /// Disturbs one message of the next motion, for tests of the reaction.
    pub fn disturb(&mut self, message: DisturbedMessage) {
        self.disturbed = Some(message);
    }

    /// Executes a motion of all members: the functions of the coordinator, and a generator per member. Ends when the
    /// terminal condition of the coordinator holds and all members stand, or when all generators have ended.
    ///
    /// If the returned future is dropped, all members brake.
    pub async fn execute<K, G>(&mut self, coordinator: K, generators: [G; N]) -> Result<(), TeamError>
    where
        K: Coordinator<N>,
        G: Generator<Out: Answers<K::Answer>>,
    {
        let members = self.members.iter().fold(0, |set, member| set | 1 << member.robot());
        let (agents, macrostep) = (self.members[0].agents().clone(), self.members[0].cell_macrostep());
        let (mut number, disturbed) = (0, self.disturbed.take());
        let links = self.members.each_mut().map(|member| {
            let (mut coordinator_end, mut member_end) = link::<K::Order, K::Answer>(self.link);
            match disturbed.filter(|message| message.member == number) {
                Some(DisturbedMessage { answer: true, step, disturbance, .. }) => member_end.disturb(step, disturbance),
                Some(DisturbedMessage { step, disturbance, .. }) => coordinator_end.disturb(step, disturbance),
                None => {}
            }
            number += 1;
            member.follow(Some(Box::new(member_end)));
            coordinator_end
        });
        let mut conduct = Conduct::new(coordinator, links, macrostep, self.link.deadline);
        let under_way = Cell::new(N);
        let mut parts: Vec<Part<TeamError>> = Vec::with_capacity(N + 1);
        for (member, generator) in self.members.iter_mut().zip(generators) {
            let list = Task::new().tie(members).run(generator).untie();
            let under_way = &under_way;
            parts.push(Box::pin(async move {
                let following = Following(member);
                following.0.perform(list).await.map_err(TeamError::Member)?;
                under_way.set(under_way.get() - 1);
                Ok(())
            }));
        }
        parts.push(Box::pin(agents.until(|now, slowed| {
            // Members that have ended their motions by themselves need no coordinator.
            if under_way.get() == 0 {
                return Poll::Ready(Ok(()));
            }
            conduct.poll(now, slowed).map_err(TeamError::Coordinator)
        })));
        join_all(parts).await
    }
}

/// A member on its link to the coordinator. The link ends with this value.
struct Following<'a>(&'a mut Agent);

impl Drop for Following<'_> {
    fn drop(&mut self) {
        self.0.follow(None);
    }
}
