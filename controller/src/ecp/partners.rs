//! Partners of a process: barriers at which the process waits for them, and stops of its team.

use can::Instant;
use servo::{Order, StopCause};

use super::{Activity, Ecp, EcpError};

/// A barrier of the processes of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Barrier {
    /// The meeting of this number.
    Meeting(u8),
    /// The tie of a team, by its bit set of effectors.
    Team(u32),
}

impl Ecp {
    /// The barrier at which the process waits for its partners.
    pub(super) fn barrier(&self) -> Option<Barrier> {
        match self.activity {
            Activity::Meeting { barrier, admitted: None, .. } => Some(barrier),
            _ => None,
        }
    }

    /// Admits the process to its barrier with these `members`. The next poll queues the barrier.
    pub(super) fn admit(&mut self, members: u32) {
        if let Activity::Meeting { admitted, .. } = &mut self.activity {
            *admitted = Some(members);
        }
    }

    pub(super) fn come_to(&mut self, barrier: Barrier, now: Instant) -> Option<Result<(), EcpError>> {
        self.activity = Activity::Meeting { barrier, since: now, admitted: None };
        None
    }

    /// The stop by a partner of the team, which the servo reports until a stop or disable order acknowledges it.
    pub(super) fn partner_stop(&self) -> Option<EcpError> {
        let fault = self.report.and_then(|report| report.fault);
        fault.filter(|fault| matches!(fault.cause, StopCause::Partner { .. })).map(EcpError::Servo)
    }

    /// Whether a barrier was not passed yet.
    pub(super) fn is_at_barrier(&self) -> bool {
        let latest = self.latest();
        // The servo takes an order one or two cycles after the cycle that was published when the order was sent.
        let under_way = self.barrier_sent.is_some_and(|cycle| latest.cycle < cycle + 2);
        latest.waiting || under_way || self.outbox.iter().any(is_barrier)
    }

    /// Notes whether the effector waits for its partners. The servo is then silent. An error if the wait takes too
    /// long.
    pub(super) fn wait_for_partners(&mut self, now: Instant) -> Result<(), EcpError> {
        let latest = self.latest();
        if !latest.waiting {
            self.waiting = None;
            return Ok(());
        }
        self.heard = now;
        if let Activity::Switching { since, .. } = &mut self.activity {
            *since = now;
        }
        let since = self.waiting.get_or_insert(now);
        // A partner may be slowed.
        if latest.rate < 1.0 {
            *since = now;
        }
        let waited = now.since(*since);
        if waited > self.config.meeting { Err(EcpError::Unmet { waited }) } else { Ok(()) }
    }
}

pub(super) fn is_barrier(order: &Order) -> bool {
    matches!(order, Order::Meet { .. } | Order::Tie { .. })
}
