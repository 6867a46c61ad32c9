//! A generator of class 0 has no image of its effector.

use std::time::Duration;

use mrroc_controller::generator::{Generator, GeneratorError, Next};

struct Blind;

impl Generator for Blind {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), e: &()) -> bool {
        e.measured.joints.position[0] > 1.0
    }

    fn next_step(&self, (): &(), _: &()) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
}

fn main() {}
