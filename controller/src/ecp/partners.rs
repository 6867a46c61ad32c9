//! Partners of a process: its coordinators, barriers at which the process waits for other processes, and stops of its team.

use std::time::Duration;

use can::Instant;
use servo::{Order, StopCause};

use super::{Activity, Ecp, EcpError, Planning};
use crate::coordination::MemberLink;

/// A barrier of the processes of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Barrier {
    /// The meeting of this number.
    Meeting(u8),
    /// The tie of a team, by its bit set of effectors.
    Team(u32),
}

/// The links of a process to coordinators.
#[derive(Default)]
pub(super) struct Links {
    /// The link to the coordinator of the present team.
    pub(super) team: Option<Box<dyn MemberLink>>,
    /// The link to the task.
    pub(super) task: Option<Box<dyn MemberLink>>,
}

impl Links {
    /// The link of the present motion. In a motion of a team, the link to the task is not used.
    pub(super) fn present(&mut self) -> Option<&mut (dyn MemberLink + 'static)> {
        self.team.as_deref_mut().or(self.task.as_deref_mut())
    }
}

impl Ecp {
    /// Connects the process to the task, in place of the link before.
    pub(crate) fn follow_task(&mut self, link: Box<dyn MemberLink>) {
        self.links.task = Some(link);
    }

    /// Connects the process to the coordinator of a team, for the motion of the team. `None` ends the connection.
    pub(crate) fn follow_team(&mut self, link: Option<Box<dyn MemberLink>>) {
        self.links.team = link;
    }

    /// Takes the messages of the task from its link. In a motion of a team, messages wait in the link.
    pub(super) fn receive_from_task(&mut self) {
        if let Links { team: None, task: Some(link) } = &mut self.links {
            link.receive(self.link.latest.read().at);
        }
    }

    /// Whether the task has ended the present motion. Messages after a replacement are for the replacement. An end of
    /// the replacement also ends the replaced motion, whose macrosteps would otherwise still be executed.
    pub(super) fn is_ended_by_task(&mut self) -> bool {
        if self.replacement.is_none() && !self.replaced {
            self.receive_from_task();
        }
        let Links { team: None, task: Some(link) } = &mut self.links else {
            return false;
        };
        link.is_ended() || self.replaced && link.holds_end()
    }

    /// The task awaits a list that begins after the present list. Later messages of the task are for the awaited list.
    pub(crate) fn await_list(&mut self) {
        if !self.awaited {
            self.receive_from_task();
            self.awaited = true;
        }
    }

    /// The task has dropped the awaited list before its begin. An end that the task has sent for this list does not end
    /// a later motion.
    pub(crate) fn forget_awaited(&mut self) {
        if std::mem::take(&mut self.awaited) {
            self.receive_from_task();
        }
    }

    /// The task has fetched the result of the last list. If the list ended with a motion, an earlier end was for that
    /// motion, and does not end a later motion.
    pub(crate) fn close_list(&mut self) {
        if std::mem::take(&mut self.moves) {
            self.receive_from_task();
        }
    }

    /// Whether the process is a member of a team under a coordinator.
    pub(crate) fn is_in_team(&self) -> bool {
        self.links.team.is_some()
    }

    /// Whether the process brakes its effector.
    pub(crate) fn is_braking(&self) -> bool {
        matches!(self.activity, Activity::Stopping { .. })
    }

    /// The planner, and the time limit of the wait for its result.
    pub(crate) fn planning(&mut self) -> (&mut Planning, Duration) {
        (&mut self.planning, self.config.planning)
    }

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

    /// Whether a stop by a partner does not shorten the motion: the motion ends without a further macrostep.
    pub(super) fn ends_with_partners(&self) -> bool {
        match self.activity {
            Activity::RunningOut => self.ended_by_team || self.outstanding() == 0,
            Activity::Arriving => self.ended_by_team,
            Activity::Idle
            | Activity::Switching { .. }
            | Activity::Meeting { .. }
            | Activity::Awaiting { .. }
            | Activity::Planning { .. }
            | Activity::Running(_)
            | Activity::Stopping { .. } => false,
        }
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
