//! The operator: questions, answers, and the operator's reaction as a virtual sensor.
//!
//! An [`OperatorLink`] connects tasks with an [`OperatorPanel`]. The link never waits: threads of the panel read lines
//! and show texts. Each line is the answer to the open question, or to the next question. One question is open at a time,
//! and other questions wait.
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
