//! Errors: their table, the error register (0x1001), the history (0x1003) and EMCY.

use can::Frame;
use canopen::emcy::{Emergency, ErrorRegister};
use canopen::{NodeId, objects as named};

use super::objects::Objects;
use super::table::Slot;

/// What a drive does about an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reaction {
    /// As the abort connection option (0x6007) says.
    AbortConnection,
    /// Power stage off at once.
    Disable,
    /// As the fault reaction option (0x605E) says.
    Fault,
}

/// An error as EPOS4 knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Error {
    pub(super) code: u16,
    register: ErrorRegister,
    pub(super) reaction: Reaction,
}

const fn error(code: u16, register: ErrorRegister, reaction: Reaction) -> Error {
    Error {
        code,
        register,
        reaction,
    }
}

pub(super) const OVER_CURRENT: Error = error(0x2310, ErrorRegister::CURRENT, Reaction::Disable);
pub(super) const MOTOR_TEMPERATURE: Error =
    error(0x4380, ErrorRegister::TEMPERATURE, Reaction::Disable);
pub(super) const HEARTBEAT: Error = error(
    0x8130,
    ErrorRegister::COMMUNICATION,
    Reaction::AbortConnection,
);
pub(super) const PDO_LENGTH: Error = error(
    0x8210,
    ErrorRegister::COMMUNICATION,
    Reaction::AbortConnection,
);
pub(super) const RPDO_TIME_OUT: Error = error(
    0x8250,
    ErrorRegister::COMMUNICATION,
    Reaction::AbortConnection,
);
pub(super) const FOLLOWING: Error = error(0x8611, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const NEGATIVE_LIMIT: Error = error(0x8A80, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const POSITIVE_LIMIT: Error = error(0x8A81, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const SOFTWARE_LIMIT: Error = error(0x8A82, ErrorRegister::VENDOR, Reaction::Fault);

/// Errors present at once that are told apart; more are said by EMCY and forgotten.
const PRESENT: usize = 8;

/// The errors that are present.
#[derive(Clone, Debug)]
pub(super) struct Errors {
    present: [Option<Error>; PRESENT],
}

const REGISTER: Slot = Slot::of(named::ERROR_REGISTER);
const LAST_CODE: Slot = Slot::of(named::ERROR_CODE);

impl Errors {
    pub(super) fn new() -> Self {
        Self {
            present: [None; PRESENT],
        }
    }

    /// Notes an error; `false` if it is present already.
    pub(super) fn raise(&mut self, error: Error, objects: &mut Objects) -> bool {
        if self.present.contains(&Some(error)) {
            return false;
        }
        if let Some(place) = self.present.iter_mut().find(|place| place.is_none()) {
            *place = Some(error);
        }
        objects.push_history(error.code);
        objects.set(LAST_CODE, u32::from(error.code));
        self.write_register(objects);
        true
    }

    /// Removes what `gone` says is gone; `true` once nothing is left.
    pub(super) fn clear(&mut self, objects: &mut Objects, gone: impl Fn(Error) -> bool) -> bool {
        let before = self.present;
        for place in &mut self.present {
            *place = place.filter(|error| !gone(*error));
        }
        self.write_register(objects);
        let none_left = !self.any() && self.present != before;
        if none_left {
            objects.set(LAST_CODE, 0);
        }
        none_left
    }

    /// Whether any error is present.
    pub(super) fn any(&self) -> bool {
        self.present.iter().any(Option::is_some)
    }

    /// Forgets everything without a word, as a reset does.
    pub(super) fn reset(&mut self) {
        self.present = [None; PRESENT];
    }

    fn write_register(&self, objects: &mut Objects) {
        let register = self
            .present
            .iter()
            .flatten()
            .fold(ErrorRegister::default(), |register, error| {
                register.with(ErrorRegister::GENERIC).with(error.register)
            });
        objects.set(REGISTER, u32::from(register.0));
    }
}

/// The EMCY that says `code`; 0 for no error.
pub(super) fn emergency(node: NodeId, code: u16, objects: &Objects) -> Frame {
    Emergency {
        node,
        code,
        error_register: ErrorRegister(objects.u(REGISTER) as u8),
        vendor: [0; 5],
    }
    .encode()
}
