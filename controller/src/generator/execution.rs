//! The flow chart of the paper's figure 3: one runner for every agent.

use std::any::type_name;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use servo::LawParameters;

use super::{Generator, GeneratorError, Images, Next, Outputs, Pace, Partners, Setpoint, SlowedPart};
use crate::ecp::StepEvent;

/// Functions of one instruction of an agent, of a subcontroller or of the coordinator.
pub(crate) trait Functions {
    /// Images of the first step.
    type First;
    /// Images of every next step.
    type Every;
    /// The agent's own memory.
    type Memory: Copy;
    /// All other results of a step.
    type Results;

    fn first_step(
        &mut self,
        images: &Self::First,
        macrostep: Duration,
    ) -> Result<(Self::Results, Self::Memory), GeneratorError>;

    fn terminal(&self, memory: &Self::Memory, images: &Self::Every) -> bool;

    fn next_step(
        &self,
        memory: &Self::Memory,
        images: &Self::Every,
    ) -> Result<(Self::Results, Self::Memory), GeneratorError>;
}

/// An instruction of an agent in the flow chart.
pub(crate) struct Chart<F: Functions> {
    pub(crate) functions: F,
    pub(crate) memory: Option<F::Memory>,
}

impl<F: Functions> Chart<F> {
    pub(crate) const fn new(functions: F) -> Self {
        Self { functions, memory: None }
    }

    /// The first operational block of the chart, computed from the images of the first step.
    pub(crate) fn first_step(&mut self, images: &F::First, macrostep: Duration) -> Result<F::Results, GeneratorError> {
        if macrostep.is_zero() {
            return Err(GeneratorError::NoMacrostep);
        }
        let (results, memory) = self.functions.first_step(images, macrostep)?;
        self.memory = Some(memory);
        Ok(results)
    }

    /// The dashed box of the chart: terminal condition, then functions, from one snapshot. `None` if the instruction ends.
    /// A panic of the functions is returned as an error.
    pub(crate) fn next_step(&mut self, images: &F::Every) -> Result<Option<F::Results>, GeneratorError> {
        // A runner that skips the first step gets an instruction without motion.
        let Some(memory) = self.memory else {
            return Ok(None);
        };
        let functions = &self.functions;
        let step = || {
            let ended = functions.terminal(&memory, images);
            if ended { Ok(None) } else { functions.next_step(&memory, images).map(Some) }
        };
        let step = catch_unwind(AssertUnwindSafe(step)).unwrap_or(Err(GeneratorError::Panicked))?;
        Ok(step.map(|(results, memory)| {
            self.memory = Some(memory);
            results
        }))
    }
}

/// (5) The command of a step to the effector for one macrostep.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EffectorCommand {
    /// State at the end of the macrostep; `None` lets the effector stand.
    pub setpoint: Option<Setpoint>,
    /// Parameters of the effector's cycle law.
    pub law: Option<LawParameters>,
}

/// Result of one turn of the flow chart.
#[expect(clippy::large_enum_variant, reason = "nearly every result is a set-point, and a box would allocate")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Continue: command the effector or let the effector stand.
    Continue(EffectorCommand),
    /// The terminal condition holds.
    Ended,
}

/// A motion instruction in progress: a generator of any class with its memory.
///
/// The runner calls [`initiate`](Self::initiate), [`plan`](Self::plan) and [`commit`](Self::commit) once, and then
/// [`next_step`](Self::next_step) until the instruction ends.
pub trait Execution {
    /// Refuses partners that cannot provide the images of the first step (`first`) or of every next step (not `first`).
    fn require(&self, first: bool, partners: &dyn Partners) -> Result<(), GeneratorError>;

    /// Reads the images of the first step. Refuses a generator that declares an image which its agent does not have.
    fn initiate(&mut self, partners: &dyn Partners) -> Result<(), GeneratorError>;

    /// Computes the first step: the first operational block of the chart. May run on another thread.
    fn plan(&mut self, macrostep: Duration) -> Result<(), GeneratorError>;

    /// The part of the motion that joints slow, once the first step is computed.
    fn slowed(&self) -> Option<SlowedPart>;

    /// Delivers the results of the first step.
    fn commit(&mut self, partners: &mut dyn Partners) -> Result<Step, GeneratorError>;

    /// The dashed box of the chart. The terminal condition and the functions (5) to (8) read one snapshot. The results
    /// are committed together.
    fn next_step(&mut self, partners: &mut dyn Partners) -> Result<Step, GeneratorError>;

    /// The macrostep of this motion; `cell` is the macrostep of the cell.
    fn pace(&self, cell: Pace) -> Result<Pace, GeneratorError>;

    /// Whether the first step can plan from a moving effector.
    fn begins_in_motion(&self) -> bool;

    /// Parameters of the cycle law in all macrosteps, if they are known before the first step.
    fn law(&self) -> Option<LawParameters>;

    /// Number of macrosteps, 1 to `most`, that may be sent ahead of the servo: 1 if the next steps read images.
    fn macrosteps_ahead(&self, most: u16) -> u16;

    /// Type of the generator, and classes of its first step and of every next step.
    fn description(&self) -> Description;

    /// Digest of the generator's memory, equal for equal memories.
    fn digest(&self) -> u64;
}

/// Type and classes of a generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name of the generator's type.
    pub generator: &'static str,
    /// Class of the first step, 0 to 7.
    pub first: u8,
    /// Class of every next step, 0 to 7.
    pub every: u8,
}

/// The functions of a generator.
pub(crate) struct Control<G>(G);

impl<G: Generator> Functions for Control<G> {
    type First = G::First;
    type Every = G::Every;
    type Memory = G::Memory;
    type Results = (EffectorCommand, G::Out);

    fn first_step(
        &mut self,
        images: &G::First,
        macrostep: Duration,
    ) -> Result<(Self::Results, G::Memory), GeneratorError> {
        self.0.first_step(images, macrostep).map(results)
    }

    fn terminal(&self, memory: &G::Memory, images: &G::Every) -> bool {
        self.0.terminal(memory, images)
    }

    fn next_step(&self, memory: &G::Memory, images: &G::Every) -> Result<(Self::Results, G::Memory), GeneratorError> {
        self.0.next_step(memory, images).map(results)
    }
}

fn results<M, O>(Next { effector, law, out, memory }: Next<M, O>) -> ((EffectorCommand, O), M) {
    ((EffectorCommand { setpoint: effector, law }, out), memory)
}

pub(crate) struct Run<G: Generator> {
    chart: Chart<Control<G>>,
    first: Option<G::First>,
    planned: Option<(EffectorCommand, G::Out)>,
}

impl<G: Generator> Run<G> {
    pub(crate) const fn new(generator: G) -> Self {
        Self { chart: Chart::new(Control(generator)), first: None, planned: None }
    }
}

impl<G: Generator> Execution for Run<G> {
    fn require(&self, first: bool, partners: &dyn Partners) -> Result<(), GeneratorError> {
        if first { G::First::require(partners) } else { G::Every::require(partners) }
    }

    fn initiate(&mut self, partners: &dyn Partners) -> Result<(), GeneratorError> {
        self.first = Some(G::First::fetch(partners)?);
        G::Every::require(partners)
    }

    fn plan(&mut self, macrostep: Duration) -> Result<(), GeneratorError> {
        if let Some(images) = self.first.take() {
            self.planned = Some(self.chart.first_step(&images, macrostep)?);
        }
        Ok(())
    }

    fn slowed(&self) -> Option<SlowedPart> {
        self.chart.functions.0.slowed()
    }

    fn commit(&mut self, partners: &mut dyn Partners) -> Result<Step, GeneratorError> {
        let Some((command, out)) = self.planned.take() else {
            return Ok(Step::Ended);
        };
        partners.note(StepEvent::Functions);
        out.deliver(partners)?;
        Ok(Step::Continue(command))
    }

    fn next_step(&mut self, partners: &mut dyn Partners) -> Result<Step, GeneratorError> {
        let images = G::Every::fetch(partners)?;
        partners.note(StepEvent::TerminalCondition);
        let Some((command, out)) = self.chart.next_step(&images)? else {
            return Ok(Step::Ended);
        };
        partners.note(StepEvent::Functions);
        out.deliver(partners)?;
        Ok(Step::Continue(command))
    }

    fn pace(&self, cell: Pace) -> Result<Pace, GeneratorError> {
        let Pace { periods, read_at } = self.chart.functions.0.pace(cell);
        let sound = periods <= Pace::MOST_PERIODS && (1..=periods).contains(&read_at);
        sound.then_some(Pace { periods, read_at }).ok_or(GeneratorError::Pace { periods, read_at })
    }

    fn begins_in_motion(&self) -> bool {
        self.chart.functions.0.begins_in_motion()
    }

    fn law(&self) -> Option<LawParameters> {
        self.chart.functions.0.law()
    }

    fn macrosteps_ahead(&self, most: u16) -> u16 {
        let ahead = || self.chart.functions.0.macrosteps_ahead(most).clamp(1, most.max(1));
        if G::Every::CLASS == 0 { ahead() } else { 1 }
    }

    fn description(&self) -> Description {
        Description { generator: type_name::<G>(), first: G::First::CLASS, every: G::Every::CLASS }
    }

    fn digest(&self) -> u64 {
        self.chart.memory.as_ref().map_or(0, super::digest::of)
    }
}
