//! The older hi_moxa telegrams of an emulated axis controller.

use can::Instant;
use serial::hi_moxa::{Answer, DriverMode, Flags, Mode as Follows, PREAMBLE, Parameter, REQUEST, Request};

use super::GAP;
use super::drive::{Drive, Mode, Search};

/// First byte of an answer. No source documents its value.
const START: u8 = 0x23;

/// A window that contains no received byte.
const NOTHING: [u8; REQUEST] = [0xFF; REQUEST];

pub(super) struct HiMoxa {
    /// The last bytes received.
    window: [u8; REQUEST],
    /// Bytes since the last preamble, while they can still become a request.
    since: Option<usize>,
    last: Instant,
}

impl HiMoxa {
    pub(super) fn new() -> Self {
        Self { window: NOTHING, since: None, last: Instant::ZERO }
    }

    /// Takes a byte. Executes the request that ends with the byte, and passes the answer on.
    pub(super) fn receive(&mut self, byte: u8, now: Instant, drive: &mut Drive, mut send: impl FnMut(&[u8])) {
        if now.since(self.last) > GAP {
            self.window = NOTHING;
            self.since = None;
        }
        self.last = now;
        self.window.rotate_left(1);
        self.window[REQUEST - 1] = byte;
        if self.window.ends_with(&PREAMBLE) {
            self.since = Some(0);
            return;
        }
        self.since = self.since.map(|count| count + 1);
        if self.since == Some(REQUEST - PREAMBLE.len()) {
            self.since = None;
            if let Some(request) = Request::decode(&self.window) {
                drive.catch_up(now);
                if obey(drive, request) {
                    send(&answer(drive).encode());
                }
            }
        }
    }
}

/// Executes a request. Returns `false` if the drive does not support the request.
fn obey(drive: &mut Drive, request: Request) -> bool {
    match request {
        Request::Drive { mode: Follows::Position, .. } => return false,
        Request::Drive { mode, value, latch_index } => {
            let mode = if mode == Follows::Pwm { Mode::Pwm } else { Mode::Current };
            // The host sends no other command to leave manual mode.
            drive.set_mode(mode);
            drive.search_index(latch_index);
            drive.set_point(mode, value);
        }
        Request::Set(parameter) => match parameter {
            Parameter::Synchronized(synchronized) => drive.synchronized = synchronized,
            Parameter::MaxCurrent(current) => drive.set_max_current(current),
            Parameter::PositionGain(..) | Parameter::CurrentGain(..) => {}
            Parameter::DriverMode(mode) => drive.set_mode(match mode {
                DriverMode::Manual => Mode::Manual,
                DriverMode::Pwm => Mode::Pwm,
                DriverMode::Error => Mode::Error,
            }),
        },
    }
    true
}

fn answer(drive: &Drive) -> Answer {
    let (feedback, faults) = (&drive.feedback, drive.faults());
    let bits = [
        (feedback.positive_limit, Flags::UPPER_LIMIT),
        (feedback.negative_limit, Flags::LOWER_LIMIT),
        (feedback.home_switch, Flags::HOME_SWITCH),
        (drive.search == Search::Found, Flags::INDEX),
        (faults.power_stage, Flags::POWER_STAGE_FAULT),
        (faults.over_current, Flags::OVERCURRENT),
        (drive.mode == Mode::Error, Flags::ERROR),
        (drive.synchronized, Flags::SYNCHRONIZED),
    ];
    let set = bits.into_iter().filter(|(is, _)| *is);
    Answer {
        start: START,
        flags: Flags(set.fold(0, |flags, (_, bit)| flags | bit)),
        current: drive.current(),
        position: drive.position(),
    }
}
