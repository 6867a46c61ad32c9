//! The flow chart of the paper's figure 3 for one generator.

use std::time::Duration;

use super::{Generator, GeneratorError, ImageSource, Images, Setpoint};

/// What one turn of the flow chart comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Go on, commanding the effector or letting it stand.
    Continue(Option<Setpoint>),
    /// The terminal condition holds.
    Ended,
}

/// A motion instruction under way: a generator of any class with its memory.
pub trait Execution {
    /// The first operational block of the chart.
    fn first_step(
        &mut self,
        source: &dyn ImageSource,
        macrostep: Duration,
    ) -> Result<Step, GeneratorError>;

    /// The dashed box: one snapshot, the terminal condition on it, then (5) to (8) on the same one,
    /// committed together.
    fn next_step(&mut self, source: &dyn ImageSource) -> Result<Step, GeneratorError>;

    /// Whether next steps read nothing but the generator's own memory, so that they may be computed
    /// before their turn.
    fn runs_ahead(&self) -> bool;
}

/// A generator, and its memory once the first step has been made.
pub(crate) struct Run<G: Generator> {
    generator: G,
    memory: Option<G::Memory>,
}

impl<G: Generator> Run<G> {
    pub(crate) const fn new(generator: G) -> Self {
        Self {
            generator,
            memory: None,
        }
    }
}

impl<G: Generator> Execution for Run<G> {
    fn first_step(
        &mut self,
        source: &dyn ImageSource,
        macrostep: Duration,
    ) -> Result<Step, GeneratorError> {
        let images = G::First::fetch(source)?;
        let next = self.generator.first_step(&images, macrostep)?;
        self.memory = Some(next.memory);
        Ok(Step::Continue(next.effector))
    }

    fn next_step(&mut self, source: &dyn ImageSource) -> Result<Step, GeneratorError> {
        // A runner that skips the first step gets an instruction that has nothing to do.
        let Some(memory) = self.memory else {
            return Ok(Step::Ended);
        };
        let images = G::Every::fetch(source)?;
        if self.generator.terminal(&memory, &images) {
            return Ok(Step::Ended);
        }
        let next = self.generator.next_step(&memory, &images)?;
        self.memory = Some(next.memory);
        Ok(Step::Continue(next.effector))
    }

    fn runs_ahead(&self) -> bool {
        G::Every::CLASS == 0
    }
}
