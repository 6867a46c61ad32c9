//! The member of a team that moves as its coordinator orders.

use std::time::Duration;

use super::{A, Answer, EffectorImage, Generator, GeneratorError, Next, Received, Setpoint};

/// A member of a team whose set-points come from the coordinator in every macrostep (tight coordination). Class 5,
/// continuous feedback: the set-point is the order `a0`, and the answer is the image `e`.
///
/// An order is the state at the end of the next macrostep, in any form of [`Setpoint`]. The order `None` lets the
/// effector stand. Members send no macrostep in the first step: the first order of a coordinator must be `None`. The
/// coordinator then plans from the first answers.
///
/// In the answer, `commanded` is the state at the start of the macrostep that the order of the same step commands.
///
/// An order that is not finite is an error, and so is a step without a new order. The last set-point is not repeated,
/// because a repeated position would contradict the velocity of the set-point. Both errors are non-fatal. They brake
/// the whole team, and the refused order is not sent. The coordinator ends the motion.
///
/// ```no_run
/// # use std::time::Duration;
/// # use mrroc_controller::{coordination::{Coordinator, NextOrders, Orders}, generator::*};
/// /// Lets both members stand for 50 macrosteps. Executed as `team.execute(Stand, [Transparent; 2])`.
/// struct Stand;
///
/// impl Coordinator<2> for Stand {
///     type Order = Option<Setpoint>;
///     type Answer = EffectorImage;
///     type Sensors = ();
///     type Out = ();
///     type Memory = u32;
///     fn first_step(&mut self, (): &(), _: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
///         Ok(NextOrders::new([None; 2], 0))
///     }
///     fn terminal(&self, steps: &u32, _: &[Sample<EffectorImage>; 2], (): &()) -> bool {
///         *steps == 50
///     }
///     fn next_step(
///         &self,
///         steps: &u32,
///         answers: &[Sample<EffectorImage>; 2],
///         (): &(),
///     ) -> Result<Orders<Self, 2>, GeneratorError> {
///         let here = answers.map(|answer| AxesState::at_rest(answer.value.commanded.joints.position));
///         Ok(NextOrders::new(here.map(|state| Some(Setpoint::Joints(state))), steps + 1))
///     }
/// }
/// ```
#[doc(alias = "slave")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transparent;

/// The order as a set-point, and the answer.
fn follow(
    (e, order): &(EffectorImage, A<Option<Setpoint>>),
) -> Result<Next<(), Answer<EffectorImage>>, GeneratorError> {
    let effector = match order.0 {
        Received::New(sample) => sample.value,
        Received::Old(_) => return Err(GeneratorError::NoNewOrder),
        Received::None => return Err(GeneratorError::NothingReceived),
    };
    if let Some(axis) = effector.and_then(|setpoint| setpoint.not_finite()) {
        return Err(GeneratorError::OrderNotFinite { axis });
    }
    Ok(Next { effector, law: None, out: Answer(*e), memory: () })
}

impl Generator for Transparent {
    type First = (EffectorImage, A<Option<Setpoint>>);
    type Every = (EffectorImage, A<Option<Setpoint>>);
    type Out = Answer<EffectorImage>;
    type Memory = ();

    fn first_step(
        &mut self,
        images: &Self::First,
        _: Duration,
    ) -> Result<Next<(), Answer<EffectorImage>>, GeneratorError> {
        follow(images)
    }

    fn terminal(&self, (): &(), _: &Self::Every) -> bool {
        false
    }

    fn next_step(&self, (): &(), images: &Self::Every) -> Result<Next<(), Answer<EffectorImage>>, GeneratorError> {
        follow(images)
    }
}
