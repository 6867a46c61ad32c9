//! A type of the user claims to be the empty set of images.

use mrroc_controller::generator::{GeneratorError, Images, Partners};

#[derive(Clone, Copy)]
struct Everything;

impl Images for Everything {
    const CLASS: u8 = 0;

    fn fetch(source: &dyn Partners) -> Result<Self, GeneratorError> {
        source.effector().map(|_| Self)
    }

    fn require(_: &dyn Partners) -> Result<(), GeneratorError> {
        Ok(())
    }
}

fn main() {}
