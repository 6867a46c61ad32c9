//! Emulated axis controller with NFv2 telegrams.

use can::Instant;
use serial::nfv2::{
    Answer, BROADCAST, Command, Frame, FrameBuilder, LONGEST, Malformed, START, Status,
};

use super::drive::{Drive, Mode, Sample};
use super::unit::Unit;
use super::{AxisControllerConfig, GAP};
use crate::outbox::Heard;
use crate::{LineDevice, PlantAxis};

/// A serial axis controller with NFv2 telegrams.
///
/// A frame is executed whole or not at all, in the order of its commands. A frame that contains a read is answered. A
/// broadcast frame is executed and not answered. After bytes that form no valid frame, reception resumes at the next
/// `#` that begins a frame.
pub struct Nfv2AxisController {
    address: u8,
    unit: Unit,
    stream: Stream,
}

impl Nfv2AxisController {
    /// A controller after power-on, in manual mode.
    pub fn new(address: u8, config: AxisControllerConfig) -> Self {
        Self {
            address,
            unit: Unit::new(config),
            stream: Stream::new(),
        }
    }

    /// The simulated axis, including state that no drive can measure.
    pub fn axis(&self) -> &PlantAxis {
        self.unit.drive.axis()
    }

    /// Receive counters.
    pub fn heard(&self) -> Heard {
        let stream = &self.stream;
        Heard {
            damaged: stream.damaged,
            skipped: stream.skipped,
            ..self.unit.heard
        }
    }

    /// Switches the supply of the power stage, as a mains switch of its own would.
    pub fn set_supply(&mut self, on: bool) {
        self.unit.drive.set_supply(on);
    }
}

impl LineDevice for Nfv2AxisController {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.unit.outbox.run(now);
        self.stream.push(byte, now);
        while let Some(frame) = self.stream.next() {
            if frame.address != self.address && frame.address != BROADCAST {
                self.unit.heard.foreign += 1;
                continue;
            }
            if !frame.commands().all(|command| command.is_ok_and(possible)) {
                self.unit.heard.refused += 1;
                continue;
            }
            self.unit.heard.obeyed += 1;
            self.unit.drive.catch_up(now);
            let mut answer = FrameBuilder::new(self.address);
            for command in frame.commands().filter_map(Result::<_, Malformed>::ok) {
                answer = obey(&mut self.unit.drive, command, answer, now);
            }
            if frame.address == self.address
                && let Some(bytes) = answer.finish()
            {
                self.unit.answer(bytes, now);
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

/// Whether the drive supports a command.
fn possible(command: Command) -> bool {
    use serial::nfv2::Mode as M;
    !matches!(
        command,
        Command::SetSpeed(_)
            | Command::SetPosition(_)
            | Command::SetMode(M::Speed | M::Position | M::SyncPosition)
    )
}

fn obey(drive: &mut Drive, command: Command, answer: FrameBuilder, now: Instant) -> FrameBuilder {
    use serial::nfv2::Mode as M;
    match command {
        Command::SetMode(mode) => {
            match mode {
                M::Error => drive.set_mode(Mode::Error),
                M::Manual => drive.set_mode(Mode::Manual),
                M::Pwm | M::SyncPwm => drive.set_mode(Mode::Pwm),
                M::Current | M::SyncCurrent => drive.set_mode(Mode::Current),
                M::Speed | M::Position | M::SyncPosition => {}
            }
            drive.search_index(matches!(mode, M::SyncPwm | M::SyncCurrent));
        }
        Command::SetPwm(value) => drive.set_point(Mode::Pwm, value, now),
        Command::SetCurrent(value) => drive.set_point(Mode::Current, value, now),
        Command::SetSpeed(_) | Command::SetPosition(_) => {}
        Command::SetMaxCurrent(current) => drive.set_max_current(current),
        Command::SetMisc(bits) => {
            if bits & Command::SET_SYNCHRONIZED != 0 {
                drive.set_synchronized(true);
            }
            if bits & Command::RESET_SYNCHRONIZED != 0 {
                drive.set_synchronized(false);
            }
        }
        Command::SetCurrentRegulator(gains) => drive.set_current_gains(gains),
        Command::ReadPosition => return answer.answer(Answer::Position(drive.sample().position)),
        Command::ReadCurrent => return answer.answer(Answer::Current(drive.sample().current)),
        Command::ReadStatus => return answer.answer(Answer::Status(status(&drive.sample()))),
    }
    answer
}

fn status(sample: &Sample) -> Status {
    let bits = [
        (sample.upper_limit, Status::UPPER_LIMIT),
        (sample.lower_limit, Status::LOWER_LIMIT),
        (sample.home_switch, Status::HOME_SWITCH),
        (sample.index, Status::INDEX),
        (sample.synchronized, Status::SYNCHRONIZED),
        (sample.faults.over_current, Status::OVERCURRENT),
        (sample.faults.power_stage, Status::POWER_STAGE_FAULT),
        (sample.error, Status::ERROR),
    ];
    let set = bits.into_iter().filter(|(is, _)| *is);
    Status(set.fold(0, |status, (_, bit)| status | bit))
}

/// Finds frames in the received bytes.
struct Stream {
    bytes: [u8; LONGEST],
    count: usize,
    /// Bytes of the last returned frame, which are still at the front of the buffer.
    used: usize,
    last: Instant,
    damaged: u64,
    skipped: u64,
}

impl Stream {
    fn new() -> Self {
        Self {
            bytes: [0; LONGEST],
            count: 0,
            used: 0,
            last: Instant::ZERO,
            damaged: 0,
            skipped: 0,
        }
    }

    /// Takes a byte. The buffer has room after [`Stream::next`] has returned `None`.
    fn push(&mut self, byte: u8, now: Instant) {
        if self.count > 0 && now.since(self.last) > GAP {
            self.skipped += self.count as u64;
            self.count = 0;
        }
        self.last = now;
        self.bytes[self.count] = byte;
        self.count += 1;
    }

    /// The next whole frame. Called until the result is `None`. At most the beginning of a frame remains then.
    fn next(&mut self) -> Option<Frame<'_>> {
        let used = std::mem::take(&mut self.used);
        self.remove(used);
        self.used = self.find()?;
        Frame::parse(&self.bytes[..self.used])
    }

    /// Drops bytes that cannot begin a frame. Returns the length of the first valid frame, if the buffer contains
    /// one.
    fn find(&mut self) -> Option<usize> {
        loop {
            let bytes = &self.bytes[..self.count];
            let start = bytes.iter().position(|&byte| byte == START);
            let before = start.unwrap_or(self.count);
            self.skipped += before as u64;
            self.remove(before);
            if self.count < 3 {
                return None;
            }
            match Frame::length(&self.bytes[..self.count]) {
                Some(length) if length > self.count => return None,
                Some(length) if Frame::parse(&self.bytes[..length]).is_some() => {
                    return Some(length);
                }
                Some(_) => self.damaged += 1,
                None => {}
            }
            self.skipped += 1;
            self.remove(1);
        }
    }

    fn remove(&mut self, count: usize) {
        if count > 0 {
            self.bytes.copy_within(count..self.count, 0);
            self.count -= count;
        }
    }
}
