//! Tasks: the instructions of one effector control process.

use std::{collections::VecDeque, fmt};

use crate::generator::{Execution, Generator, Run};

pub(super) enum Instruction {
    Enable,
    Home,
    Meet(u8),
    Tie(u32),
    Untie,
    Run(Box<dyn Execution + Send>),
    Disable,
    ResetFault,
}

/// A list of instructions, executed in order until one fails.
///
/// Generators plan in their first step, from the end of the previous motion. A task can therefore be written without
/// knowledge of the effector's position.
#[derive(Default)]
pub struct Task {
    pub(super) instructions: VecDeque<Instruction>,
}

impl Task {
    /// An empty task.
    pub fn new() -> Self {
        Self::default()
    }

    /// Switch the drives on and hold the position.
    #[must_use]
    pub fn enable(self) -> Self {
        self.then(Instruction::Enable)
    }

    /// Home the axes, unless all axes are homed.
    #[must_use]
    pub fn home(self) -> Self {
        self.then(Instruction::Home)
    }

    /// Stand until every partner of this meeting has come, then continue in the same cycle as the partners. The
    /// [`Meetings`](super::Meetings) of the cell define the partners. A task may come to a meeting any number of times.
    #[must_use]
    pub fn meet(self, meeting: u8) -> Self {
        self.then(Instruction::Meet(meeting))
    }

    /// Stand until every member has come to the same tie. Then the members are a team: they begin each macrostep in the
    /// same servo cycle, and a stop of one stops all ([`Order::Tie`](servo::Order::Tie)). Bit *i* of `members` is robot
    /// *i* of the cell, and this robot is a member.
    ///
    /// A generator that ends in motion without a successor is braked, which stops the team. A robot that a partner
    /// stopped stands with power on. The present instruction of this robot ends with
    /// [`StopCause::Partner`](servo::StopCause::Partner), or its next one if none is under way, unless the next one
    /// disables the robot or resets faults.
    #[must_use]
    pub fn tie(self, members: u32) -> Self {
        self.then(Instruction::Tie(members))
    }

    /// Leave the team. The robot stands.
    #[must_use]
    pub fn untie(self) -> Self {
        self.then(Instruction::Untie)
    }

    /// Move by a generator until its terminal condition holds and the effector stands.
    #[doc(alias = "Move")]
    #[must_use]
    pub fn run(self, generator: impl Generator) -> Self {
        self.then(Instruction::Run(Box::new(Run::new(generator))))
    }

    /// Switch the drives off.
    #[must_use]
    pub fn disable(self) -> Self {
        self.then(Instruction::Disable)
    }

    /// Clear latched faults. The drives stay off.
    #[must_use]
    pub fn reset_fault(self) -> Self {
        self.then(Instruction::ResetFault)
    }

    /// Number of remaining instructions.
    pub fn len(&self) -> usize {
        self.instructions.len()
    }

    /// Whether no instruction remains.
    pub fn is_empty(&self) -> bool {
        self.instructions.is_empty()
    }

    /// The instructions of this list, and then those of `next`.
    pub(crate) fn and(mut self, next: Self) -> Self {
        self.instructions.extend(next.instructions);
        self
    }

    fn then(mut self, instruction: Instruction) -> Self {
        self.instructions.push_back(instruction);
        self
    }
}

impl fmt::Debug for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Task({} instructions)", self.instructions.len())
    }
}
