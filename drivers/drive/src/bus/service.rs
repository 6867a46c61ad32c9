//! Service frames in operation: SDO requests, and NMT commands to one node, one of them a cycle at most.

use can::{Frame, Instant, Port};
use canopen::nmt;

use super::CanBus;
use crate::Fault;
use crate::cia401::IoFault;

/// A service frame that the port has not taken yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct ServiceFrame {
    pub(super) frame: Frame,
    /// Index of the node among all members.
    member: usize,
    /// The frame is a part of the recovery of its node.
    of_recovery: bool,
}

impl<P: Port> CanBus<P> {
    /// Latches a fault of the bus at every drive, I/O node and sensor. The fault ends all recoveries.
    pub(super) fn latch_all(&mut self, fault: Fault, of_io: IoFault) {
        self.drives.latch_all(fault, &mut self.members);
        for (io, member) in self.io.iter_mut().zip(&mut self.members[self.drives.axes()..]) {
            if io.recovers() {
                member.sdo.reset();
            }
            io.latch(of_io);
        }
        self.sensors.iter_mut().for_each(|sensor| sensor.latch_of_bus(fault));
    }

    /// Makes an NMT command to one node the next service frame.
    pub(super) fn command_node(&mut self, member: usize, command: nmt::Command) {
        let frame = command.to(self.members[member].bring_up.node()).encode();
        self.service = Some(ServiceFrame { frame, member, of_recovery: true });
    }

    /// Chooses the service frame of this cycle: the frame that the port has not taken yet, or the next SDO request. A
    /// frame of a recovery that has ended meanwhile is dropped: it would configure or start a node that stays out of
    /// operation.
    pub(super) fn take_service(&mut self, now: Instant) {
        let waiting = self.service.filter(|service| !service.of_recovery || self.recovers(service.member));
        self.service = waiting.or_else(|| self.next_sdo_frame(now));
    }

    /// The next SDO request; the nodes take turns.
    pub(super) fn next_sdo_frame(&mut self, now: Instant) -> Option<ServiceFrame> {
        for _ in 0..self.members.len() {
            self.turn = (self.turn + 1) % self.members.len();
            let member = self.turn;
            if let Some(frame) = self.members[member].sdo.poll_transmit(now) {
                return Some(ServiceFrame { frame, member, of_recovery: self.recovers(member) });
            }
        }
        None
    }

    /// Whether the node is being brought up again while the others go on.
    fn recovers(&self, member: usize) -> bool {
        match member.checked_sub(self.drives.axes()) {
            None => self.drives.recovers(member),
            Some(io) => self.io.get(io).is_some_and(|io| io.recovers()),
        }
    }
}
