//! Standstill for a given time.

use std::time::Duration;

use super::{Generator, GeneratorError, Next};

/// Lets the effector stand for a time, rounded up to whole macrosteps. Class 0: a wait reads only its own memory.
#[doc(alias = "sleep")]
#[doc(alias = "hold")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wait {
    /// Duration of the standstill.
    pub duration: Duration,
}

impl Generator for Wait {
    type First = ();
    type Every = ();
    type Out = ();
    /// Remaining macrosteps of standstill.
    type Memory = u64;

    fn first_step(&mut self, _: &(), macrostep: Duration) -> Result<Next<u64>, GeneratorError> {
        let steps = self.duration.as_nanos().div_ceil(macrostep.as_nanos().max(1));
        Ok(Next::remember(u64::try_from(steps).unwrap_or(u64::MAX)))
    }

    fn terminal(&self, left: &u64, _: &()) -> bool {
        *left == 0
    }

    fn next_step(&self, left: &u64, _: &()) -> Result<Next<u64>, GeneratorError> {
        Ok(Next::remember(left - 1))
    }
}
