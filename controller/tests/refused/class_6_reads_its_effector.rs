//! A generator of class 6 reads its effector, which it does not declare.

use std::time::Duration;

use mrroc_controller::generator::{A, EffectorImage, Generator, GeneratorError, Next, SensorReading, V};

/// Whether the probe touches.
#[derive(Clone, Copy)]
struct Touch(bool);

impl SensorReading for Touch {}

struct Blind;

impl Generator for Blind {
    type First = ();
    type Every = (V<Touch>, A<f64>);
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), _: &(V<Touch>, A<f64>)) -> bool {
        false
    }

    fn next_step(&self, (): &(), _: &(EffectorImage, V<Touch>, A<f64>)) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
}

fn main() {}
