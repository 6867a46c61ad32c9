//! The flow chart of the paper's figure 3, for one generator.

use std::time::Duration;

use super::{Generator, GeneratorError, ImageSource, Images, Pace, Setpoint};

/// Result of one turn of the flow chart.
#[expect(clippy::large_enum_variant, reason = "nearly every result is a set-point, and a box would allocate")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Continue: command the effector or let the effector stand.
    Continue(Option<Setpoint>),
    /// The terminal condition holds.
    Ended,
}

/// A motion instruction in progress: a generator of any class with its memory.
pub trait Execution {
    /// The first operational block of the chart.
    fn first_step(&mut self, source: &dyn ImageSource, macrostep: Duration) -> Result<Step, GeneratorError>;

    /// The dashed box of the chart. One snapshot is taken for the terminal condition and for (5) to (8). The results
    /// are committed together.
    fn next_step(&mut self, source: &dyn ImageSource) -> Result<Step, GeneratorError>;

    /// The macrostep of this motion; `cell` is the macrostep of the cell.
    fn pace(&self, cell: Pace) -> Result<Pace, GeneratorError>;

    /// Whether the first step can plan from a moving effector.
    fn begins_in_motion(&self) -> bool;

    /// Number of macrosteps, 1 to `most`, that may be sent ahead of the servo: 1 if the next steps read images.
    fn macrosteps_ahead(&self, most: u16) -> u16;
}

pub(crate) struct Run<G: Generator> {
    generator: G,
    memory: Option<G::Memory>,
}

impl<G: Generator> Run<G> {
    pub(crate) const fn new(generator: G) -> Self {
        Self { generator, memory: None }
    }
}

impl<G: Generator> Execution for Run<G> {
    fn first_step(&mut self, source: &dyn ImageSource, macrostep: Duration) -> Result<Step, GeneratorError> {
        let images = G::First::fetch(source)?;
        if macrostep.is_zero() {
            return Err(GeneratorError::NoMacrostep);
        }
        let next = self.generator.first_step(&images, macrostep)?;
        self.memory = Some(next.memory);
        Ok(Step::Continue(next.effector))
    }

    fn next_step(&mut self, source: &dyn ImageSource) -> Result<Step, GeneratorError> {
        // A runner that skips the first step gets an instruction without motion.
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

    fn pace(&self, cell: Pace) -> Result<Pace, GeneratorError> {
        let Pace { periods, read_at } = self.generator.pace(cell);
        let sound = periods <= Pace::MOST_PERIODS && (1..=periods).contains(&read_at);
        sound.then_some(Pace { periods, read_at }).ok_or(GeneratorError::Pace { periods, read_at })
    }

    fn begins_in_motion(&self) -> bool {
        self.generator.begins_in_motion()
    }

    fn macrosteps_ahead(&self, most: u16) -> u16 {
        if G::Every::CLASS == 0 { self.generator.macrosteps_ahead(most).clamp(1, most.max(1)) } else { 1 }
    }
}
