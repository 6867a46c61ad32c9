//! NFv2 telegrams of an emulated axis controller.

use can::Instant;
use serial::nfv2::{Answer, BROADCAST, Command, Frame, FrameBuilder, LONGEST, Malformed, START, Status};

use super::GAP;
use super::drive::{Drive, Mode, Search};

pub(super) struct Nfv2 {
    address: u8,
    stream: Stream,
}

impl Nfv2 {
    pub(super) fn new(address: u8) -> Self {
        let stream = Stream { bytes: [0; LONGEST], count: 0, used: 0, last: Instant::ZERO };
        Self { address, stream }
    }

    /// Takes a byte. Executes the frame that ends with the byte, and passes the answer on.
    pub(super) fn receive(&mut self, byte: u8, now: Instant, drive: &mut Drive, mut send: impl FnMut(&[u8])) {
        self.stream.push(byte, now);
        while let Some(frame) = self.stream.next() {
            let own = frame.address == self.address;
            let concerned = own || frame.address == BROADCAST;
            if !concerned || !frame.commands().all(|command| command.is_ok_and(possible)) {
                continue;
            }
            drive.catch_up(now);
            let mut answer = FrameBuilder::new(self.address);
            for command in frame.commands().filter_map(Result::<_, Malformed>::ok) {
                obey(drive, command, &mut answer);
            }
            if own && let Some(bytes) = answer.finish() {
                send(bytes);
            }
        }
    }
}

/// Whether the drive supports a command.
fn possible(command: Command) -> bool {
    use serial::nfv2::Mode as M;
    !matches!(
        command,
        Command::SetSpeed(_) | Command::SetPosition(_) | Command::SetMode(M::Speed | M::Position | M::SyncPosition)
    )
}

fn obey(drive: &mut Drive, command: Command, answer: &mut FrameBuilder) {
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
        Command::SetPwm(value) => drive.set_point(Mode::Pwm, value),
        Command::SetCurrent(value) => drive.set_point(Mode::Current, value),
        Command::SetSpeed(_) | Command::SetPosition(_) => {}
        Command::SetMaxCurrent(current) => drive.set_max_current(current),
        Command::SetMisc(bits) => {
            drive.synchronized |= bits & Command::SET_SYNCHRONIZED != 0;
            drive.synchronized &= bits & Command::RESET_SYNCHRONIZED == 0;
        }
        Command::SetCurrentRegulator(gains) => drive.set_current_gains(gains),
        Command::ReadPosition => _ = answer.answer(Answer::Position(drive.position())),
        Command::ReadCurrent => _ = answer.answer(Answer::Current(drive.current())),
        Command::ReadStatus => _ = answer.answer(Answer::Status(status(drive))),
    }
}

fn status(drive: &Drive) -> Status {
    let (feedback, faults) = (&drive.feedback, drive.faults());
    let bits = [
        (feedback.positive_limit, Status::UPPER_LIMIT),
        (feedback.negative_limit, Status::LOWER_LIMIT),
        (feedback.home_switch, Status::HOME_SWITCH),
        (drive.search == Search::Found, Status::INDEX),
        (drive.synchronized, Status::SYNCHRONIZED),
        (faults.over_current, Status::OVERCURRENT),
        (faults.power_stage, Status::POWER_STAGE_FAULT),
        (drive.mode == Mode::Error, Status::ERROR),
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
}

impl Stream {
    /// Takes a byte. The buffer has room after [`Stream::next`] has returned `None`.
    fn push(&mut self, byte: u8, now: Instant) {
        if self.count > 0 && now.since(self.last) > GAP {
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

    /// Drops bytes that cannot begin a frame. Returns the length of the first valid frame, if any.
    fn find(&mut self) -> Option<usize> {
        loop {
            let bytes = &self.bytes[..self.count];
            let start = bytes.iter().position(|&byte| byte == START);
            self.remove(start.unwrap_or(self.count));
            if self.count < 3 {
                return None;
            }
            match Frame::length(&self.bytes[..self.count]) {
                Some(length) if length > self.count => return None,
                Some(length) if Frame::parse(&self.bytes[..length]).is_some() => {
                    return Some(length);
                }
                _ => self.remove(1),
            }
        }
    }

    fn remove(&mut self, count: usize) {
        if count > 0 {
            self.bytes.copy_within(count..self.count, 0);
            self.count -= count;
        }
    }
}
