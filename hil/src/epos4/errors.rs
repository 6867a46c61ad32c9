//! Errors: their table, the error register (0x1001), the history (0x1003) and EMCY.
//!
//! EMCY announces an error once: when the error occurs, or later when the node may send EMCY. EMCY 0x0000 announces
//! the end of the last error (CiA 301 §7.2.7).

use canopen::emcy::ErrorRegister;

use super::{objects::Objects, table::slot};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reaction {
    /// The error is announced, and nothing else happens.
    None,
    /// The abort connection option (0x6007) applies.
    AbortConnection,
    /// The power stage is switched off at once.
    Disable,
    /// The fault reaction option (0x605E) applies.
    Fault,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Error {
    pub(super) code: u16,
    register: ErrorRegister,
    pub(super) reaction: Reaction,
    /// Number of the cause if one code has several causes: entry of object 0x1016, or RPDO.
    source: u8,
}

impl Error {
    /// The same error with another cause. Each cause begins and ends independently.
    pub(super) const fn of(self, source: usize) -> Self {
        Self { source: source as u8, ..self }
    }
}

const fn error(code: u16, register: ErrorRegister, reaction: Reaction) -> Error {
    Error { code, register, reaction, source: 0 }
}

/// An error of communication, to which the abort connection option applies.
const fn communication(code: u16) -> Error {
    error(code, ErrorRegister::COMMUNICATION, Reaction::AbortConnection)
}

pub(super) const OVER_CURRENT: Error = error(0x2310, ErrorRegister::CURRENT, Reaction::Disable);
pub(super) const MOTOR_TEMPERATURE: Error = error(0x4380, ErrorRegister::TEMPERATURE, Reaction::Disable);
/// NMT stop or a reset of the communication, if object 0x6007 makes a fault of either.
pub(super) const CONNECTION_ENDED: Error = communication(0x8100);
pub(super) const HEARTBEAT: Error = communication(0x8130);
pub(super) const PDO_LENGTH: Error = communication(0x8210);
pub(super) const SYNC_LENGTH: Error = error(0x8240, ErrorRegister::COMMUNICATION, Reaction::None);
pub(super) const RPDO_TIME_OUT: Error = communication(0x8250);
pub(super) const FOLLOWING: Error = error(0x8611, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const NEGATIVE_LIMIT: Error = error(0x8A80, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const POSITIVE_LIMIT: Error = error(0x8A81, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const SOFTWARE_LIMIT: Error = error(0x8A82, ErrorRegister::VENDOR, Reaction::Fault);

/// Maximum number of simultaneous errors: eight with one cause, two heartbeats, two kinds for each of four RPDOs.
const PRESENT: usize = 8 + 2 + 2 * 4;

/// The present errors, and their announcement by EMCY.
#[derive(Clone, Debug, Default)]
pub(super) struct Errors {
    /// Each error with whether an EMCY has announced it.
    present: [Option<(Error, bool)>; PRESENT],
    /// Whether an error was announced since the last EMCY 0x0000.
    announced: bool,
}

impl Errors {
    /// Adds an error, unless the error is already present.
    pub(super) fn raise(&mut self, error: Error, objects: &mut Objects) {
        if self.errors().any(|present| present == error) {
            return;
        }
        if let Some(place) = self.present.iter_mut().find(|place| place.is_none()) {
            *place = Some((error, false));
        }
        objects.push_history(error.code);
        objects.set(slot!(ERROR_CODE), u32::from(error.code));
        self.write_register(objects);
    }

    pub(super) fn clear(&mut self, objects: &mut Objects, gone: impl Fn(Error) -> bool) {
        for place in &mut self.present {
            *place = place.filter(|(error, _)| !gone(*error));
        }
        self.write_register(objects);
        if !self.any() {
            objects.set(slot!(ERROR_CODE), 0);
        }
    }

    pub(super) fn any(&self) -> bool {
        self.present.iter().any(Option::is_some)
    }

    /// After a reset of the communication, present errors enter the emptied history and are announced again.
    pub(super) fn restart(&mut self, objects: &mut Objects) {
        self.announced = false;
        for (error, announced) in self.present.iter_mut().flatten() {
            *announced = false;
            objects.push_history(error.code);
            objects.set(slot!(ERROR_CODE), u32::from(error.code));
        }
        self.write_register(objects);
    }

    /// Error code of the next EMCY, which the caller sends; `None` once every change has been announced.
    pub(super) fn announce(&mut self) -> Option<u16> {
        let mut unannounced = self.present.iter_mut().flatten();
        if let Some((error, announced)) = unannounced.find(|(_, announced)| !announced) {
            *announced = true;
            self.announced = true;
            return Some(error.code);
        }
        let ended = self.announced && !self.any();
        self.announced &= !ended;
        ended.then_some(0)
    }

    fn errors(&self) -> impl Iterator<Item = Error> + '_ {
        self.present.iter().flatten().map(|(error, _)| *error)
    }

    fn write_register(&self, objects: &mut Objects) {
        let register = self.errors().fold(ErrorRegister::default(), |register, error| {
            register.with(ErrorRegister::GENERIC).with(error.register)
        });
        objects.set(slot!(ERROR_REGISTER), u32::from(register.0));
    }
}
