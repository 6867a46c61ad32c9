//! Emulated axis controller with hi_moxa telegrams.

use can::Instant;
use serial::hi_moxa::{
    Answer, DriverMode, Flags, Mode as Follows, PREAMBLE, Parameter, REQUEST, Request,
};

use super::drive::{Drive, Mode, Sample};
use super::unit::Unit;
use super::{AxisControllerConfig, GAP};
use crate::outbox::Heard;
use crate::{LineDevice, PlantAxis};

/// First byte of an answer. No source documents its value.
const START: u8 = 0x23;

/// A serial axis controller with the older telegrams.
///
/// A request is ten bytes from a preamble on. Bytes between requests are skipped. A preamble within a request begins
/// a new request. The telegram has neither length nor checksum. Bytes that follow a torn request without a pause can
/// therefore be taken for the rest of that request. Gains are accepted without effect, since no source gives their
/// scale.
pub struct HiMoxaAxisController {
    unit: Unit,
    /// The last bytes received.
    window: [u8; REQUEST],
    /// Bytes since the last preamble, while they can still become a request.
    since: Option<usize>,
    last: Instant,
}

impl HiMoxaAxisController {
    /// A controller after power-on, in manual mode.
    pub fn new(config: AxisControllerConfig) -> Self {
        Self {
            window: NOTHING,
            since: None,
            last: config.power_on,
            unit: Unit::new(config),
        }
    }

    /// The simulated axis, including state that no drive can measure.
    pub fn axis(&self) -> &PlantAxis {
        self.unit.drive.axis()
    }

    /// Receive counters. Without a checksum no request counts as damaged. Without an address no request counts as
    /// foreign.
    pub fn heard(&self) -> Heard {
        self.unit.heard
    }

    /// Switches the supply of the power stage, as a mains switch of its own would.
    pub fn set_supply(&mut self, on: bool) {
        self.unit.drive.set_supply(on);
    }

    fn serve(&mut self, request: Request, now: Instant) {
        self.unit.drive.catch_up(now);
        if !obey(&mut self.unit.drive, request, now) {
            self.unit.heard.refused += 1;
            return;
        }
        self.unit.heard.obeyed += 1;
        let answer = answer(&self.unit.drive.sample()).encode();
        self.unit.answer(&answer, now);
    }
}

/// A window that contains no received byte.
const NOTHING: [u8; REQUEST] = [0xFF; REQUEST];

impl LineDevice for HiMoxaAxisController {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.unit.outbox.run(now);
        if now.since(self.last) > GAP {
            self.window = NOTHING;
            self.since = None;
        }
        self.last = now;
        self.window.rotate_left(1);
        self.window[REQUEST - 1] = byte;
        self.unit.heard.skipped += 1;
        if self.window.ends_with(&PREAMBLE) {
            self.since = Some(0);
            return;
        }
        self.since = self.since.map(|count| count + 1);
        if self.since == Some(REQUEST - PREAMBLE.len()) {
            self.since = None;
            self.unit.heard.skipped -= REQUEST as u64;
            match Request::decode(&self.window) {
                Some(request) => self.serve(request, now),
                None => self.unit.heard.refused += 1,
            }
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        self.unit.outbox.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.unit.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.unit.handle_timeout(now);
    }
}

/// Executes a request. Returns `false` if the drive does not support the request.
fn obey(drive: &mut Drive, request: Request, now: Instant) -> bool {
    match request {
        Request::Drive {
            mode: Follows::Position,
            ..
        } => return false,
        Request::Drive {
            mode,
            value,
            latch_index,
        } => {
            let mode = if mode == Follows::Pwm {
                Mode::Pwm
            } else {
                Mode::Current
            };
            // The host sends no other command to leave manual mode.
            drive.set_mode(mode);
            drive.search_index(latch_index);
            drive.set_point(mode, value, now);
        }
        Request::Set(parameter) => match parameter {
            Parameter::Synchronized(synchronized) => drive.set_synchronized(synchronized),
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

fn answer(sample: &Sample) -> Answer {
    let bits = [
        (sample.upper_limit, Flags::UPPER_LIMIT),
        (sample.lower_limit, Flags::LOWER_LIMIT),
        (sample.home_switch, Flags::HOME_SWITCH),
        (sample.index, Flags::INDEX),
        (sample.faults.power_stage, Flags::POWER_STAGE_FAULT),
        (sample.faults.over_current, Flags::OVERCURRENT),
        (sample.error, Flags::ERROR),
        (sample.synchronized, Flags::SYNCHRONIZED),
    ];
    let set = bits.into_iter().filter(|(is, _)| *is);
    Answer {
        start: START,
        flags: Flags(set.fold(0, |flags, (_, bit)| flags | bit)),
        current: sample.current,
        position: sample.position,
    }
}
