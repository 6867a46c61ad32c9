//! A team of robots in tight coordination.

use std::sync::Arc;

use controller::coordination::{Coordinator, LinkConfig};
#[cfg(feature = "test-hooks")]
use controller::executor::DisturbedMessage;
use controller::executor::{self, Members, TeamError};
use controller::sensor::{Shell, VirtualSensor};

use super::{Outcome, Robot, TaskError};
use crate::cell::CellFile;

/// Robots that execute motions together under one coordinator.
pub struct Team<'a, const N: usize> {
    file: Arc<CellFile>,
    team: executor::Team<'a, N>,
}

impl<'a, const N: usize> Team<'a, N> {
    pub(super) fn new(file: &Arc<CellFile>, members: [&'a mut Robot; N], link: LinkConfig) -> Self {
        let members = members.map(|robot| &mut robot.agent);
        Self { file: Arc::clone(file), team: executor::Team::new(members, link) }
    }

    /// Disturbs one message of the next motion.
    #[cfg(feature = "test-hooks")]
    #[doc(hidden)]
    pub fn disturb(&mut self, message: DisturbedMessage) {
        self.team.disturb(message);
    }

    /// The same team with another configuration of the links between the coordinator and its members.
    #[must_use]
    pub fn linked(mut self, link: LinkConfig) -> Self {
        self.team.link_by(link);
        self
    }

    /// Gives the coordinators of this team a virtual sensor, whose readings are [`Coordinator::Sensors`]. See
    /// [`Robot::sense`].
    pub fn sense<S: VirtualSensor>(&mut self, sensor: S, shell: Shell, period: u16) -> Outcome {
        Ok(self.team.sense(sensor, shell, period)?)
    }

    /// Executes a motion of all members: the functions of the coordinator, and a generator per member
    /// ([`Members`]: an array, or a tuple of different generators). The motion ends when the terminal condition of the
    /// coordinator holds, or when the generators of all members have ended. All members then stand. If a member ends alone,
    /// the motion fails.
    ///
    /// After an error all members stand or are faulted. If the returned future is dropped, all members brake.
    pub async fn execute<K, G>(&mut self, coordinator: K, generators: G) -> Outcome
    where
        K: Coordinator<N>,
        G: Members<K::Answer, N>,
    {
        let executed = self.team.execute(coordinator, generators).await;
        executed.map_err(|error| match error {
            TeamError::Member(error) => {
                TaskError::Instruction { robot: self.file.cell.robot[error.robot].name.as_str().into(), error }
            }
            TeamError::Coordinator(error) => TaskError::Coordinator(error),
        })
    }
}
