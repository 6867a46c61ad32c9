//! A team of effectors under one coordinator.

use std::cell::Cell;
use std::task::Poll;

use thiserror::Error;

use super::join::Part;
use super::{Agent, InstructionError, join_all};
use crate::coordination::{Answers, Conduct, Coordinator, CoordinatorError, LinkConfig, link};
#[cfg(feature = "test-hooks")]
use crate::coordination::{CoordinatorEnd, Disturbance, MemberEnd};
use crate::ecp::Task;
use crate::generator::Generator;
#[cfg(feature = "test-hooks")]
use crate::generator::Message;
use crate::sensor::{SensorRefused, Sensors, Shell, VirtualSensor};

/// Effectors that execute motions together: tight coordination.
///
/// The servo begins each macrostep of all members in the same cycle. Any stop of one member brakes all members from the
/// same cycle.
pub struct Team<'a, const N: usize> {
    members: [&'a mut Agent; N],
    link: LinkConfig,
    sensors: Sensors,
    #[cfg(feature = "test-hooks")]
    disturbed: Option<DisturbedMessage>,
}

/// A message of a team that is disturbed.
#[cfg(feature = "test-hooks")]
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct DisturbedMessage {
    /// Index of the member in the team.
    pub member: usize,
    /// Whether the message is an answer of the member. Otherwise it is an order to the member.
    pub answer: bool,
    /// Number of the step.
    pub step: u64,
    /// The disturbance of the message.
    pub disturbance: Disturbance,
}

/// A generator for each of the `N` members of a team, with answers of type `R`: an array of generators of one type, or a
/// tuple of two or three generators.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no set of generators for {N} members with answers of type `{R}`",
    note = "give an array of generators, or a tuple of two or three, each with `type Out = Answer<..>` of the coordinator"
)]
pub trait Members<R, const N: usize> {
    /// The motion of each member.
    fn motions(self) -> [Task; N];
}

impl<R, G: Generator<Out: Answers<R>>, const N: usize> Members<R, N> for [G; N] {
    fn motions(self) -> [Task; N] {
        self.map(|generator| Task::new().run(generator))
    }
}

impl<R, F: Generator<Out: Answers<R>>, G: Generator<Out: Answers<R>>> Members<R, 2> for (F, G) {
    fn motions(self) -> [Task; 2] {
        [Task::new().run(self.0), Task::new().run(self.1)]
    }
}

impl<R, F, G, H> Members<R, 3> for (F, G, H)
where
    F: Generator<Out: Answers<R>>,
    G: Generator<Out: Answers<R>>,
    H: Generator<Out: Answers<R>>,
{
    fn motions(self) -> [Task; 3] {
        [Task::new().run(self.0), Task::new().run(self.1), Task::new().run(self.2)]
    }
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
        Self {
            members,
            link,
            sensors: Sensors::default(),
            #[cfg(feature = "test-hooks")]
            disturbed: None,
        }
    }

    /// Replaces the configuration of the links.
    pub fn link_by(&mut self, link: LinkConfig) {
        self.link = link;
    }

    /// Disturbs one message of the next motion.
    #[cfg(feature = "test-hooks")]
    #[doc(hidden)]
    pub fn disturb(&mut self, message: DisturbedMessage) {
        self.disturbed = Some(message);
    }

    /// Gives the coordinators of this team a virtual sensor, as [`Sensors::install`].
    pub fn sense<S: VirtualSensor>(&mut self, sensor: S, shell: Shell, period: u16) -> Result<(), SensorRefused> {
        self.sensors.install(sensor, shell, period)
    }

    /// Executes a motion of all members: the functions of the coordinator, and a generator per member. The members
    /// begin after the first step of the coordinator. The motion ends at the terminal condition of the coordinator, or
    /// after the end of all generators. All members stand when the future completes.
    ///
    /// If the returned future is dropped, all members brake.
    pub async fn execute<K, G>(&mut self, coordinator: K, generators: G) -> Result<(), TeamError>
    where
        K: Coordinator<N>,
        G: Members<K::Answer, N>,
    {
        let Self { members, sensors, link: config, .. } = self;
        let robots = members.each_ref().map(|member| member.robot());
        let set = robots.iter().fold(0, |set, robot| set | 1 << robot);
        let (agents, macrostep) = (members[0].agents().clone(), members[0].cell_macrostep());
        let ends = std::array::from_fn::<_, N, _>(|_| link::<K::Order, K::Answer>(*config));
        #[cfg(feature = "test-hooks")]
        let ends = disturb(ends, self.disturbed.take());
        let mut ends = ends.into_iter();
        let links = members.each_mut().map(|member| {
            let (coordinator_end, member_end) = ends.next().expect("each member has a link");
            member.follow_team(Some(Box::new(member_end)));
            coordinator_end
        });
        let mut conduct = Conduct::new(coordinator, links, sensors, macrostep, config.deadline);
        let following = members.each_mut().map(|member| Following(member));
        agents.at_desk(robots, |desk| conduct.begin(desk)).await.map_err(TeamError::Coordinator)?;
        let under_way = Cell::new(N);
        let mut parts: Vec<Part<TeamError>> = Vec::with_capacity(N + 1);
        for (member, motion) in following.into_iter().zip(generators.motions()) {
            let list = Task::new().tie(set).and(motion).untie();
            let under_way = &under_way;
            parts.push(Box::pin(async move {
                let member = member;
                member.0.perform(list).await.map_err(TeamError::Member)?;
                under_way.set(under_way.get() - 1);
                Ok(())
            }));
        }
        parts.push(Box::pin(agents.at_desk(robots, |desk| {
            // Members that have ended their motions by themselves need no coordinator.
            if under_way.get() == 0 {
                return Poll::Ready(Ok(()));
            }
            conduct.poll(desk).map_err(TeamError::Coordinator)
        })));
        join_all(parts).await
    }
}

/// The links of a team, with one message disturbed.
#[cfg(feature = "test-hooks")]
fn disturb<C: Message, R: Message, const N: usize>(
    mut links: [(CoordinatorEnd<C, R>, MemberEnd<C, R>); N],
    message: Option<DisturbedMessage>,
) -> [(CoordinatorEnd<C, R>, MemberEnd<C, R>); N] {
    if let Some(DisturbedMessage { member, answer, step, disturbance }) = message
        && let Some((coordinator_end, member_end)) = links.get_mut(member)
    {
        match answer {
            true => member_end.disturb(step, disturbance),
            false => coordinator_end.disturb(step, disturbance),
        }
    }
    links
}

/// A member on its link to the coordinator. The link ends with this value.
struct Following<'a>(&'a mut Agent);

impl Drop for Following<'_> {
    fn drop(&mut self) {
        self.0.follow_team(None);
    }
}
