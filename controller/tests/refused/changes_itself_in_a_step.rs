//! A next step that counts in the generator instead of its memory.

use std::cell::Cell;
use std::time::Duration;

use mrroc_controller::generator::{Generator, GeneratorError, Next};

struct Counting(Cell<u32>);

impl Generator for Counting {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), (): &()) -> bool {
        self.0.get() > 10
    }

    fn next_step(&self, (): &(), (): &()) -> Result<Next<()>, GeneratorError> {
        self.0.set(self.0.get() + 1);
        Ok(Next::remember(()))
    }
}

fn main() {}
