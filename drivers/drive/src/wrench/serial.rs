//! A force/torque sensor on a serial line of its own, which answers queries.

use std::task::Poll;

use can::{Counters, Instant};
use serial::Line;
use serial::ati::{REPLY, REQUEST, Reply, Request};

use super::config::{ConfigError, SerialWrenchConfig};
use super::fault::WrenchFault;
use super::rate::Pace;
use super::sampler::{Sampler, WrenchCounters};
use super::serial_bring_up::BringUp;
use super::state::WrenchLink;
use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};

/// Greatest length of one reading, bytes: the size of Linux's tty buffer. One reading therefore empties the buffer.
const READING: usize = 4_096;

/// A force/torque sensor on a serial line, as a [`DriveGroup`] without axes.
///
/// A cycle makes two system calls: a read and a write. After a missing answer, no query is written. Instead, the second
/// call discards a query that a stalled line has not yet sent.
pub struct SerialWrenchSensor<L: Line> {
    line: L,
    config: SerialWrenchConfig,
    sampler: Sampler,
    bring_up: Option<BringUp>,
    exchange: Exchange,
    order: AnswerOrder,
    buffer: Box<[u8; READING]>,
    counters: GroupCounters,
    /// Number of the cycle, from 0 at the end of bring-up.
    cycle: u64,
}

/// State of the exchange with the sensor. An answer carries no number, so there is never more than one query under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Exchange {
    /// No answer is due, and the next request may be sent.
    Idle,
    /// The query was sent. `arrives`: arrival time of the query at the sensor.
    Queried { arrives: Instant },
    /// The answer was missing or damaged, and `heard` of its bytes have been received. The next query waits for the
    /// rest of the answer, or for a reading without bytes. Otherwise a late answer could be taken for the answer to the
    /// next query. The sensor also loses a query that arrives while the sensor sends.
    Draining { heard: usize },
}

/// Whether each answer belongs to the last query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AnswerOrder {
    /// Each answer belongs to the last query: two answers came in consecutive cycles, and no answer timed out since.
    Known,
    /// An answer timed out, and may still come in place of the next answer.
    Unknown,
    /// The next answer has come. If this was the answer that timed out, the following reading has no whole answer.
    Unconfirmed,
}

impl<L: Line> SerialWrenchSensor<L> {
    /// A sensor that has received nothing yet, and the controller's end of it.
    pub fn new(line: L, config: SerialWrenchConfig) -> Result<(Self, WrenchLink), ConfigError> {
        config.check()?;
        let pace = Pace::Requested { every: 1, period: config.period };
        let (sampler, link) = Sampler::new(&config.sensor, pace);
        let sensor = Self {
            line,
            config,
            sampler,
            bring_up: None,
            exchange: Exchange::Idle,
            order: AnswerOrder::Known,
            buffer: Box::new([0; READING]),
            counters: GroupCounters::default(),
            cycle: 0,
        };
        Ok((sensor, link))
    }

    /// Counters since bring-up.
    pub fn sensor_counters(&self) -> WrenchCounters {
        self.sampler.counters
    }

    /// Takes the bytes of one reading.
    fn take(&mut self, count: usize) {
        let sampler = &mut self.sampler;
        let reply = <[u8; REPLY]>::try_from(&self.buffer[..count]);
        let expected = match self.exchange {
            Exchange::Queried { .. } => reply.is_ok(),
            Exchange::Idle | Exchange::Draining { .. } => count == 0,
        };
        if self.order == AnswerOrder::Unconfirmed && !expected {
            sampler.withdraw();
            self.order = AnswerOrder::Unknown;
        }
        self.exchange = match (self.exchange, reply) {
            (Exchange::Queried { arrives }, Ok(reply)) => {
                sampler.take(Reply::decode(reply).counts.map(i32::from), arrives);
                self.order = match self.order {
                    AnswerOrder::Unknown => {
                        sampler.doubt();
                        AnswerOrder::Unconfirmed
                    }
                    AnswerOrder::Known | AnswerOrder::Unconfirmed => AnswerOrder::Known,
                };
                Exchange::Idle
            }
            (Exchange::Queried { .. }, Err(_)) => {
                if count == 0 {
                    sampler.counters.missing += 1;
                } else {
                    sampler.garbage();
                }
                Exchange::Draining { heard: count }
            }
            (Exchange::Idle, _) if count == 0 => Exchange::Idle,
            (Exchange::Draining { .. }, _) if count == 0 => {
                self.order = AnswerOrder::Unknown;
                Exchange::Idle
            }
            (Exchange::Draining { heard }, _) if heard + count == REPLY => {
                sampler.late();
                Exchange::Idle
            }
            (Exchange::Draining { heard }, _) => {
                sampler.garbage();
                Exchange::Draining { heard: heard + count }
            }
            // No answer is due.
            (Exchange::Idle, _) => {
                sampler.garbage();
                Exchange::Draining { heard: REPLY }
            }
        };
    }

    /// Sends one request. Returns whether the line took it.
    fn request(&mut self, request: Request, now: Instant) -> bool {
        let taken = match self.line.write(now, &request.encode()) {
            Ok(count) => count > 0,
            Err(error) => {
                self.sampler.latch(WrenchFault::Line(error));
                false
            }
        };
        let port = &mut self.counters.port;
        if taken {
            port.sent += 1;
        } else {
            port.refused += 1;
        }
        taken
    }
}

impl<L: Line> DriveGroup for SerialWrenchSensor<L> {
    /// A sensor has no axes.
    fn axes(&self) -> usize {
        0
    }

    /// A sensor takes no set-points.
    fn delay(&self) -> usize {
        0
    }

    /// A call after success or after an error begins a new bring-up. The zero of the host is cleared.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        let sampler = &mut self.sampler;
        let bring_up = self.bring_up.get_or_insert_with(|| {
            sampler.reset();
            BringUp::new(&self.config, now)
        });
        let result = bring_up.advance(&mut self.line, &mut self.buffer[..], sampler, now);
        match result {
            Ok(false) => return Poll::Pending,
            Ok(true) => {
                sampler.begin(now);
                (self.exchange, self.order, self.cycle) = (Exchange::Idle, AnswerOrder::Known, 0);
            }
            Err(_) => {}
        }
        self.bring_up = None;
        Poll::Ready(result.map(|_| ()).map_err(|error| BringUpError::WrenchLine { error }))
    }

    fn read(&mut self, now: Instant, _states: &mut [AxisState]) {
        self.sampler.begin_of_read();
        if self.exchange != Exchange::Idle {
            self.sampler.requested();
        }
        match self.line.read(now, &mut self.buffer[..]) {
            Ok(count) => self.take(count),
            Err(error) => {
                self.sampler.latch(WrenchFault::Line(error));
                self.exchange = Exchange::Draining { heard: 0 };
            }
        }
        self.sampler.end_of_read(now, self.cycle);
        self.cycle += 1;
    }

    fn write(&mut self, _now: Instant, _commands: &[AxisCommand]) {}

    /// Sends one query, or the bias command of a requested zero. There is no set-point to refuse.
    fn send(&mut self, now: Instant) -> bool {
        match self.exchange {
            Exchange::Draining { .. } => self.line.discard_unsent(),
            // The answer to the last query was not read yet.
            Exchange::Queried { .. } => {}
            Exchange::Idle if self.sampler.bias_is_due() => {
                if self.request(Request::Bias, now) {
                    self.sampler.biased();
                }
            }
            Exchange::Idle => {
                if self.request(Request::Query, now) {
                    let arrives = now + self.config.settings.line_time(REQUEST);
                    self.exchange = Exchange::Queried { arrives };
                }
            }
        }
        true
    }

    /// The counters of the port count requests and answers. `errors` counts late answers and readings that were no
    /// answer. A tty gives no receive times, so there is no bus time.
    fn counters(&self) -> GroupCounters {
        let WrenchCounters { samples, missing, garbage, late, saturated, .. } = self.sampler.counters;
        let line = self.line.counters();
        let mut counters = self.counters;
        counters.missed_answers = missing;
        counters.unexpected = garbage + late;
        counters.port = Counters {
            received: samples + saturated,
            dropped: line.dropped,
            errors: garbage + late,
            bits: self.config.settings.bits_per_byte() * (line.sent + line.received),
            ..counters.port
        };
        counters
    }
}

impl<L: Line> Drop for SerialWrenchSensor<L> {
    /// Latches [`WrenchFault::Ended`]: the last wrench is no longer valid.
    fn drop(&mut self) {
        self.sampler.end();
    }
}
