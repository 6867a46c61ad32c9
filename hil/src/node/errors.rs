//! Errors: those of every node, the error register (0x1001), the history (0x1003) and EMCY.
//!
//! EMCY announces an error once: when the error occurs, or later when the node may send EMCY. EMCY 0x0000 announces
//! the end of the last error (CiA 301 §7.2.7).

use canopen::emcy::ErrorRegister;

use super::objects::Objects;

/// Reaction of the application to an error. A module of inputs and outputs has the first two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reaction {
    /// The error is announced, and nothing else happens.
    None,
    /// Communication is disturbed. In a drive, the abort connection option (0x6007) applies.
    AbortConnection,
    /// The power stage is switched off at once.
    Disable,
    /// The fault reaction option (0x605E) applies.
    Fault,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Error {
    pub(crate) code: u16,
    register: ErrorRegister,
    pub(crate) reaction: Reaction,
    /// Number of the cause if one code has several causes: entry of object 0x1016, or RPDO.
    source: u8,
}

impl Error {
    /// The same error with another cause. Each cause begins and ends independently.
    pub(crate) const fn of(self, source: usize) -> Self {
        Self { source: source as u8, ..self }
    }
}

pub(crate) const fn error(code: u16, register: ErrorRegister, reaction: Reaction) -> Error {
    Error { code, register, reaction, source: 0 }
}

/// An error of communication.
pub(crate) const fn communication(code: u16) -> Error {
    error(code, ErrorRegister::COMMUNICATION, Reaction::AbortConnection)
}

pub(crate) const HEARTBEAT: Error = communication(0x8130);
pub(crate) const PDO_LENGTH: Error = communication(0x8210);
pub(crate) const SYNC_LENGTH: Error = error(0x8240, ErrorRegister::COMMUNICATION, Reaction::None);
pub(crate) const RPDO_TIME_OUT: Error = communication(0x8250);

/// Maximum number of simultaneous errors: eight with one cause, as a drive has, two heartbeats, two kinds for each of four RPDOs.
const PRESENT: usize = 8 + 2 + 2 * 4;

/// The present errors, and their announcement by EMCY.
#[derive(Clone, Debug, Default)]
pub(crate) struct Errors {
    /// Each error with whether an EMCY has announced it.
    present: [Option<(Error, bool)>; PRESENT],
    /// Whether an error was announced since the last EMCY 0x0000.
    announced: bool,
}

impl Errors {
    /// Adds an error, unless the error is already present.
    pub(crate) fn raise(&mut self, error: Error, objects: &mut Objects) {
        if self.errors().any(|present| present == error) {
            return;
        }
        if let Some(place) = self.present.iter_mut().find(|place| place.is_none()) {
            *place = Some((error, false));
        }
        objects.push_history(error.code);
        set_error_code(objects, error.code);
        self.write_register(objects);
    }

    pub(crate) fn clear(&mut self, objects: &mut Objects, gone: impl Fn(Error) -> bool) {
        for place in &mut self.present {
            *place = place.filter(|(error, _)| !gone(*error));
        }
        self.write_register(objects);
        if !self.any() {
            set_error_code(objects, 0);
        }
    }

    pub(crate) fn any(&self) -> bool {
        self.present.iter().any(Option::is_some)
    }

    /// After a reset of the communication, present errors enter the emptied history and are announced again.
    pub(crate) fn restart(&mut self, objects: &mut Objects) {
        self.announced = false;
        for (error, announced) in self.present.iter_mut().flatten() {
            *announced = false;
            objects.push_history(error.code);
            set_error_code(objects, error.code);
        }
        self.write_register(objects);
    }

    /// Error code of the next EMCY, which the caller sends; `None` once every change has been announced.
    pub(crate) fn announce(&mut self) -> Option<u16> {
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

    /// Whether [`Errors::announce`] has a code to return.
    pub(crate) fn unannounced(&self) -> bool {
        let mut present = self.present.iter().flatten();
        present.any(|(_, announced)| !announced) || self.announced && !self.any()
    }

    fn errors(&self) -> impl Iterator<Item = Error> + '_ {
        self.present.iter().flatten().map(|(error, _)| *error)
    }

    fn write_register(&self, objects: &mut Objects) {
        let register = self.errors().fold(ErrorRegister::default(), |register, error| {
            register.with(ErrorRegister::GENERIC).with(error.register)
        });
        objects.set(objects.communication.error_register, u32::from(register.0));
    }
}

fn set_error_code(objects: &mut Objects, code: u16) {
    if let Some(slot) = objects.communication.error_code {
        objects.set(slot, u32::from(code));
    }
}
