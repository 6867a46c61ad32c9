//! The drive group of a device of another crate on a serial line of its own.

use std::task::Poll;
use std::time::Duration;

use can::{Counters, Instant};
use serial::Line;
use thiserror::Error;

use super::driver::{LineConfig, LineDriver, MOST_QUERY, Reception};
use super::fault::{DeviceError, DeviceFault};
use super::state::{DeviceLink, DeviceSample, DeviceSamples, DeviceState, DriverEnds, ends};
use super::value::{DeviceValue, MOST_VALUES, count_of, names_of};
use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};

/// Greatest length of one reading, bytes: the size of Linux's tty buffer. One reading therefore empties the buffer.
const READING: usize = 4_096;

/// Configuration of a device and of its line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceConfig {
    /// Period of the servo cycle.
    pub period: Duration,
    /// The line and its telegrams.
    pub line: LineConfig,
    /// The values of a sample.
    pub values: &'static [DeviceValue],
    /// Number of samples in a row that may be missing. One more is a fault.
    pub tolerated_missing: u32,
    /// Time limit of bring-up, from its start to the first sample.
    pub boot_timeout: Duration,
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DeviceConfigError {
    #[error("a sample of {count} numbers, must be 1 to {MOST_VALUES}")]
    Values { count: usize },
    #[error("the value {name:?}, must have letters, digits and _ alone, and another name than the values before")]
    Name { name: &'static str },
    #[error("numbers of {first:?} and {second:?} with the same name, as several numbers of a value end in their index")]
    Number { first: &'static str, second: &'static str },
    #[error("the range {low} to {high} of {name}, must be two finite numbers in ascending order")]
    Range { name: &'static str, low: f64, high: f64 },
    #[error("{baud} bit/s, must be 300 to 4000000")]
    Baud { baud: u32 },
    #[error("a query of {query} bytes, must be at most {MOST_QUERY}")]
    Query { query: usize },
    #[error("an answer of {answer} bytes, must be 1 to {READING}")]
    Answer { answer: usize },
    #[error("an interval of {interval:?}, must be at most 60 s, and above 0 for a device that sends by itself")]
    Interval { interval: Duration },
    #[error("an answer takes {answer:.1?} on the line, and the interval is {interval:?}")]
    Busy { answer: Duration, interval: Duration },
    #[error("an answer after {delay:?}, must be at most 60 s")]
    AnswerDelay { delay: Duration },
}

impl DeviceConfig {
    /// Checks the numbers.
    pub fn check(&self) -> Result<(), DeviceConfigError> {
        const LONGEST: Duration = Duration::from_secs(60);
        let count = count_of(self.values);
        if !(1..=MOST_VALUES).contains(&count) || self.values.iter().any(|value| value.count == 0) {
            return Err(DeviceConfigError::Values { count });
        }
        for (number, DeviceValue { name, range: [low, high], .. }) in self.values.iter().enumerate() {
            let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !name.is_empty();
            if !plain || self.values[..number].iter().any(|it| it.name == *name) {
                return Err(DeviceConfigError::Name { name });
            }
            if !(low.is_finite() && high.is_finite() && low < high) {
                return Err(DeviceConfigError::Range { name, low: *low, high: *high });
            }
        }
        let numbers: Vec<_> = names_of(self.values).collect();
        for (index, (name, second)) in numbers.iter().enumerate() {
            if let Some((_, first)) = numbers[..index].iter().find(|(other, _)| other == name) {
                return Err(DeviceConfigError::Number { first: first.name, second: second.name });
            }
        }
        let LineConfig { settings, query, answer, interval, answer_delay: delay, .. } = self.line;
        if !(300..=4_000_000).contains(&settings.baud) {
            return Err(DeviceConfigError::Baud { baud: settings.baud });
        }
        if query > MOST_QUERY {
            return Err(DeviceConfigError::Query { query });
        }
        if !(1..=READING).contains(&answer) {
            return Err(DeviceConfigError::Answer { answer });
        }
        if interval > LONGEST || (self.line.is_streamed() && interval.is_zero()) {
            return Err(DeviceConfigError::Interval { interval });
        }
        let on_line = settings.line_time(answer);
        if self.line.is_streamed() && on_line > interval {
            return Err(DeviceConfigError::Busy { answer: on_line, interval });
        }
        if delay > LONGEST {
            return Err(DeviceConfigError::AnswerDelay { delay });
        }
        Ok(())
    }
}

/// Counters of a device since bring-up. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceCounters {
    /// Valid samples.
    pub samples: u64,
    /// Samples that were due and missing.
    pub missing: u64,
    /// Invalid answers, skipped bytes and answers to no query.
    pub garbage: u64,
}

/// A device of another crate on a serial line, as a [`DriveGroup`] without axes.
pub struct DeviceOnLine<L: Line, D: LineDriver> {
    line: L,
    driver: D,
    config: DeviceConfig,
    count: usize,
    /// Begin of the bring-up under way, and bytes since then.
    bring_up: Option<(Instant, u32)>,
    exchange: Exchange,
    /// Interval of the queries, a whole number of periods.
    every: Duration,
    /// Time of the last query.
    asked: Option<Instant>,
    /// Times of the last reading and of the reading before.
    last_read: Instant,
    read_before: Instant,
    /// A sample of a device that sends by itself is dropped if its measurement may be older.
    fresh_from: Instant,
    /// Numbers of the answer under way.
    values: [f64; MOST_VALUES],
    /// Whether an answer has begun and not ended.
    is_within: bool,
    /// Missing samples in a row, and readings without a valid answer since the last sample.
    missing: u32,
    garbage: u32,
    /// A reset was requested. The latched fault remains until the next valid sample.
    resetting: bool,
    /// The code of a refusal in the last reading.
    refusal: Option<u8>,
    state: DeviceState,
    ends: DriverEnds,
    counters: GroupCounters,
    own_counters: DeviceCounters,
    buffer: Box<[u8; READING]>,
}

/// The numbers of an answer before its first byte: not measured.
fn blank(count: usize) -> [f64; MOST_VALUES] {
    let mut values = [0.0; MOST_VALUES];
    values.iter_mut().take(count).for_each(|number| *number = f64::NAN);
    values
}

/// State of the exchange with a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Exchange {
    /// No answer is due, and the next query may be sent from this time on. Counts the readings in this state.
    Idle { from: Instant, readings: u32 },
    /// A sample is due: the query was sent at `at`, or the sample before of a device that sends by itself was received
    /// or missing at `at`.
    Due { at: Instant },
    /// The last query ended without an answer at `since`. The line has been quiet from `quiet` on. The next query waits
    /// until this time is long enough.
    Draining { since: Instant, quiet: Instant },
}

/// A drive group, its link to the controller, and its samples for the files of a run.
pub type OpenedDevice<G> = (G, DeviceLink, DeviceSamples);

impl<L: Line, D: LineDriver> DeviceOnLine<L, D> {
    /// A device that has received nothing yet, with its link and its samples.
    pub fn new(line: L, driver: D, config: DeviceConfig) -> Result<OpenedDevice<Self>, DeviceConfigError> {
        config.check()?;
        let count = count_of(config.values);
        let (ends, link, samples) = ends(count);
        let device = Self {
            line,
            driver,
            config,
            count,
            bring_up: None,
            exchange: Exchange::Idle { from: Instant::ZERO, readings: 0 },
            every: config.line.query_interval(config.period),
            asked: None,
            last_read: Instant::ZERO,
            read_before: Instant::ZERO,
            fresh_from: Instant::ZERO,
            values: blank(count),
            is_within: false,
            missing: 0,
            garbage: 0,
            resetting: false,
            refusal: None,
            state: DeviceState::NOT_STARTED,
            ends,
            counters: GroupCounters::default(),
            own_counters: DeviceCounters::default(),
            buffer: Box::new([0; READING]),
        };
        Ok((device, link, samples))
    }

    /// Counters since bring-up.
    pub fn device_counters(&self) -> DeviceCounters {
        self.own_counters
    }

    fn latch(&mut self, fault: DeviceFault) {
        if std::mem::take(&mut self.resetting) {
            self.state.fault = None;
        }
        if self.state.fault.is_none() {
            self.state.fault = Some(fault);
            self.ends.hand_over(self.state.at, None);
        }
    }

    /// Begins to wait: for the next sample of a device that sends by itself, and otherwise for a quiet line.
    fn listen(&mut self, now: Instant) {
        let streamed = self.config.line.is_streamed();
        let draining = Exchange::Draining { since: now, quiet: now };
        self.exchange = if streamed { Exchange::Due { at: now } } else { draining };
    }

    /// Ends an exchange. The next query waits for its interval, and is not sent before `earliest`. A cycle may begin
    /// early by half a period.
    fn rest(&self, earliest: Instant) -> Exchange {
        let due = self.asked.map(|asked| asked + self.every - self.config.period / 2);
        Exchange::Idle { from: due.map_or(earliest, |due| due.max(earliest)), readings: 0 }
    }

    /// The exchange after an answer. Without a number of the query, a repeated answer could be taken for the next one:
    /// one reading without bytes comes before the next query.
    fn after_answer(&self, now: Instant) -> Exchange {
        let LineConfig { is_numbered, .. } = self.config.line;
        match self.config.line.is_streamed() {
            true => Exchange::Due { at: now },
            false if is_numbered => self.rest(now),
            false => self.rest(now + self.config.period / 2),
        }
    }

    /// Earliest time of the first byte of an answer of a device that sends by itself, if the answer ends in the last
    /// reading. The reading before emptied the buffer of the tty.
    fn sent_from(&self) -> Instant {
        let LineConfig { settings, answer, .. } = self.config.line;
        self.read_before - settings.line_time(answer)
    }

    fn forget_answer(&mut self) {
        self.driver.restart();
        self.end_answer();
    }

    fn end_answer(&mut self) {
        self.is_within = false;
        self.values = blank(self.count);
    }

    /// Reads once. Returns the number of bytes.
    fn fetch(&mut self, now: Instant) -> Result<usize, serial::LineError> {
        let count = self.line.read(now, &mut self.buffer[..])?;
        self.read_before = std::mem::replace(&mut self.last_read, now);
        Ok(count)
    }

    /// Takes the bytes of one reading.
    fn take(&mut self, count: usize, now: Instant) {
        match &mut self.exchange {
            Exchange::Idle { from, readings } => {
                *readings = readings.saturating_add(1);
                if count > 0 && !self.config.line.is_numbered {
                    *from = (*from).max(now + self.config.period / 2);
                }
            }
            Exchange::Due { .. } => {}
            Exchange::Draining { quiet, .. } if count > 0 => *quiet = now,
            Exchange::Draining { quiet, .. } => {
                if now.since(*quiet) >= self.config.line.quiet_time(self.config.period) {
                    self.forget_answer();
                    self.exchange = self.rest(now);
                    return;
                }
            }
        }
        let is_old = self.config.line.is_streamed() && self.sent_from() < self.fresh_from;
        let mut strange = 0;
        for index in 0..count {
            let byte = self.buffer[index];
            let numbers = self.values.get_mut(..self.count).unwrap_or_default();
            let reception = self.driver.receive(byte, now, numbers);
            let values = self.values;
            if reception == Reception::Pending {
                self.is_within = true;
                continue;
            }
            self.end_answer();
            match reception {
                Reception::Pending => {}
                Reception::Skipped => strange += 1,
                Reception::Sample | Reception::Refused(_) if is_old => self.exchange = self.after_answer(now),
                Reception::Sample => strange += u64::from(!self.accept(values, now)),
                Reception::Refused(code) => {
                    if let Exchange::Due { .. } = self.exchange {
                        self.refusal = Some(code);
                        self.latch(DeviceFault::Refused { code });
                        self.miss();
                        self.exchange = self.after_answer(now);
                    } else {
                        strange += 1;
                    }
                }
            }
        }
        if strange > 0 {
            self.garbage = self.garbage.saturating_add(1);
            self.own_counters.garbage += strange;
        }
    }

    /// Takes the numbers of a valid answer. Returns whether the answer was due, with all numbers in their ranges.
    fn accept(&mut self, values: [f64; MOST_VALUES], now: Instant) -> bool {
        let Exchange::Due { at } = self.exchange else { return false };
        let mut numbers = values.iter();
        for value in self.config.values {
            if numbers.by_ref().take(value.count).any(|number| !value.permits(*number)) {
                return false;
            }
        }
        let not_before = if self.config.line.is_streamed() { self.sent_from() } else { at };
        self.exchange = self.after_answer(now);
        self.own_counters.samples += 1;
        (self.missing, self.garbage) = (0, 0);
        if std::mem::take(&mut self.resetting) {
            self.state.fault = None;
        }
        if self.state.fault.is_none() || self.bring_up.is_some() {
            let sample = DeviceSample { number: self.state.sample.number + 1, read_at: now, not_before, values };
            self.state.sample = sample;
            self.ends.hand_over(now, Some(sample));
        }
        true
    }

    fn miss(&mut self) {
        self.own_counters.missing += 1;
        self.missing = self.missing.saturating_add(1);
    }

    /// Ends a query without an answer in its time. A line that does not become quiet, or a driver without a query,
    /// delays the next query, which then counts as missing too. A device that sends by itself misses one sample per
    /// interval; the first of a row has the spare time of an answer.
    fn judge(&mut self, now: Instant) {
        let (line, period) = (self.config.line, self.config.period);
        let (since, longest) = match self.exchange {
            Exchange::Idle { readings, .. } => (now - period * readings, self.every + line.answer_timeout(period)),
            Exchange::Due { at } => (at, line.answer_timeout(period)),
            Exchange::Draining { since, .. } => (since, line.answer_timeout(period) + line.quiet_time(period)),
        };
        if now.since(since) <= longest {
            return;
        }
        if self.is_within {
            self.forget_answer();
            self.garbage = self.garbage.saturating_add(1);
        }
        self.miss();
        match &mut self.exchange {
            Exchange::Idle { readings, .. } => *readings = 0,
            Exchange::Due { at } if line.is_streamed() => *at += line.interval,
            Exchange::Due { .. } | Exchange::Draining { .. } => self.listen(now),
        }
        if self.missing > self.config.tolerated_missing {
            self.latch(match self.garbage {
                0 => DeviceFault::Silent { samples: self.missing },
                readings => DeviceFault::Garbage { readings },
            });
        }
    }

    /// Reads once, and judges the exchange.
    fn receive(&mut self, now: Instant) -> Result<usize, serial::LineError> {
        let read = self.fetch(now);
        self.take(*read.as_ref().unwrap_or(&0), now);
        self.judge(now);
        read
    }

    /// Sends the next query, if it is due.
    fn ask(&mut self, now: Instant) -> Result<(), serial::LineError> {
        match self.exchange {
            Exchange::Idle { from, .. } if now >= from && !self.config.line.is_streamed() => {}
            Exchange::Idle { .. } | Exchange::Due { .. } => return Ok(()),
            // A stalled line may still hold the last query.
            Exchange::Draining { .. } => {
                self.line.discard_unsent();
                return Ok(());
            }
        }
        if self.is_within {
            // The rest of an answer to no query must not be taken for the answer.
            self.listen(now);
            return Ok(());
        }
        let mut query = [0; MOST_QUERY];
        let length = self.driver.query(now, &mut query).min(MOST_QUERY);
        if length == 0 {
            return Ok(());
        }
        self.asked = Some(now);
        // A query that the line did not take whole ends like a query without an answer.
        self.exchange = Exchange::Due { at: now + self.config.line.settings.line_time(length) };
        let written = self.line.write(now, query.get(..length).unwrap_or_default());
        let port = &mut self.counters.port;
        match written {
            Ok(count) if count == length => port.sent += 1,
            _ => port.refused += 1,
        }
        written.map(|_| ())
    }

    fn advance_bring_up(&mut self, now: Instant, began: Instant) -> Poll<Result<(), DeviceError>> {
        match self.receive(now) {
            Ok(count) => {
                if let Some((_, bytes)) = &mut self.bring_up {
                    *bytes = bytes.saturating_add(count as u32);
                }
            }
            Err(error) => return Poll::Ready(Err(DeviceError::Line(error))),
        }
        if self.state.sample.number > 0 {
            return Poll::Ready(Ok(()));
        }
        if let Some(code) = self.refusal {
            return Poll::Ready(Err(DeviceError::Refused { code }));
        }
        let waited = now.since(began);
        if waited > self.config.boot_timeout {
            return Poll::Ready(Err(match self.bring_up {
                Some((_, bytes @ 1..)) => DeviceError::Garbled { bytes },
                _ => DeviceError::Absent { waited },
            }));
        }
        match self.ask(now) {
            Ok(()) => Poll::Pending,
            Err(error) => Poll::Ready(Err(DeviceError::Line(error))),
        }
    }
}

impl<L: Line, D: LineDriver> DriveGroup for DeviceOnLine<L, D> {
    /// A device has no axes.
    fn axes(&self) -> usize {
        0
    }

    /// A device takes no set-points.
    fn delay(&self) -> usize {
        0
    }

    /// A call after success or after an error begins a new bring-up.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        let began = match self.bring_up {
            Some((began, _)) => began,
            None => {
                self.bring_up = Some((now, 0));
                self.state = DeviceState { at: now, ..DeviceState::NOT_STARTED };
                self.forget_answer();
                // Old bytes are drained first. A device that sends by itself is never quiet: its old samples are
                // dropped.
                self.listen(now);
                self.fresh_from = now;
                (self.missing, self.garbage, self.resetting, self.refusal) = (0, 0, false, None);
                self.own_counters = DeviceCounters::default();
                now
            }
        };
        self.state.at = now;
        let result = match self.advance_bring_up(now, began) {
            Poll::Pending => return Poll::Pending,
            Poll::Ready(result) => result,
        };
        self.bring_up = None;
        if result.is_ok() {
            self.ends.reset.take();
            self.state.fault = None;
        }
        self.ends.publisher.publish(&self.state.words());
        Poll::Ready(result.map_err(|error| BringUpError::Device { error }))
    }

    /// Drops what a device sends by itself, so that no byte waits for the first cycle.
    fn wait(&mut self, now: Instant) {
        if !self.config.line.is_streamed() {
            return;
        }
        self.fresh_from = now;
        match self.fetch(now) {
            Ok(count) => self.take(count, now),
            Err(error) => self.latch(DeviceFault::Line(error)),
        }
        self.listen(now);
        (self.missing, self.garbage) = (0, 0);
    }

    fn read(&mut self, now: Instant, _states: &mut [AxisState]) {
        self.state.at = now;
        if self.ends.reset.take() && self.state.fault.is_some() && !self.resetting {
            // The sample that ends the fault is measured after the request.
            self.resetting = true;
            self.fresh_from = now;
            if matches!(self.exchange, Exchange::Due { .. }) {
                self.listen(now);
            }
            (self.missing, self.garbage) = (0, 0);
        }
        if let Err(error) = self.receive(now) {
            self.latch(DeviceFault::Line(error));
        }
        self.ends.publisher.publish(&self.state.words());
        self.state.cycle += 1;
    }

    fn write(&mut self, _now: Instant, _commands: &[AxisCommand]) {}

    /// Sends the next query, if it is due. There is no set-point to refuse.
    fn send(&mut self, now: Instant) -> bool {
        if let Err(error) = self.ask(now) {
            self.latch(DeviceFault::Line(error));
        }
        true
    }

    /// The counters of the port count queries and samples. A tty gives no receive times, so there is no bus time.
    fn counters(&self) -> GroupCounters {
        let own = self.own_counters;
        let line = self.line.counters();
        let mut counters = self.counters;
        counters.missed_answers = own.missing;
        counters.unexpected = own.garbage;
        counters.port = Counters {
            received: own.samples,
            dropped: line.dropped,
            errors: own.garbage,
            bits: self.config.line.settings.bits_per_byte() * (line.sent + line.received),
            ..counters.port
        };
        counters
    }
}

impl<L: Line, D: LineDriver> Drop for DeviceOnLine<L, D> {
    /// Latches [`DeviceFault::Ended`]: the last sample is no longer valid.
    fn drop(&mut self) {
        self.latch(DeviceFault::Ended);
        self.ends.publisher.publish(&self.state.words());
    }
}
