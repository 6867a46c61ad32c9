//! A scripted axis controller, built from the layouts of its telegrams alone.

#![allow(dead_code, reason = "each test takes what it needs")]

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use can::Instant;
use mrroc_drive::axis_controller::Protocol;
use serial::hi_moxa::{self, DriverMode, Flags, Parameter, Request};
use serial::nfv2::{self, Answer, Command, Frame, FrameBuilder, Mode, Status};
use serial::{Line, LineCounters, LineError};

/// A drive whose counter moves, after each sample, by its set-point or by its own velocity.
pub(crate) struct Drive {
    pub(crate) protocol: Protocol,
    pub(crate) address: u8,
    /// Position in the next answer.
    pub(crate) position: i32,
    pub(crate) current: i16,
    pub(crate) status: u16,
    pub(crate) start: u8,
    /// Increments per telegram, in addition to the set-point.
    pub(crate) velocity: i32,
    pub(crate) follows: bool,
    /// The drive keeps its reference when commanded to forget it.
    pub(crate) keeps_reference: bool,
    /// Position of the index pulse, increments.
    pub(crate) index: Option<i32>,
    pub(crate) mode: Mode,
    pub(crate) setpoint: i16,
    pub(crate) max_current: i16,
    /// Number of answers to omit.
    pub(crate) mute: u32,
    pub(crate) deaf: bool,
    /// The line takes no more bytes.
    pub(crate) full: bool,
    pub(crate) gone: bool,
    /// The line keeps the bytes that it takes and delivers none.
    pub(crate) stalled: bool,
    pub(crate) unsent: Vec<u8>,
    /// Bytes as written, one item per write.
    pub(crate) heard: Vec<Vec<u8>>,
    pub(crate) keep_heard: bool,
    /// Bytes that the host has not read yet.
    pub(crate) outbox: VecDeque<u8>,
    /// The last answer, before any damage.
    pub(crate) last_answer: Vec<u8>,
}

impl Drive {
    pub(crate) fn new(protocol: Protocol, address: u8) -> Self {
        Self {
            protocol,
            address,
            position: 1_000,
            current: 0,
            status: 0,
            start: 0x2A,
            velocity: 0,
            follows: false,
            keeps_reference: false,
            index: None,
            mode: Mode::Manual,
            setpoint: 0,
            max_current: 0,
            mute: 0,
            deaf: false,
            full: false,
            gone: false,
            stalled: false,
            unsent: Vec::new(),
            heard: Vec::with_capacity(64),
            keep_heard: true,
            outbox: VecDeque::with_capacity(16_384),
            last_answer: Vec::with_capacity(64),
        }
    }

    pub(crate) fn shared(self) -> Shared {
        Shared(Arc::new(Mutex::new(self)))
    }

    pub(crate) fn hear(&mut self, bytes: &[u8]) {
        match self.protocol {
            Protocol::Nfv2 => {
                let mut rest = bytes;
                while !rest.is_empty() {
                    let length = Frame::length(rest).unwrap_or(usize::MAX);
                    match rest.get(..length).and_then(Frame::parse) {
                        Some(frame) => {
                            self.nfv2(frame);
                            rest = &rest[length..];
                        }
                        None => rest = &rest[1..],
                    }
                }
            }
            Protocol::HiMoxa => {
                let mut rest = bytes;
                while let Some(request) = rest.first_chunk::<{ hi_moxa::REQUEST }>() {
                    if let Some(request) = Request::decode(request) {
                        self.hi_moxa(request);
                        rest = &rest[hi_moxa::REQUEST..];
                    } else {
                        rest = &rest[1..];
                    }
                }
            }
        }
    }

    fn nfv2(&mut self, frame: Frame) {
        if frame.address != self.address && frame.address != nfv2::BROADCAST {
            return;
        }
        let mut answer = FrameBuilder::new(self.address);
        let mut asked = false;
        let mut mode = None;
        for command in frame.commands().flatten() {
            match command {
                Command::ReadPosition => _ = answer.answer(Answer::Position(self.position)),
                Command::ReadCurrent => _ = answer.answer(Answer::Current(self.current)),
                Command::ReadStatus => _ = answer.answer(Answer::Status(Status(self.status))),
                Command::SetMode(new) => mode = Some(new),
                Command::SetCurrent(value) | Command::SetPwm(value) => self.setpoint = value,
                Command::SetMaxCurrent(value) => self.max_current = value,
                Command::SetMisc(Command::RESET_SYNCHRONIZED) => self.forget_reference(),
                Command::SetMisc(_)
                | Command::SetSpeed(_)
                | Command::SetPosition(_)
                | Command::SetCurrentRegulator(_) => {}
            }
            asked |= matches!(command, Command::ReadPosition);
        }
        if let Some(mode) = mode {
            self.set_mode(mode);
        }
        self.turn();
        // A drive executes a broadcast but does not answer it.
        if asked && frame.address == self.address {
            self.answer(answer.finish().expect("three answers fit a frame"));
        }
    }

    fn hi_moxa(&mut self, request: Request) {
        let bits = [
            (Status::UPPER_LIMIT, Flags::UPPER_LIMIT),
            (Status::LOWER_LIMIT, Flags::LOWER_LIMIT),
            (Status::HOME_SWITCH, Flags::HOME_SWITCH),
            (Status::INDEX, Flags::INDEX),
            (Status::POWER_STAGE_FAULT, Flags::POWER_STAGE_FAULT),
            (Status::OVERCURRENT, Flags::OVERCURRENT),
            (Status::ERROR, Flags::ERROR),
            (Status::SYNCHRONIZED, Flags::SYNCHRONIZED),
        ];
        let set = bits.into_iter().filter(|(bit, _)| self.status & bit != 0);
        let answer = hi_moxa::Answer {
            start: self.start,
            flags: Flags(set.map(|(_, flag)| flag).sum()),
            current: self.current,
            position: self.position,
        };
        match request {
            Request::Drive { value, latch_index, .. } => {
                self.setpoint = value;
                if self.mode != Mode::Manual && self.mode != Mode::Error {
                    self.set_mode(if latch_index { Mode::SyncPwm } else { Mode::Pwm });
                }
            }
            Request::Set(Parameter::MaxCurrent(value)) => self.max_current = value,
            Request::Set(Parameter::Synchronized(false)) => self.forget_reference(),
            Request::Set(Parameter::DriverMode(mode)) => self.set_mode(match mode {
                DriverMode::Manual => Mode::Manual,
                DriverMode::Pwm => Mode::Pwm,
                DriverMode::Error => Mode::Error,
            }),
            Request::Set(_) => {}
        }
        self.turn();
        self.answer(&answer.encode());
    }

    fn forget_reference(&mut self) {
        if !self.keeps_reference {
            self.status &= !Status::SYNCHRONIZED;
        }
    }

    fn set_mode(&mut self, mode: Mode) {
        if mode == Mode::Manual {
            self.status &= !(Status::OVERCURRENT | Status::ERROR);
        } else if mode == Mode::Error {
            self.status |= Status::ERROR;
        }
        self.mode = mode;
    }

    /// Moves after the sample was taken.
    fn turn(&mut self) {
        let before = self.position;
        let powered = !matches!(self.mode, Mode::Manual | Mode::Error);
        if self.follows && powered {
            self.position += i32::from(self.setpoint);
        }
        self.position += self.velocity;
        if let Some(index) = self.index
            && matches!(self.mode, Mode::SyncPwm | Mode::SyncCurrent)
            && (before < index) != (self.position < index)
        {
            self.position -= index;
            self.status |= Status::SYNCHRONIZED;
            self.index = None;
        }
    }

    fn answer(&mut self, bytes: &[u8]) {
        self.last_answer.clear();
        self.last_answer.extend_from_slice(bytes);
        if self.mute > 0 {
            self.mute -= 1;
        } else {
            self.outbox.extend(bytes);
        }
    }

    /// Simulates a loss and return of the drive's supply.
    pub(crate) fn restart(&mut self) {
        self.position = 0;
        self.status = 0;
        self.mode = Mode::Manual;
        self.setpoint = 0;
    }
}

/// The line with the drive at its end. The test keeps a second handle.
#[derive(Clone)]
pub(crate) struct Shared(Arc<Mutex<Drive>>);

impl Shared {
    pub(crate) fn drive(&self) -> MutexGuard<'_, Drive> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Line for Shared {
    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let mut drive = self.drive();
        if drive.gone {
            return Err(LineError::Gone);
        }
        if drive.full {
            return Ok(0);
        }
        if drive.keep_heard {
            drive.heard.push(bytes.to_vec());
        }
        if drive.stalled {
            drive.unsent.extend(bytes);
        } else if !drive.deaf {
            drive.hear(bytes);
        }
        Ok(bytes.len())
    }

    fn read(&mut self, _now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        let mut drive = self.drive();
        if drive.gone {
            return Err(LineError::Gone);
        }
        let count = into.len().min(drive.outbox.len());
        into.iter_mut().zip(drive.outbox.drain(..count)).for_each(|(to, from)| *to = from);
        Ok(count)
    }

    fn discard_unsent(&mut self) {
        self.drive().unsent.clear();
    }

    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}
