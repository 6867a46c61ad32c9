//! Coordination: the coordinator C0 of a team, and the links between C0 and the subcontrollers.
//!
//! A [`Coordinator`] gives each member of a team an order in every macrostep, and reads the answers of the members
//! (tight coordination). The members run generators with the image [`A`](crate::generator::A) and the output
//! [`Answer`](crate::generator::Answer). The flow chart of figure 3 of the paper applies to the coordinator and to its
//! members. A coordinator may have virtual sensors of its own.
//!
//! A task is a coordinator too: over a [`link`] to one agent, the task gives orders at any time (loose coordination).
//!
//! Orders and answers are numbered messages in bounded queues. Macrostep *m* of the coordinator gives order *m*; step *m*
//! of a member takes order *m* and gives answer *m*. A [`LinkConfig`] states whether a member waits for its order, for
//! how long, and the consequence of a late order.
//!
//! [`carry`] moves a rigid object that two arms hold.
//!
//! Read [`Coordinator`] first, then [`LinkConfig`].

pub mod carry;
mod conduct;
mod coordinator;
mod link;
mod messages;
#[cfg(test)]
mod tests;

pub(crate) use conduct::{Conduct, CoordinatorJournal, Desk};
pub use coordinator::{Answers, Coordinator, CoordinatorError, NextOrders, Orders};
pub use link::{CoordinatorEnd, Late, LinkConfig, LinkError, MemberEnd, link};
pub(crate) use link::{MemberLink, Patience, Turn};
#[cfg(any(test, feature = "test-hooks"))]
pub use messages::Disturbance;
