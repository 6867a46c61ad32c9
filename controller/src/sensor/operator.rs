//! The operator: questions, answers, and the operator's reaction as a virtual sensor.
//!
//! An [`OperatorLink`] connects tasks with an [`OperatorPanel`]. The link waits for nothing: threads of the panel read
//! lines and show texts. Each line is the answer to the question that is open, or to the next one. One question is open
//! at a time, and others wait for their turn.
//!
//! The sensor [`Operator`] works in the steps of a motion. Its questions are made before the motion, lines and texts
//! pass through bounded queues, and the panel formats the texts.

mod asking;
mod link;
mod question;
mod reaction;
#[cfg(test)]
mod tests;

pub use asking::{Asking, OperatorError};
pub use link::{OperatorLink, OperatorPanel, OperatorTexts};
pub use question::Question;
pub use reaction::{Operator, OperatorAnswer, OperatorCommand, Reaction};
