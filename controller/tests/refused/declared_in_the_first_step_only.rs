//! Sporadic feedback: the first step declares the effector, the next steps do not.

use std::time::Duration;

use mrroc_controller::generator::{EffectorImage, Generator, GeneratorError, Next};

struct Once;

impl Generator for Once {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, _: &EffectorImage, _: Duration) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), e: &EffectorImage) -> bool {
        e.macrostep > 10
    }

    fn next_step(&self, (): &(), (): &()) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
}

fn main() {}
