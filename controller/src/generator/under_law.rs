//! A generator whose macrosteps all carry the same parameters of a cycle law.

use std::time::Duration;

use servo::LawParameters;

use super::{Generator, GeneratorError, Next, Pace, SlowedPart};

/// The generator `G` under the cycle law of its effector, with the same parameters in all macrosteps.
///
/// The generator computes the path, and the law displaces the set-points from the path in each servo period. With a
/// [`Wait`](super::Wait), the law alone moves the effector. With a guard, a touch ends the motion before the generator
/// does.
///
/// A law with a spring keeps its displacement for the next instruction under the same parameters
/// ([`Generator::law`]).
///
/// ```
/// # use std::time::Duration;
/// # use mrroc_controller::generator::{Generator, Wait};
/// # use mrroc_controller::law::{Compliance, Direction, ForceTask};
/// // Pushes with 10 N along z of the tool for three seconds.
/// let mut task = ForceTask::default();
/// task.directions[2] = Direction::Contact { force: 10.0, compliance: Compliance::LINEAR };
/// let push = Wait { duration: Duration::from_secs(3) }.under(task);
/// ```
#[doc(alias = "ForceControl")]
#[derive(Clone, Copy, Debug)]
pub struct UnderLaw<G> {
    generator: G,
    law: LawParameters,
}

impl<G> UnderLaw<G> {
    /// The generator under its effector's law with these parameters. See [`Generator::under`].
    pub fn new(generator: G, law: impl Into<LawParameters>) -> Self {
        Self { generator, law: law.into() }
    }
}

impl<G: Generator> Generator for UnderLaw<G> {
    type First = G::First;
    type Every = G::Every;
    type Out = G::Out;
    type Memory = G::Memory;

    fn pace(&self, cell: Pace) -> Pace {
        self.generator.pace(cell)
    }

    fn macrosteps_ahead(&self, most: u16) -> u16 {
        self.generator.macrosteps_ahead(most)
    }

    fn begins_in_motion(&self) -> bool {
        self.generator.begins_in_motion()
    }

    fn law(&self) -> Option<LawParameters> {
        Some(self.law)
    }

    fn first_step(
        &mut self,
        images: &G::First,
        macrostep: Duration,
    ) -> Result<Next<G::Memory, G::Out>, GeneratorError> {
        Ok(self.generator.first_step(images, macrostep)?.under(self.law))
    }

    fn slowed(&self) -> Option<SlowedPart> {
        self.generator.slowed()
    }

    fn terminal(&self, memory: &G::Memory, images: &G::Every) -> bool {
        self.generator.terminal(memory, images)
    }

    fn next_step(&self, memory: &G::Memory, images: &G::Every) -> Result<Next<G::Memory, G::Out>, GeneratorError> {
        Ok(self.generator.next_step(memory, images)?.under(self.law))
    }
}
