//! Outputs of a step beside the set-point: a command to a sensor (6) and an answer to the coordinator (7).

use std::any::{Any, type_name};

use super::{GeneratorError, Message, Partners};

/// (6) A command to the virtual sensor that takes commands of this type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tell<C>(pub C);

/// (7) An answer to the coordinator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer<R>(pub R);

mod closed {
    use super::{Answer, Message, Tell};

    /// Closes [`Outputs`](super::Outputs).
    pub trait OutputSet {}
    impl OutputSet for () {}
    impl<C: Message> OutputSet for Tell<C> {}
    impl<R: Message> OutputSet for Answer<R> {}
    impl<C: Message, R: Message> OutputSet for (Tell<C>, Answer<R>) {}
}

/// Outputs of a generator beside the set-point: `()`, [`Tell`], [`Answer`], or `(Tell, Answer)`. The trait is sealed.
///
/// Outputs are independent of the images: a generator of class 0 may answer a coordinator.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no set of outputs",
    note = "a generator returns `()`, `Tell<..>`, `Answer<..>` or `(Tell<..>, Answer<..>)` beside its set-point"
)]
pub trait Outputs: closed::OutputSet + Copy + Send + Sync + 'static {
    /// Commits the outputs.
    fn deliver(self, partners: &mut dyn Partners) -> Result<(), GeneratorError>;
}

/// Outputs of a coordinator beside its orders: `()`, or [`Tell`] for its own sensor.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no output of a coordinator",
    note = "a coordinator returns `()` or `Tell<..>` beside its orders"
)]
pub trait Commands: Outputs {}
impl Commands for () {}
impl<C: Message> Commands for Tell<C> {}

impl Outputs for () {
    fn deliver(self, _: &mut dyn Partners) -> Result<(), GeneratorError> {
        Ok(())
    }
}

impl<C: Message> Outputs for Tell<C> {
    fn deliver(self, partners: &mut dyn Partners) -> Result<(), GeneratorError> {
        let told = partners.tell(&self.0 as &dyn Any);
        told.then_some(()).ok_or(GeneratorError::NotTold { command: type_name::<C>() })
    }
}

impl<R: Message> Outputs for Answer<R> {
    fn deliver(self, partners: &mut dyn Partners) -> Result<(), GeneratorError> {
        let answered = partners.answer(&self.0 as &dyn Any);
        answered.then_some(()).ok_or(GeneratorError::NotAnswered { answer: type_name::<R>() })
    }
}

impl<C: Message, R: Message> Outputs for (Tell<C>, Answer<R>) {
    fn deliver(self, partners: &mut dyn Partners) -> Result<(), GeneratorError> {
        self.0.deliver(partners)?;
        self.1.deliver(partners)
    }
}
