//! A team of robots in tight coordination.

use std::sync::Arc;

use controller::coordination::{Answers, Coordinator, LinkConfig};
use controller::executor::{self, DisturbedMessage, TeamError};
use controller::generator::Generator;

use super::{Outcome, Robot, TaskError};
use crate::cell::CellFile;

/// Robots that execute motions together under one coordinator.
pub struct Team<'a, const N: usize> {
    file: Arc<CellFile>,
    members: [&'a mut Robot; N],
    link: LinkConfig,
    disturbed: Option<DisturbedMessage>,
}

impl<'a, const N: usize> Team<'a, N> {
    pub(super) fn new(file: &Arc<CellFile>, members: [&'a mut Robot; N], link: LinkConfig) -> Self {
        Self { file: Arc::clone(file), members, link, disturbed: None }
    }

    /// Disturbs one message of the next motion, for tests of the reaction to a bad wire.
    pub fn disturb(&mut self, message: DisturbedMessage) {
        self.disturbed = Some(message);
    }

    /// The same team with these links between the coordinator and its members.
    #[must_use]
    pub fn linked(self, link: LinkConfig) -> Self {
        Self { link, ..self }
    }

    /// Executes a motion of all members: the functions of the coordinator, and a generator per member. The motion ends
    /// when the terminal condition of the coordinator holds and all members stand.
    ///
    /// After an error all members stand or are faulted. If the returned future is dropped, all members brake.
    pub async fn execute<K, G>(&mut self, coordinator: K, generators: [G; N]) -> Outcome
    where
        K: Coordinator<N>,
        G: Generator<Out: Answers<K::Answer>>,
    {
        let members = self.members.each_mut().map(|robot| &mut robot.agent);
        let mut team = executor::Team::new(members, self.link);
        if let Some(message) = self.disturbed.take() {
            team.disturb(message);
        }
        let executed = team.execute(coordinator, generators).await;
        executed.map_err(|error| match error {
            TeamError::Member(error) => {
                TaskError::Instruction { robot: self.file.cell.robot[error.robot].name.clone(), error }
            }
            TeamError::Coordinator(error) => TaskError::Coordinator(error),
        })
    }
}
