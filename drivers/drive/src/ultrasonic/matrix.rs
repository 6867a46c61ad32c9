//! An ultrasonic matrix on a serial line of its own.

use std::task::Poll;

use can::{Counters, Instant};
use serial::Line;
use serial::ultrasonic::{Element, NO_ECHO, Reply, Request};

use super::bring_up::BringUp;
use super::config::{UltrasonicConfig, UltrasonicConfigError};
use super::fault::UltrasonicFault;
use super::receiver::Receiver;
use super::state::{MOST_ECHOES, Requests, Scan, StatePublisher, UltrasonicLink, UltrasonicState};
use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};

/// Greatest length of one reading, bytes: the size of Linux's tty buffer. One reading therefore empties the buffer.
const READING: usize = 4_096;

/// Counters of a matrix since bring-up. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UltrasonicCounters {
    /// Complete scans.
    pub scans: u64,
    /// Valid replies.
    pub replies: u64,
    /// Queries without a valid reply.
    pub missing: u64,
    /// Bytes that belonged to no valid reply, and replies to no query.
    pub garbage: u64,
}

/// An ultrasonic matrix on a serial line, as a [`DriveGroup`] without axes.
///
/// A cycle reads once, and writes a query if the last one has ended. After a query without a reply, a cycle discards
/// unsent bytes instead.
pub struct UltrasonicMatrix<L: Line> {
    line: L,
    config: UltrasonicConfig,
    bring_up: Option<BringUp>,
    exchange: Exchange,
    receiver: Receiver,
    /// The scan in progress, and the number of its next query.
    scan: Scan,
    next: usize,
    /// Queries without a valid reply in a row, and readings among them that were no valid reply.
    missing: u32,
    garbage: u32,
    /// A reset was requested. The latched fault remains until the next complete scan.
    resetting: bool,
    state: UltrasonicState,
    publisher: StatePublisher,
    requests: Requests,
    counters: GroupCounters,
    own_counters: UltrasonicCounters,
    buffer: Box<[u8; READING]>,
}

/// State of the exchange with the matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Exchange {
    /// No reply is due, and the next query may be sent.
    Idle,
    /// The query was sent at `at`.
    Queried { query: Request, at: Instant },
    /// The last query has ended without its reply. The next query waits for a reading without bytes, since this time.
    Draining { since: Instant },
}

impl<L: Line> UltrasonicMatrix<L> {
    /// A matrix that has received nothing yet, and the controller's end of it.
    pub fn new(line: L, config: UltrasonicConfig) -> Result<(Self, UltrasonicLink), UltrasonicConfigError> {
        config.check()?;
        let (publisher, requests, link) = UltrasonicLink::new();
        let matrix = Self {
            line,
            config,
            bring_up: None,
            exchange: Exchange::Idle,
            receiver: Receiver::new(),
            scan: Scan::NONE,
            next: 0,
            missing: 0,
            garbage: 0,
            resetting: false,
            state: UltrasonicState::NOT_STARTED,
            publisher,
            requests,
            counters: GroupCounters::default(),
            own_counters: UltrasonicCounters::default(),
            buffer: Box::new([0; READING]),
        };
        Ok((matrix, link))
    }

    /// Counters since bring-up.
    pub fn sensor_counters(&self) -> UltrasonicCounters {
        self.own_counters
    }

    /// Begins operation or ends it, with a scan from its first query.
    fn restart(&mut self, state: UltrasonicState) {
        self.state = state;
        (self.exchange, self.receiver) = (Exchange::Idle, Receiver::new());
        (self.scan, self.next) = (Scan::NONE, 0);
        (self.missing, self.garbage, self.resetting) = (0, 0, false);
        self.own_counters = UltrasonicCounters::default();
        self.publisher.publish(&self.state.words());
    }

    fn latch(&mut self, fault: UltrasonicFault) {
        if std::mem::take(&mut self.resetting) {
            self.state.fault = None;
        }
        self.state.fault.get_or_insert(fault);
    }

    /// Takes the bytes of one reading.
    fn take(&mut self, count: usize, now: Instant) {
        if count == 0 && matches!(self.exchange, Exchange::Draining { .. }) {
            self.receiver.restart();
            self.exchange = Exchange::Idle;
            return;
        }
        let slot = self.config.slot_on_wire();
        // No echo is received after the firing slot.
        let within_slot = |time: u16| time == NO_ECHO || time <= slot;
        let skipped = self.receiver.skipped;
        let mut strange = false;
        for index in 0..count {
            let byte = self.buffer[index];
            let Some(body) = self.receiver.receive(byte) else {
                continue;
            };
            let reply = Reply::decode(body);
            let taken = match (self.exchange, reply) {
                (Exchange::Queried { query: Request::Row(asked), at }, Some(Reply::Row { row, times })) => {
                    let whole = times.iter().count() == usize::from(self.config.size);
                    let fits = row == asked && whole && times.iter().all(within_slot);
                    if fits {
                        let shot = usize::from(row);
                        self.scan.shots[shot] = at;
                        self.scan.times[shot].iter_mut().zip(times.iter()).for_each(|(place, time)| *place = time);
                    }
                    fits
                }
                (
                    Exchange::Queried { query: query @ Request::Pair { .. }, at },
                    Some(Reply::Pair { emitter, receiver, time }),
                ) => {
                    let fits = query == Request::Pair { emitter, receiver } && within_slot(time);
                    if fits {
                        let number = |(row, column): Element| usize::from(row * self.config.size + column);
                        let (shot, echo) = (number(emitter), number(receiver) % MOST_ECHOES);
                        if echo == 0 {
                            self.scan.shots[shot] = at;
                        }
                        self.scan.times[shot][echo] = time;
                    }
                    fits
                }
                (Exchange::Queried { .. }, Some(Reply::Refusal { command, reason })) => {
                    self.latch(UltrasonicFault::refused(command, reason));
                    // The query has ended. Its echoes are missing.
                    self.finish(now, false);
                    continue;
                }
                _ => false,
            };
            if taken {
                self.finish(now, true);
            } else {
                strange = true;
                self.own_counters.garbage += 1;
            }
        }
        let bytes = self.receiver.skipped.wrapping_sub(skipped);
        if strange || bytes > 0 {
            self.garbage = self.garbage.saturating_add(1);
            self.own_counters.garbage += u64::from(bytes);
        }
    }

    /// Ends the query in progress and goes on to the next.
    fn finish(&mut self, now: Instant, replied: bool) {
        self.exchange = Exchange::Idle;
        if replied {
            self.own_counters.replies += 1;
            (self.missing, self.garbage) = (0, 0);
        } else {
            self.own_counters.missing += 1;
            self.missing = self.missing.saturating_add(1);
        }
        self.next += 1;
        if self.next < self.config.queries() {
            return;
        }
        // A scan without any reply is not published.
        if self.missing < self.config.queries() as u32 {
            self.own_counters.scans += 1;
            if std::mem::take(&mut self.resetting) {
                self.state.fault = None;
            }
            if self.state.fault.is_none() {
                self.state.scan = Scan { number: self.state.scan.number + 1, ended: now, ..self.scan };
            }
        }
        (self.scan, self.next) = (Scan::NONE, 0);
    }

    /// Ends a query without a reply in its time. A line that does not become quiet delays the next query, which then
    /// counts as missing too.
    fn judge(&mut self, now: Instant) {
        let (query, since) = match self.exchange {
            Exchange::Idle => return,
            Exchange::Queried { query, at } => (query, at),
            Exchange::Draining { since } => (self.config.query(self.next), since),
        };
        if now.since(since) <= self.config.answer_timeout(query) {
            return;
        }
        if self.receiver.is_within() {
            self.receiver.restart();
            self.garbage = self.garbage.saturating_add(1);
        }
        self.finish(now, false);
        self.exchange = Exchange::Draining { since: now };
        if self.missing > self.config.tolerated_missing {
            self.latch(match self.garbage {
                0 => UltrasonicFault::Silent { queries: self.missing },
                readings => UltrasonicFault::Garbage { readings },
            });
        }
    }
}

impl<L: Line> DriveGroup for UltrasonicMatrix<L> {
    /// A matrix has no axes.
    fn axes(&self) -> usize {
        0
    }

    /// A matrix takes no set-points.
    fn delay(&self) -> usize {
        0
    }

    /// A call after success or after an error begins a new bring-up.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        if self.bring_up.is_none() {
            self.restart(UltrasonicState::NOT_STARTED);
            self.bring_up = Some(BringUp::new(&self.config, now));
        }
        let Some(bring_up) = &mut self.bring_up else { return Poll::Pending };
        let result = bring_up.advance(&mut self.line, &mut self.buffer[..], now);
        match result {
            Ok(false) => return Poll::Pending,
            Ok(true) => {
                self.requests.take_reset();
                self.restart(UltrasonicState { at: now, fault: None, ..UltrasonicState::NOT_STARTED });
            }
            Err(_) => {}
        }
        self.bring_up = None;
        Poll::Ready(result.map(|_| ()).map_err(|error| BringUpError::Ultrasonic { error }))
    }

    fn read(&mut self, now: Instant, _states: &mut [AxisState]) {
        if self.requests.take_reset() && self.state.fault.is_some() {
            // The scan that ends the fault begins after the request.
            (self.scan, self.next, self.resetting) = (Scan::NONE, 0, true);
            if matches!(self.exchange, Exchange::Queried { .. }) {
                // The reply to a query before the request is dropped.
                self.exchange = Exchange::Draining { since: now };
            }
            (self.missing, self.garbage) = (0, 0);
        }
        match self.line.read(now, &mut self.buffer[..]) {
            Ok(count) => self.take(count, now),
            Err(error) => self.latch(UltrasonicFault::Line(error)),
        }
        self.judge(now);
        self.state.at = now;
        self.publisher.publish(&self.state.words());
        self.state.cycle += 1;
    }

    fn write(&mut self, _now: Instant, _commands: &[AxisCommand]) {}

    /// Sends the next query. There is no set-point to refuse.
    fn send(&mut self, now: Instant) -> bool {
        match self.exchange {
            Exchange::Idle => {}
            Exchange::Queried { .. } => return true,
            // A stalled line may still hold the last query.
            Exchange::Draining { .. } => {
                self.line.discard_unsent();
                return true;
            }
        }
        let query = self.config.query(self.next);
        let (frame, length) = query.encode();
        let taken = match self.line.write(now, &frame[..length]) {
            Ok(count) => count == length,
            Err(error) => {
                self.latch(UltrasonicFault::Line(error));
                false
            }
        };
        let port = &mut self.counters.port;
        if taken {
            port.sent += 1;
        } else {
            port.refused += 1;
        }
        // A query that the line did not take whole ends like a query without a reply.
        self.exchange = Exchange::Queried { query, at: now + self.config.settings.line_time(length) };
        true
    }

    /// The counters of the port count queries and replies. A tty gives no receive times, so there is no bus time.
    fn counters(&self) -> GroupCounters {
        let own = self.own_counters;
        let line = self.line.counters();
        let mut counters = self.counters;
        counters.missed_answers = own.missing;
        counters.unexpected = own.garbage;
        counters.port = Counters {
            received: own.replies,
            dropped: line.dropped,
            errors: own.garbage,
            bits: self.config.settings.bits_per_byte() * (line.sent + line.received),
            ..counters.port
        };
        counters
    }
}

impl<L: Line> Drop for UltrasonicMatrix<L> {
    /// Latches [`UltrasonicFault::Ended`]: the last scan is no longer valid.
    fn drop(&mut self) {
        self.latch(UltrasonicFault::Ended);
        self.publisher.publish(&self.state.words());
    }
}
