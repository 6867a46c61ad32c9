//! The law of a robot whose sensor and surroundings are not there.

use servo::{CycleLaw, LawFault, LawInput, LawOutput, LawParameters, MAX_AXES};

use super::directions::Behaviour;

/// Law of a rehearsal in place of [`PositionForce`](super::PositionForce): checks the parameters of each macrostep, and
/// leaves the set-points on the planned path. A guard never detects a touch.
#[derive(Clone, Copy, Debug, Default)]
pub struct RehearsedLaw;

impl CycleLaw for RehearsedLaw {
    fn check(&self, parameters: &LawParameters) -> Result<(), LawFault> {
        Behaviour::read(parameters).map(drop)
    }

    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {}

    fn shift(&mut self, _: &LawInput<'_>, _: &LawParameters) -> LawOutput {
        LawOutput::Displacement([0.0; MAX_AXES])
    }
}
