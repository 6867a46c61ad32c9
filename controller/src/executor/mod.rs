//! Tasks as programs: a deterministic executor for one `async` task on the effector control processes of a cell.
//!
//! A task takes [`Agent`]s from the [`Agents`] of its cell and awaits their instructions. The [`Executor`] polls the
//! processes and then the task, once per servo cycle and in a fixed order. The executor has no thread, clock or waker of
//! its own: in lockstep, a task is the same in every run.
//!
//! A task may await only the futures of this module: [`Agent::perform`], [`Agents::sleep`], [`Agents::until`], [`join`]
//! and [`join_all`]. Every wait for an instruction has the time limits of its process. If the future of an instruction
//! is dropped, the effector brakes. The next instruction of this effector begins after standstill.
//!
//! Errors have classes ([`Class`](crate::ecp::Class)). Errors of the classes non-fatal and fatal go to the task. A system
//! error drops the task and brakes all effectors.

mod agents;
mod error;
mod join;
mod loose;
mod team;
#[cfg(test)]
mod tests;
mod turns;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::task::{Context, Poll, Waker};

use can::Instant;

use crate::ecp::{Ecp, Status};

use join::Part;

pub use agents::{Agent, Agents, News, Observer, Replacer};
pub use error::{InstructionError, NotedError, SystemError};
pub use join::{join, join_all};
pub use loose::LooseLink;
#[cfg(feature = "test-hooks")]
pub use team::DisturbedMessage;
pub use team::{Members, Team, TeamError};
pub use turns::{Turns, Work};

/// How a task ended.
#[derive(Debug)]
pub enum Ended<E> {
    /// The task returned.
    Task(Result<(), E>),
    /// A system error ended the task.
    System(SystemError),
}

/// A task and the processes that execute its instructions. `E` is the error of the task.
pub struct Executor<E> {
    agents: Agents,
    task: Option<Part<'static, E>>,
    turns: Turns,
    ended: Option<Ended<E>>,
}

impl<E> Executor<E> {
    /// A task that has not begun. `task` uses `agents`, and `turns` counts its turns.
    pub fn new(agents: Agents, task: impl Future<Output = Result<(), E>> + 'static, turns: Turns) -> Self {
        Self { agents, task: Some(Box::pin(task)), turns, ended: None }
    }

    /// Polls each process, then the task, then the processes for which the task began or dropped an instruction. Call this
    /// function once after each servo cycle. The task begins after the first cycle.
    ///
    /// `news` is called with each news and the process that it concerns. Returns false when the task has ended and no
    /// process has an instruction.
    pub fn poll(&mut self, now: Instant, mut news: impl FnMut(&mut Ecp, News)) -> bool {
        self.poll_agents(now, false, &mut news);
        self.poll_task();
        self.poll_agents(now, true, &mut news);
        self.task.is_some() || self.agents.are_busy()
    }

    /// Ends the task with an error of the cell. All effectors brake.
    pub fn abort(&mut self, error: SystemError) {
        self.end(Ended::System(error));
    }

    /// Delays the next motion or meeting of a robot until a release (`held` is false). See [`Ecp::is_held`].
    pub fn hold(&mut self, robot: usize, held: bool) {
        self.agents.hold(robot, held);
    }

    /// Status of each process, in the order of the robots.
    pub fn statuses(&self) -> Vec<Status> {
        self.agents.statuses()
    }

    /// Drops a task that has not ended. Returns the end of the task, and the errors of instructions, oldest first:
    /// errors that the task received, and errors of instructions that the task dropped.
    pub fn finish(mut self) -> (Option<Ended<E>>, Vec<NotedError>) {
        self.drop_task();
        (self.ended.take(), self.agents.noted())
    }

    fn poll_agents(&mut self, now: Instant, fresh_only: bool, news: &mut impl FnMut(&mut Ecp, News)) {
        let polled = self.turns.count(Work::Steps, || self.agents.poll(now, fresh_only, news));
        if let Some(error) = polled {
            self.end(Ended::System(error));
        }
    }

    fn poll_task(&mut self) {
        let Some(task) = self.task.as_mut().filter(|_| self.agents.begin_turn()) else {
            return;
        };
        let turn = || task.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        let turn = || self.agents.within(|| catch_unwind(AssertUnwindSafe(turn)));
        let polled = self.turns.count(Work::Task, turn);
        match polled {
            Ok(Poll::Ready(outcome)) => self.end(Ended::Task(outcome)),
            Ok(Poll::Pending) if !self.agents.are_awaited() => self.end(Ended::System(SystemError::ForeignFuture)),
            Ok(Poll::Pending) => {}
            Err(_) => self.end(Ended::System(SystemError::Panicked)),
        }
    }

    /// Notes the end of a task in progress and drops its futures, which brakes the effectors.
    fn end(&mut self, ended: Ended<E>) {
        if self.task.is_some() {
            self.ended = Some(ended);
            self.drop_task();
        }
    }

    fn drop_task(&mut self) {
        let task = self.task.take();
        if catch_unwind(AssertUnwindSafe(|| drop(task))).is_err() {
            self.ended = Some(Ended::System(SystemError::Panicked));
        }
    }
}
