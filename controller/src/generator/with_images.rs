//! Generators that declare more images than they read, for combinations of unlike generators.

use std::marker::PhantomData;
use std::time::Duration;

use servo::LawParameters;

use super::{A, Bundle, EffectorImage, Generator, GeneratorError, Images, Message, Next, Pace, SlowedPart, V};

/// A set of images that includes the set `Part`.
///
/// Each of the eight sets includes itself and all its subsets. A program cannot implement the trait.
#[diagnostic::on_unimplemented(
    message = "the images `{Self}` do not include `{Part}`",
    note = "declare a set with all images that its part has: `()`, `EffectorImage`, `V<..>`, `A<..>` or a tuple"
)]
pub trait Includes<Part: Images>: Images {
    /// The part of the snapshot.
    fn part(&self) -> Part;
}

/// The parts of each set. The snapshot is bound to the pattern.
macro_rules! includes {
    ($($generics:tt $whole:ty, $pattern:pat => { $($part:ty: $value:expr),+ })+) => {
        $(includes! { @parts $generics, $whole, $pattern, $($part: $value),+ })+
    };
    (@parts $generics:tt, $whole:ty, $pattern:pat, $($part:ty: $value:expr),+) => {
        $(includes! { @part $generics, $whole, $pattern, $part, $value })+
    };
    (@part [$($generics:tt)*], $whole:ty, $pattern:pat, $part:ty, $value:expr) => {
        impl<$($generics)*> Includes<$part> for $whole {
            #[allow(unused_variables, clippy::let_unit_value, reason = "a part does not have all images")]
            fn part(&self) -> $part {
                let $pattern = *self;
                $value
            }
        }
    };
}

includes! {
    [] (), e => { (): e }
    [] EffectorImage, e => { (): (), EffectorImage: e }
    [B: Bundle] V<B>, v => { (): (), V<B>: v }
    [C: Message] A<C>, a => { (): (), A<C>: a }
    [B: Bundle] (EffectorImage, V<B>), (e, v) => { (): (), EffectorImage: e, V<B>: v, (EffectorImage, V<B>): (e, v) }
    [C: Message] (EffectorImage, A<C>), (e, a) => { (): (), EffectorImage: e, A<C>: a, (EffectorImage, A<C>): (e, a) }
    [B: Bundle, C: Message] (V<B>, A<C>), (v, a) => { (): (), V<B>: v, A<C>: a, (V<B>, A<C>): (v, a) }
    [B: Bundle, C: Message] (EffectorImage, V<B>, A<C>), (e, v, a) => {
        (): (), EffectorImage: e, V<B>: v, A<C>: a, (EffectorImage, V<B>): (e, v), (EffectorImage, A<C>): (e, a),
        (V<B>, A<C>): (v, a), (EffectorImage, V<B>, A<C>): (e, v, a)
    }
}

/// The generator `G` with more images: the first step declares `F`, and every next step declares `I`.
///
/// [`Selection`](super::Selection) and [`WeightedSum`](super::WeightedSum) combine generators of the same images. The
/// images of a combination are the union of the images that its parts read. A part that reads fewer images is wrapped.
/// The compiler infers `F` and `I` from the other generator. The class of a wrapped generator follows from `F` and `I`.
#[derive(Clone, Copy, Debug)]
pub struct WithImages<G, F, I> {
    generator: G,
    images: PhantomData<fn() -> (F, I)>,
}

impl<G, F, I> WithImages<G, F, I>
where
    G: Generator,
    F: Includes<G::First>,
    I: Includes<G::Every>,
{
    /// The wrapped generator.
    pub const fn of(generator: G) -> Self {
        Self { generator, images: PhantomData }
    }
}

impl<G, F, I> Generator for WithImages<G, F, I>
where
    G: Generator,
    F: Includes<G::First>,
    I: Includes<G::Every>,
{
    type First = F;
    type Every = I;
    type Out = G::Out;
    type Memory = G::Memory;

    /// The macrostep of the generator. In a combination that reads images, a planned generator has the macrostep of the
    /// cell, because each step must be computed within a macrostep.
    fn pace(&self, cell: Pace) -> Pace {
        let planned = G::Every::CLASS == 0 && I::CLASS > 0;
        if planned { cell } else { self.generator.pace(cell) }
    }

    fn macrosteps_ahead(&self, most: u16) -> u16 {
        self.generator.macrosteps_ahead(most)
    }

    fn begins_in_motion(&self) -> bool {
        self.generator.begins_in_motion()
    }

    fn law(&self) -> Option<LawParameters> {
        self.generator.law()
    }

    fn first_step(&mut self, images: &F, macrostep: Duration) -> Result<Next<G::Memory, G::Out>, GeneratorError> {
        self.generator.first_step(&images.part(), macrostep)
    }

    fn slowed(&self) -> Option<SlowedPart> {
        self.generator.slowed()
    }

    fn terminal(&self, memory: &G::Memory, images: &I) -> bool {
        self.generator.terminal(memory, &images.part())
    }

    fn next_step(&self, memory: &G::Memory, images: &I) -> Result<Next<G::Memory, G::Out>, GeneratorError> {
        self.generator.next_step(memory, &images.part())
    }
}
