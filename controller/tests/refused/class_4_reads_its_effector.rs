//! A generator of class 4 reads its effector, which it does not declare.

use std::time::Duration;

use mrroc_controller::generator::{A, EffectorImage, Generator, GeneratorError, Next};

struct Blind;

impl Generator for Blind {
    type First = ();
    type Every = A<f64>;
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), _: &A<f64>) -> bool {
        false
    }

    fn next_step(&self, (): &(), _: &(EffectorImage, A<f64>)) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
}

fn main() {}
