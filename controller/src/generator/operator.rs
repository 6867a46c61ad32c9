//! The operator's reaction: the effector holds until the operator answers.

use std::time::Duration;

use can::Instant;

use super::{Generator, GeneratorError, Next, Tell, V};
use crate::sensor::{OperatorCommand, Reaction};

/// Stands until the operator reacts to the question of an [`Operator`](crate::sensor::Operator), a virtual sensor of
/// the agent. Class 2: each step reads the operator's reaction only.
///
/// The first step tells the sensor to ask. The motion ends with any reaction: an answer, a closed input, or a passed
/// deadline. The task reads the reaction from [`OperatorAnswer`](crate::sensor::OperatorAnswer).
#[doc(alias = "operator_reaction_condition")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatorReaction;

impl Generator for OperatorReaction {
    type First = V<Reaction>;
    type Every = V<Reaction>;
    type Out = Tell<OperatorCommand>;
    /// Time of the reaction before the question, if there was one.
    type Memory = Option<Instant>;

    fn first_step(
        &mut self,
        v: &V<Reaction>,
        _: Duration,
    ) -> Result<Next<Option<Instant>, Tell<OperatorCommand>>, GeneratorError> {
        let before = v.0.sample().map(|reaction| reaction.at);
        Ok(Next::remember(before).with(Tell(OperatorCommand::Ask)))
    }

    fn terminal(&self, before: &Option<Instant>, v: &V<Reaction>) -> bool {
        v.0.sample().is_some_and(|reaction| Some(reaction.at) != *before)
    }

    fn next_step(
        &self,
        before: &Option<Instant>,
        _: &V<Reaction>,
    ) -> Result<Next<Option<Instant>, Tell<OperatorCommand>>, GeneratorError> {
        Ok(Next::remember(*before).with(Tell(OperatorCommand::Wait)))
    }
}
