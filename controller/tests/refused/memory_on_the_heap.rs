//! A memory that cannot be copied, and so cannot be committed as a whole.

use std::time::Duration;

use mrroc_controller::generator::{Generator, GeneratorError, Next};

struct Recording;

impl Generator for Recording {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = Vec<f64>;

    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<Vec<f64>>, GeneratorError> {
        Ok(Next::remember(Vec::new()))
    }

    fn terminal(&self, _: &Vec<f64>, (): &()) -> bool {
        true
    }

    fn next_step(&self, memory: &Vec<f64>, (): &()) -> Result<Next<Vec<f64>>, GeneratorError> {
        Ok(Next::remember(memory.clone()))
    }
}

fn main() {}
