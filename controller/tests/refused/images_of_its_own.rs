//! A type of the user claims to be the empty set of images.

use mrroc_controller::generator::{GeneratorError, ImageSource, Images};

#[derive(Clone, Copy)]
struct Everything;

impl Images for Everything {
    const CLASS: u8 = 0;

    fn fetch(source: &dyn ImageSource) -> Result<Self, GeneratorError> {
        source.effector().map(|_| Self)
    }
}

fn main() {}
