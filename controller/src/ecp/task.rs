//! Tasks: the instructions of one effector control process.

use std::collections::VecDeque;
use std::fmt;

use crate::generator::{Execution, Generator, Run};

/// One instruction of a task.
pub(super) enum Instruction {
    Enable,
    Home,
    Meet(u8),
    Run(Box<dyn Execution + Send>),
    Disable,
    ResetFault,
}

/// A list of instructions, done in order until one fails.
///
/// Generators plan in their first step, from where the motion before has ended, so a task can be written
/// down without knowing where the effector is.
#[derive(Default)]
pub struct Task {
    pub(super) instructions: VecDeque<Instruction>,
}

impl Task {
    /// Nothing to do yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Switch the drives on and stand.
    #[must_use]
    pub fn enable(self) -> Self {
        self.then(Instruction::Enable)
    }

    /// Home the axes, unless all are.
    #[must_use]
    pub fn home(self) -> Self {
        self.then(Instruction::Home)
    }

    /// Stand until every partner of this meeting has come, then go on in the same cycle as they do. The
    /// [`Meetings`](super::Meetings) of the cell know who they are.
    #[must_use]
    pub fn meet(self, meeting: u8) -> Self {
        self.then(Instruction::Meet(meeting))
    }

    /// Move as a generator says, until its terminal condition holds and the effector stands.
    #[doc(alias = "Move")]
    #[must_use]
    pub fn run<G>(self, generator: G) -> Self
    where
        G: Generator + Send + 'static,
        G::Memory: Send,
    {
        self.then(Instruction::Run(Box::new(Run::new(generator))))
    }

    /// Switch the drives off.
    #[must_use]
    pub fn disable(self) -> Self {
        self.then(Instruction::Disable)
    }

    /// Clear latched faults; the drives stay off.
    #[must_use]
    pub fn reset_fault(self) -> Self {
        self.then(Instruction::ResetFault)
    }

    /// Instructions still to do.
    pub fn len(&self) -> usize {
        self.instructions.len()
    }

    /// Whether nothing is to be done.
    pub fn is_empty(&self) -> bool {
        self.instructions.is_empty()
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
