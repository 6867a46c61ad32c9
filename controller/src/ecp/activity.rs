//! What a process does at present, and what it waits for.

use can::Instant;
use servo::Order;

use super::{Barrier, EcpError};
use crate::generator::Execution;

/// Current activity. Every wait in an activity has a time limit.
#[expect(
    clippy::large_enum_variant,
    reason = "a box would allocate in every switch of the drives, and there is one activity"
)]
pub(super) enum Activity {
    /// Between two instructions.
    Idle,
    /// Waits until an order to enable, home, disable or reset has taken effect.
    Switching { order: Order, since: Instant },
    /// Waits for the partners at a barrier. `admitted`: bit set of the partners, once all have come.
    Meeting { barrier: Barrier, since: Instant, admitted: Option<u32> },
    /// Waits for the images of the first step that are not there yet.
    Awaiting { run: Box<dyn Execution + Send>, since: Instant },
    /// The planner computes the first step of a generator. The effector stands.
    Planning { since: Instant },
    /// The generator computes macrosteps.
    Running(Box<dyn Execution + Send>),
    /// Waits for the end of the last macrostep, which ends at standstill.
    Arriving,
    /// Waits for the report from the last macrostep, which ends in motion. A stop follows.
    RunningOut,
    /// Waits for standstill. `outcome`: result afterwards.
    Stopping { order: StopOrder, outcome: Result<(), EcpError> },
}

/// The order of a stop.
pub(super) enum StopOrder {
    /// In the outbox, found there first at this time.
    Waiting(Option<Instant>),
    /// Sent at this time, or given by the servo itself.
    Sent(Instant),
}
