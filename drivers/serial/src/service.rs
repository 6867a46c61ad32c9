//! Client of maxon's service ports: reads and writes objects, and sends NMT commands, one request at a time.
//!
//! [`Client`] communicates with an EPOS2 on RS-232 or an EPOS4 on USB or RS-232, with bytes as input and output. Both
//! channels are half-duplex: nothing is sent before the answer has arrived or the time-out has passed. After an error,
//! the port waits for the frame time-out and drops the bytes that arrive. The request is then repeated, a given number
//! of times. A segmented transfer is repeated from its beginning. Every request ends, independent of the received
//! bytes, and even if no byte can be sent.
//!
//! An answer does not identify its request. A late answer is dropped if it arrives before the next request. After a
//! request that was repeated, the port waits for late answers as long as the successful attempt took. Values have four
//! bytes, independent of the length of the object. Only a segmented transfer reports the length. Segmented transfer
//! exists for EPOS4 only, because no layout of it is known for EPOS2. The codes of refusals are SDO abort codes and
//! codes of maxon.

#[cfg(test)]
mod tests;
mod wire;

use std::time::Duration;

use can::Instant;
use thiserror::Error;

use crate::epos4::{Address, Answer, LONGEST, MAX_SEGMENT, Request};
use crate::{Settings, epos2, epos4};
use wire::{Seen, Wire};

/// Factory setting of the frame time-out of both devices.
pub const TIME_OUT: Duration = epos4::TIME_OUT;

/// Device on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// An EPOS2 on RS-232: [`epos2`].
    Epos2,
    /// An EPOS4 on USB or RS-232: [`epos4`].
    Epos4,
}

/// Configuration of a client.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Device on the line.
    pub dialect: Dialect,
    /// Settings of the line, which give the transmission time of bytes.
    pub settings: Settings,
    /// Time to wait for an answer; at least the frame time-out of the device. The factory setting is [`TIME_OUT`].
    pub time_out: Duration,
    /// Number of repetitions of a request that failed on the line.
    pub retries: u8,
    /// Longest object of a segmented transfer, bytes.
    pub capacity: usize,
}

impl Config {
    /// Time-out of the factory setting, one repetition, and objects of up to 4096 bytes.
    pub const fn new(dialect: Dialect, settings: Settings) -> Self {
        Self { dialect, settings, time_out: TIME_OUT, retries: 1, capacity: 4096 }
    }
}

/// Code with which an EPOS4 refuses a damaged frame.
const CRC: u32 = 0x0504_0004;

/// Result of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply<'a> {
    /// The value read. Bytes beyond the length of the object are zero.
    Value(u32),
    /// The whole object.
    Object(&'a [u8]),
    /// The value was written, or the NMT command was accepted.
    Done,
}

/// Reason why a request did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum StartError {
    #[error("an earlier request is not over")]
    Busy,
    /// No source describes the segmented transfer of EPOS2.
    #[error("no transfer in segments with an EPOS2: only objects of up to 4 bytes")]
    NoSegments,
    #[error("{size} bytes are too many, at most {capacity} are transferred")]
    TooLarge { size: usize, capacity: usize },
}

/// Reason why a request failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum ServiceError {
    /// The device refused the request with the code of an SDO abort or a code of maxon, 0x0F00_FFxx.
    #[error("refused with code {0:#010x}")]
    Refused(u32),
    /// No answer, or an incomplete answer. `waited` counts from the start of the service, retries included.
    #[error("timed out after {waited:?}")]
    TimedOut { waited: Duration },
    /// An EPOS2 was not ready, or received damaged bytes.
    #[error("the device did not accept the request: it was busy, or heard it damaged")]
    NotAcknowledged,
    /// The CRC of the answer was wrong, or the answer was incomplete.
    #[error("the answer came damaged")]
    Damaged,
    #[error("the answer does not belong to the request")]
    Unexpected,
    #[error("the object has {size} bytes, at most {capacity} are transferred")]
    TooLarge { size: usize, capacity: usize },
}

/// Client of a service channel.
///
/// ```text
/// Idle --request--> Waiting --line quiet--> Exchanging --answer--> Finished --poll--> Idle
///                      ^                      |    ^ | answer: next segment
///                      +--error, retries left-+    +-+
/// ```
#[derive(Clone, Debug)]
pub struct Client {
    config: Config,
    wire: Wire,
    state: ExchangeState,
    /// The request that starts the operation.
    operation: Request<'static>,
    step: Step,
    /// Data to write in segments, or data read so far; never longer than the capacity.
    object: Vec<u8>,
    output: [u8; LONGEST],
    /// Number of output bytes that the line has accepted; the next field is the number of output bytes.
    taken: usize,
    filled: usize,
    /// Time of the request.
    started: Instant,
    /// Start of the first attempt.
    begun: Instant,
    /// Deadline of the awaited telegram.
    deadline: Instant,
    /// Time of the last known byte on the line.
    traffic: Instant,
    /// Time before which nothing is sent.
    quiet_until: Instant,
    retries_left: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ExchangeState {
    Idle,
    Waiting,
    Exchanging,
    Finished(Result<Brought, ServiceError>),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Brought {
    Value(u32),
    Object,
    Done,
}

/// Progress of a segmented transfer, of which the first `done` of `total` bytes were transferred.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Start,
    Segment { toggle: bool, done: usize, total: usize },
}

impl Client {
    /// An idle client. All memory is allocated here.
    pub fn new(config: Config) -> Self {
        Self {
            config,
            wire: Wire::new(config.dialect),
            state: ExchangeState::Idle,
            operation: Request::Nmt { node: 0, command: 0 },
            step: Step::Start,
            object: Vec::with_capacity(config.capacity),
            output: [0; _],
            taken: 0,
            filled: 0,
            started: Instant::ZERO,
            begun: Instant::ZERO,
            deadline: Instant::ZERO,
            traffic: Instant::ZERO,
            quiet_until: Instant::ZERO,
            retries_left: 0,
        }
    }

    /// Reads an object of up to four bytes: [`Reply::Value`].
    pub fn read(&mut self, address: Address, now: Instant) -> Result<(), StartError> {
        self.start(Request::Read(address), now)
    }

    /// Writes an object of up to four bytes, given by the low bytes of `value`: [`Reply::Done`].
    pub fn write(&mut self, address: Address, value: u32, now: Instant) -> Result<(), StartError> {
        self.start(Request::Write(address, value), now)
    }

    /// Reads a whole object in segments: [`Reply::Object`]. Only the device on the line can be addressed.
    pub fn read_segmented(&mut self, address: Address, now: Instant) -> Result<(), StartError> {
        self.check_segments(0)?;
        self.start(Request::InitiateSegmentedRead(address), now)
    }

    /// Writes a whole object in segments: [`Reply::Done`]. Only the device on the line can be addressed.
    pub fn write_segmented(&mut self, address: Address, data: &[u8], now: Instant) -> Result<(), StartError> {
        self.check_segments(data.len())?;
        self.check_idle()?;
        self.object.clear();
        self.object.extend_from_slice(data);
        let size = data.len() as u32;
        self.start(Request::InitiateSegmentedWrite(address, size), now)
    }

    /// Sends an NMT command specifier (CiA 301 §7.2.8.3.1) to a node, 0 for all nodes. [`Reply::Done`] means that the
    /// device on the line has accepted the command. The reply does not confirm that the nodes obey.
    pub fn nmt(&mut self, node: u8, command: u8, now: Instant) -> Result<(), StartError> {
        let (node, command) = (node.into(), command.into());
        self.start(Request::Nmt { node, command }, now)
    }

    fn check_segments(&self, size: usize) -> Result<(), StartError> {
        let capacity = self.config.capacity;
        match self.config.dialect {
            Dialect::Epos2 => Err(StartError::NoSegments),
            Dialect::Epos4 if size > capacity => Err(StartError::TooLarge { size, capacity }),
            Dialect::Epos4 => Ok(()),
        }
    }

    /// The last acknowledgement must also have been sent.
    fn check_idle(&self) -> Result<(), StartError> {
        let idle = self.state == ExchangeState::Idle && self.bytes().is_empty();
        if idle { Ok(()) } else { Err(StartError::Busy) }
    }

    fn start(&mut self, operation: Request<'static>, now: Instant) -> Result<(), StartError> {
        self.check_idle()?;
        self.operation = operation;
        self.state = ExchangeState::Waiting;
        self.retries_left = self.config.retries;
        self.started = now;
        self.handle_timeout(now);
        Ok(())
    }

    /// Bytes to send now.
    pub fn bytes(&self) -> &[u8] {
        &self.output[self.taken..self.filled]
    }

    /// Reports that the line has accepted `count` of [`bytes`](Client::bytes).
    pub fn consume(&mut self, count: usize, now: Instant) {
        let count = count.min(self.filled - self.taken);
        if count == 0 {
            return;
        }
        self.taken += count;
        self.traffic = self.traffic.max(now) + self.config.settings.line_time(count);
        if self.bytes().is_empty() {
            self.deadline = self.deadline.max(self.awaited());
        }
    }

    /// Time at which the awaited telegram is overdue.
    fn awaited(&self) -> Instant {
        let longest = match (self.config.dialect, self.operation) {
            (Dialect::Epos4, Request::InitiateSegmentedRead(_)) => LONGEST,
            _ => 2 * (4 + 8),
        };
        self.traffic + self.config.time_out + self.config.settings.line_time(longest)
    }

    /// Processes bytes that arrived by `now`. Bytes that are not awaited are discarded.
    pub fn handle(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            self.traffic = self.traffic.max(now);
            // The other side must not send while the client sends. Bytes that arrive then belong to an earlier
            // exchange.
            if self.state != ExchangeState::Exchanging || !self.bytes().is_empty() {
                continue;
            }
            match &mut self.wire {
                Wire::Epos2(exchange) => {
                    let seen = exchange.take(byte);
                    self.epos2(seen, now);
                }
                Wire::Epos4(deframer) => match deframer.take(byte) {
                    None => {}
                    Some(Ok(frame)) => self.epos4(&frame, now),
                    Some(Err(_)) => self.fail(ServiceError::Damaged, now),
                },
            }
        }
    }

    fn epos2(&mut self, seen: Seen, now: Instant) {
        match seen {
            Seen::Nothing => {}
            Seen::Ready(telegram) => self.say(telegram.body(), now),
            Seen::Offered => self.say(&[epos2::Acknowledge::Okay.byte()], now),
            Seen::Sent => self.advance(Answer::Done, now),
            Seen::Answer(answer) => {
                self.say(&[epos2::Acknowledge::Okay.byte()], now);
                self.advance(
                    match answer {
                        epos2::Answer::Value(value) => Answer::Value(value),
                        epos2::Answer::Done => Answer::Done,
                        epos2::Answer::Refused(code) => Answer::Refused(code),
                    },
                    now,
                );
            }
            Seen::Damaged => {
                self.say(&[epos2::Acknowledge::Failed.byte()], now);
                self.fail(ServiceError::Damaged, now);
            }
            Seen::Failed(error) => self.fail(error, now),
        }
    }

    fn epos4(&mut self, frame: &epos4::Frame, now: Instant) {
        match Answer::decode(frame, &self.request()) {
            Some(answer) => self.advance(answer, now),
            None => self.fail(ServiceError::Unexpected, now),
        }
    }

    /// Request of the present step.
    fn request(&self) -> Request<'_> {
        match (self.operation, self.step) {
            (first, Step::Start) => first,
            (Request::InitiateSegmentedWrite(..), Step::Segment { toggle, done, .. }) => {
                let data = &self.object[done..];
                let data = &data[..data.len().min(MAX_SEGMENT)];
                let last = done + data.len() == self.object.len();
                Request::SegmentWrite { toggle, last, data }
            }
            (_, Step::Segment { toggle, .. }) => Request::SegmentRead { toggle },
        }
    }

    /// Processes the answer to the present step.
    fn advance(&mut self, answer: Answer<'_>, now: Instant) {
        match (self.operation, self.step, answer) {
            // The device reports a frame that it received damaged.
            (_, _, Answer::Refused(CRC)) => self.fail(ServiceError::NotAcknowledged, now),
            (_, _, Answer::Refused(code)) => self.finish(Err(ServiceError::Refused(code)), now),
            (Request::Read(_), _, Answer::Value(value)) => {
                self.finish(Ok(Brought::Value(value)), now);
            }
            (Request::Write(..) | Request::Nmt { .. }, _, Answer::Done) => {
                self.finish(Ok(Brought::Done), now);
            }
            (Request::InitiateSegmentedRead(_), Step::Start, Answer::Started(total, data)) => {
                let (size, capacity) = (total as usize, self.config.capacity);
                if size > capacity {
                    let error = ServiceError::TooLarge { size, capacity };
                    self.finish(Err(error), now);
                } else {
                    self.append(data, size, false, false, now);
                }
            }
            (
                Request::InitiateSegmentedRead(_),
                Step::Segment { toggle, total, .. },
                Answer::Segment { toggle: of, last, data },
            ) if of == toggle && (last || !data.is_empty()) => {
                self.append(data, total, !toggle, last, now);
            }
            (Request::InitiateSegmentedWrite(..), Step::Start, Answer::Done) => {
                self.step = Step::Segment { toggle: false, done: 0, total: self.object.len() };
                self.ask(now);
            }
            (
                Request::InitiateSegmentedWrite(..),
                Step::Segment { toggle, done, total },
                Answer::Taken { toggle: of, length },
            ) if of == toggle && usize::from(length) == (total - done).min(MAX_SEGMENT) => {
                let done = done + usize::from(length);
                if done == total {
                    self.finish(Ok(Brought::Done), now);
                } else {
                    let toggle = !toggle;
                    self.step = Step::Segment { toggle, done, total };
                    self.ask(now);
                }
            }
            _ => self.fail(ServiceError::Unexpected, now),
        }
    }

    /// Appends a segment of an object of `total` bytes. `toggle` is the toggle bit of the next segment.
    fn append(&mut self, data: &[u8], total: usize, toggle: bool, last: bool, now: Instant) {
        let done = self.object.len() + data.len();
        if done > total || last && done < total {
            return self.fail(ServiceError::Unexpected, now);
        }
        self.object.extend_from_slice(data);
        if done == total {
            return self.finish(Ok(Brought::Object), now);
        }
        self.step = Step::Segment { toggle, done, total };
        self.ask(now);
    }

    /// Starts the request, or repeats it, on a quiet line.
    fn begin(&mut self, now: Instant) {
        self.state = ExchangeState::Exchanging;
        self.step = Step::Start;
        if self.retries_left == self.config.retries {
            self.begun = now;
        }
        if matches!(self.operation, Request::InitiateSegmentedRead(_)) {
            self.object.clear();
        }
        self.ask(now);
    }

    /// Sends the request of the present step.
    fn ask(&mut self, now: Instant) {
        let request = self.request();
        match self.config.dialect {
            Dialect::Epos2 => {
                let telegram = match request {
                    Request::Read(address) => epos2::Request::Read(address),
                    Request::Write(address, value) => epos2::Request::Write(address, value),
                    Request::Nmt { node, command } => epos2::Request::Nmt { node, command },
                    Request::InitiateSegmentedRead(_)
                    | Request::SegmentRead { .. }
                    | Request::InitiateSegmentedWrite(..)
                    | Request::SegmentWrite { .. } => {
                        unreachable!("a transfer in segments is not started with an EPOS2")
                    }
                };
                let opcode = telegram.encode().opcode();
                self.wire = Wire::Epos2(wire::Exchange::new(telegram));
                self.say(&[opcode], now);
            }
            Dialect::Epos4 => {
                let frame = request.encode();
                self.wire = Wire::new(Dialect::Epos4);
                self.filled = frame.encode(&mut self.output);
                self.taken = 0;
                self.deadline = now + self.config.time_out;
            }
        }
    }

    fn say(&mut self, bytes: &[u8], now: Instant) {
        self.output[..bytes.len()].copy_from_slice(bytes);
        (self.taken, self.filled) = (0, bytes.len());
        self.deadline = now + self.config.time_out;
    }

    /// Handles an error on the line: waits until the line is quiet and repeats the request, unless no retries are left.
    fn fail(&mut self, error: ServiceError, now: Instant) {
        self.quiet_until = self.traffic + self.config.time_out;
        if self.retries_left > 0 {
            self.retries_left -= 1;
            self.state = ExchangeState::Waiting;
        } else {
            self.finish(Err(error), now);
        }
    }

    fn finish(&mut self, result: Result<Brought, ServiceError>, now: Instant) {
        // The answer to an earlier attempt may still arrive, within the time that the successful attempt took.
        let resent = self.retries_left < self.config.retries;
        if resent || matches!(result, Err(ServiceError::TimedOut { .. })) {
            let longest = self.config.time_out * 2 * (u32::from(self.config.retries) + 1);
            let as_long = now.since(self.begun).min(longest);
            self.quiet_until = self.quiet_until.max(now + as_long);
        }
        self.state = ExchangeState::Finished(result);
    }

    /// Time at which [`handle_timeout`](Client::handle_timeout) is due; `None` if the client is idle.
    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.state {
            ExchangeState::Idle | ExchangeState::Finished(_) => None,
            ExchangeState::Waiting => Some(self.quiet_until),
            ExchangeState::Exchanging => Some(self.deadline),
        }
    }

    /// Processes deadlines that have passed at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        match self.state {
            ExchangeState::Waiting if now >= self.quiet_until => self.begin(now),
            ExchangeState::Exchanging if now >= self.deadline => {
                // Bytes that the line did not accept by the deadline are discarded.
                self.taken = self.filled;
                let waited = now.since(self.started);
                self.fail(ServiceError::TimedOut { waited }, now);
            }
            ExchangeState::Idle | ExchangeState::Waiting | ExchangeState::Exchanging | ExchangeState::Finished(_) => {}
        }
    }

    /// Result of the request, returned once.
    pub fn poll(&mut self) -> Option<Result<Reply<'_>, ServiceError>> {
        let ExchangeState::Finished(result) = self.state else {
            return None;
        };
        self.state = ExchangeState::Idle;
        Some(result.map(|brought| match brought {
            Brought::Value(value) => Reply::Value(value),
            Brought::Object => Reply::Object(&self.object),
            Brought::Done => Reply::Done,
        }))
    }
}
