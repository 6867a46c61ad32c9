//! Supervision of the communication: begin and end of its errors, and the reaction of the node.

use can::{Frame, Instant, StandardId};
use canopen::emcy::{Emergency, ErrorRegister};
use canopen::nmt;
use canopen::pdo::{PdoKind, PdoNumber};

use super::errors::{self, Error};
use super::pdo::{self, Reception};
use super::{Application, Node, heartbeats};

impl<A: Application> Node<A> {
    /// Handles an error. The application reacts each time. EMCY announces an error once while the error is present.
    pub(crate) fn fail(&mut self, error: Error) {
        self.errors.raise(error, &mut self.objects);
        self.announce();
        self.application.react(error, &mut self.objects);
    }

    /// Handles the end of the connection by the master, which is an error for some applications.
    pub(crate) fn end_connection(&mut self) {
        if let Some(error) = self.application.end_connection(&mut self.objects) {
            self.fail(error);
        }
    }

    /// Handles a communication error. Object 0x1029 determines the change of the NMT state.
    pub(crate) fn lose_contact(&mut self, error: Error, now: Instant) {
        self.fail(error);
        let to = match self.objects.u(self.objects.communication.error_behaviour) {
            0 if self.objects.nmt == nmt::NmtState::Operational => nmt::NmtState::PreOperational,
            2 => nmt::NmtState::Stopped,
            _ => return,
        };
        self.enter(to, now);
    }

    /// Ends a communication error when the missing frame is received. A fault keeps the error until a reset.
    pub(crate) fn regain(&mut self, error: Error) {
        if self.errors.any() && !self.application.faulted() {
            self.clear(|present| present == error);
        }
    }

    pub(crate) fn clear(&mut self, gone: impl Fn(Error) -> bool) {
        self.errors.clear(&mut self.objects, gone);
        self.announce();
    }

    /// Fault reset: ends every error except the loss of a node that still sends no heartbeat.
    pub(crate) fn reset_fault(&mut self) {
        let consumers = self.consumers;
        let silent = |error, number| consumers.lost(number) && error == errors::HEARTBEAT.of(number);
        self.clear(|error| !(0..heartbeats::ENTRIES).any(|number| silent(error, number)));
    }

    /// Sends the EMCYs that are due, unless the NMT state or the inhibit time forbids them. Forbidden EMCYs are sent
    /// later.
    pub(crate) fn announce(&mut self) {
        let Some(node) = self.id.filter(|_| self.serving()) else {
            return;
        };
        while self.emergency_at <= self.now
            && let Some(code) = self.errors.announce()
        {
            self.emergency_at = self.now + self.objects.emergency_inhibit();
            let error_register = ErrorRegister(self.objects.u(self.objects.communication.error_register) as u8);
            self.send(Emergency { node, code, error_register, vendor: [0; 5] }.encode());
        }
    }

    /// Applies a write to object 0x1017: heartbeats begin at once (CiA 301 §7.2.8.3.2.2), or end.
    pub(crate) fn start_heartbeat(&mut self, now: Instant) {
        self.heartbeat_at = self.objects.heartbeat_period().map(|_| now);
        self.produce_heartbeat(now);
    }

    pub(crate) fn produce_heartbeat(&mut self, now: Instant) {
        if let Some(at) = self.heartbeat_at.filter(|at| *at <= now) {
            self.send_heartbeat(self.objects.nmt);
            self.heartbeat_at = self.objects.heartbeat_period().map(|period| at + period);
        }
    }

    /// Applies a write to object 0x1016. The loss of a node that is no longer monitored ends.
    pub(crate) fn read_consumers(&mut self) {
        let ended = self.consumers.read(&self.objects);
        for (number, _) in ended.into_iter().enumerate().filter(|(_, ended)| *ended) {
            self.regain(errors::HEARTBEAT.of(number));
        }
    }

    /// A SYNC has no data, since there is no object 0x1019 (CiA 301 §7.5.2.22).
    pub(crate) fn hear_sync(&mut self, frame: &Frame, now: Instant) {
        if frame.data().is_empty() {
            self.regain(errors::SYNC_LENGTH);
            self.synchronise(now);
        } else {
            self.catch_up(now, false);
            self.fail(errors::SYNC_LENGTH);
        }
    }

    pub(crate) fn receive_pdo(&mut self, id: StandardId, data: &[u8], now: Instant) -> bool {
        match self.pdos.receive(id, data, &mut self.objects, now) {
            Reception::Foreign => return false,
            Reception::Waiting(number) => self.regain_pdo(number),
            Reception::Effective(number) => {
                self.catch_up(now, false);
                self.regain_pdo(number);
                self.settle(now);
            }
            Reception::TooShort(number) => {
                self.catch_up(now, false);
                self.fail(errors::PDO_LENGTH.of(number));
            }
        }
        true
    }

    pub(crate) fn regain_pdo(&mut self, number: usize) {
        self.regain(errors::RPDO_TIME_OUT.of(number));
        self.regain(errors::PDO_LENGTH.of(number));
    }

    /// Applies a write to a parameter of a PDO. Errors of an RPDO end when the RPDO or its timer is switched off.
    pub(crate) fn update_pdo(&mut self, kind: PdoKind, number: PdoNumber) {
        if self.objects.nmt == nmt::NmtState::Operational {
            self.pdos.update(kind, number, &self.objects);
        }
        if kind == PdoKind::Rpdo {
            let at = usize::from(number.offset());
            match pdo::watched(number, &self.objects) {
                (false, _) => self.regain_pdo(at),
                (true, false) => self.regain(errors::RPDO_TIME_OUT.of(at)),
                (true, true) => {}
            }
        }
    }
}
