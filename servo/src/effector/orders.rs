//! Orders of an effector: stop and disable orders overtake the queue, and all other orders wait for their turn.

use super::{Effector, Tick};
use crate::{Answer, Macrostep, Order, ServoEvent, ServoState, StopCause};

/// A barrier at the front of a queue. The value is the bit set of its members.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Barrier {
    Meet(u32),
    Tie(u32),
}

impl Barrier {
    pub(crate) fn members(self) -> u32 {
        let (Self::Meet(members) | Self::Tie(members)) = self;
        members
    }
}

impl Effector {
    /// Makes the orders that have arrived visible to this cycle, and calls `note` with each of them.
    pub(crate) fn receive_orders(&mut self, note: impl FnMut(&Order)) {
        let (seen, arrived) = (self.visible, self.orders.slots());
        self.visible = arrived;
        if let Ok(chunk) = self.orders.read_chunk(arrived) {
            let (front, back) = chunk.as_slices();
            front.iter().chain(back).skip(seen).for_each(note);
        }
    }

    /// Finds stops anywhere in the queue and executes them first. Orders queued before the stop keep their order,
    /// but motion, barriers and homing among them are dropped.
    pub(super) fn take_stops(&mut self, tick: &Tick) {
        if tick.stop && !self.holds_for_brake() {
            self.apply(tick, ServoEvent::Disable);
        }
        let waiting = self.visible;
        let Ok(chunk) = self.orders.read_chunk(waiting) else {
            return;
        };
        let (front, back) = chunk.as_slices();
        let unseen = front.iter().chain(back).enumerate().skip(self.scanned);
        let stops = unseen.filter(|(_, order)| matches!(order, Order::Stop | Order::Disable));
        let last_stop = stops.map(|(index, _)| index).last();
        self.scanned = waiting;
        for _ in 0..last_stop.map_or(0, |index| index + 1) {
            let Some(order) = self.pop() else { return };
            self.news = true;
            let dropped = order.is_motion() || tick.stop && order == Order::Enable;
            if dropped || !self.apply(tick, order.event()) {
                self.counters.refused_orders += 1;
            } else if matches!(order, Order::Stop | Order::Disable) {
                self.stopped = true;
                // A stop also gives up the displacement that a law has kept at a stand.
                self.law.iter_mut().for_each(super::law::Installed::end);
                self.fault = self.fault.filter(|_| !self.needs_acknowledgement());
            }
        }
    }

    pub(super) fn pop(&mut self) -> Option<Order> {
        self.front()?;
        let order = self.orders.pop().ok()?;
        self.visible -= 1;
        self.scanned = self.scanned.saturating_sub(1);
        Some(order)
    }

    /// The first order of the queue that this cycle sees.
    fn front(&self) -> Option<&Order> {
        if self.visible == 0 { None } else { self.orders.peek().ok() }
    }

    /// Executes orders from the front of the queue until an order has to wait. Macrosteps and barriers are left to
    /// [`team::coordinate`](crate::team::coordinate).
    pub(super) fn take_orders(&mut self, tick: &Tick) {
        for _ in 0..self.visible {
            let Some(&order) = self.front() else {
                return;
            };
            let refused = tick.stop || self.needs_acknowledgement() && order.is_motion();
            let answer = if refused { Answer::Refuse } else { self.state.next(order.event()) };
            match answer {
                Answer::To(next) => match order {
                    Order::Move(_) => return,
                    Order::Meet { members } | Order::Tie { members } => {
                        if self.state != ServoState::Standing || self.may_meet(members, tick) {
                            return;
                        }
                        self.fail(tick, None, StopCause::NotAMember { members });
                    }
                    Order::Untie => {
                        if !self.is_at_boundary(tick) {
                            return;
                        }
                        self.untie();
                    }
                    Order::Enable | Order::Home | Order::Stop | Order::Disable | Order::ResetFault => {
                        self.enter(tick, next);
                    }
                },
                Answer::Wait => return,
                Answer::Refuse => self.counters.refused_orders += 1,
            }
            self.pop();
            self.news = true;
        }
    }

    /// Whether `members` contains this effector and no effector that does not exist.
    fn may_meet(&self, members: u32, tick: &Tick) -> bool {
        members & self.bit() != 0 && members & !tick.effectors == 0
    }

    /// Whether a partner, the cycle law or a slipping brake stopped this effector, and no order acknowledged this yet.
    pub(super) fn needs_acknowledgement(&self) -> bool {
        self.fault.is_some_and(|fault| fault.cause.needs_acknowledgement())
    }

    /// The barrier at which the effector stands.
    pub(crate) fn barrier(&self, tick: &Tick) -> Option<Barrier> {
        if self.state != ServoState::Standing || self.refused > 0 || self.needs_acknowledgement() {
            return None;
        }
        let barrier = self.front().and_then(Order::barrier);
        barrier.filter(|barrier| self.may_meet(barrier.members(), tick))
    }

    /// Passes the barrier, joins its team if the barrier ties one, and takes the orders behind.
    pub(crate) fn pass(&mut self, barrier: Barrier, tick: &Tick) {
        self.pop();
        self.news = true;
        if let Barrier::Tie(members) = barrier {
            self.tie(members);
        }
        self.take_orders(tick);
    }

    /// The macrostep that the effector can begin in this cycle.
    pub(crate) fn next_macrostep(&self, tick: &Tick) -> Option<&Macrostep> {
        if self.refused > 0 || self.needs_acknowledgement() || !self.is_at_boundary(tick) {
            return None;
        }
        self.front().and_then(Order::macrostep)
    }

    /// Whether the effector waits for partners.
    pub(super) fn is_waiting(&self) -> bool {
        let partners = |order: &Order| order.barrier().is_some() || order.macrostep().is_some() && self.is_tied();
        let stands = self.state == ServoState::Standing && !self.needs_acknowledgement();
        stands && self.front().is_some_and(partners)
    }
}

impl Order {
    fn macrostep(&self) -> Option<&Macrostep> {
        if let Self::Move(macrostep) = self { Some(macrostep) } else { None }
    }

    fn barrier(&self) -> Option<Barrier> {
        match *self {
            Self::Meet { members } => Some(Barrier::Meet(members)),
            Self::Tie { members } => Some(Barrier::Tie(members)),
            Self::Move(_) | Self::Untie | Self::Enable | Self::Home | Self::Stop | Self::Disable | Self::ResetFault => {
                None
            }
        }
    }

    /// Whether a stop drops the order from the queue.
    fn is_motion(&self) -> bool {
        match self {
            Self::Move(_) | Self::Meet { .. } | Self::Tie { .. } | Self::Untie | Self::Home => true,
            Self::Enable | Self::Stop | Self::Disable | Self::ResetFault => false,
        }
    }

    fn event(&self) -> ServoEvent {
        match self {
            Self::Enable => ServoEvent::Enable,
            Self::Home => ServoEvent::Home,
            // A barrier is queued and refused in the same states as the motion behind it.
            Self::Move(_) | Self::Meet { .. } | Self::Tie { .. } | Self::Untie => ServoEvent::Move,
            Self::Stop => ServoEvent::Stop,
            Self::Disable => ServoEvent::Disable,
            Self::ResetFault => ServoEvent::ResetFault,
        }
    }
}
