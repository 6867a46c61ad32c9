//! The contract of a driver for a device of another crate on a serial line.

use std::time::Duration;

use can::Instant;
use serial::Settings;

/// Greatest length of a query, bytes.
pub const MOST_QUERY: usize = 64;

/// Encodes the queries to one device on a serial line, and decodes its answers. Every function runs in the servo cycle:
/// it does not allocate, lock, format or wait, and its time is bounded.
///
/// [`DeviceOnLine`](super::DeviceOnLine) handles time-outs, lost answers, ranges of values and faults.
///
/// Methods with a default may be added to this trait; every other change is announced in the change log.
pub trait LineDriver: Send + 'static {
    /// Writes the next query into the front of `query`, and returns its length. 0: no query is due in this cycle. A
    /// sample counts as missing if no query follows for the interval and the time limit of an answer. Not called for a
    /// device that sends by itself ([`LineConfig::query`] is 0).
    fn query(&mut self, now: Instant, query: &mut [u8; MOST_QUERY]) -> usize;

    /// Takes the next byte from the device. At the last byte of a valid answer, `values` must hold the numbers of the
    /// sample, in the order of their declaration. NaN stands for a number that the device did not measure. All values
    /// are NaN at the first byte of an answer, and remain from byte to byte of an answer.
    fn receive(&mut self, byte: u8, now: Instant, values: &mut [f64]) -> Reception;

    /// Forgets an answer that has begun and not ended.
    fn restart(&mut self);
}

/// Result of a byte from a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reception {
    /// The byte belongs to an answer that has not ended.
    Pending,
    /// The byte, or an answer that ends with it, is not valid.
    Skipped,
    /// The byte ends a valid answer.
    Sample,
    /// The byte ends an answer that refuses the query with this code.
    Refused(u8),
}

/// Line of a device, and its telegrams.
///
/// Fields may be added to this type; use [`polled`](Self::polled) or [`streamed`](Self::streamed). Every other change
/// is announced in the change log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct LineConfig {
    /// Settings of the line.
    pub settings: Settings,
    /// Greatest length of a query, bytes; 0 for a device that sends by itself.
    pub query: usize,
    /// Greatest length of an answer, bytes.
    pub answer: usize,
    /// Time from one query to the next, or time between two samples of a device that sends by itself.
    pub interval: Duration,
    /// Greatest time from the end of a query to the first byte of its answer.
    pub answer_delay: Duration,
    /// Whether answers carry the number of their query, which the driver compares. Without a number, the line has one
    /// reading without bytes before each query.
    pub is_numbered: bool,
}

impl LineConfig {
    /// Least time by which an answer may exceed its computed time, for the delays of device, adapter and tty.
    const SPARE: Duration = Duration::from_millis(20);

    /// A device that answers queries: `query` and `answer` are their greatest lengths, bytes.
    pub const fn polled(settings: Settings, query: usize, answer: usize) -> Self {
        Self { settings, query, answer, interval: Duration::ZERO, answer_delay: Duration::ZERO, is_numbered: false }
    }

    /// A device that sends an answer of at most `answer` bytes every `interval` by itself.
    pub const fn streamed(settings: Settings, answer: usize, interval: Duration) -> Self {
        Self { settings, query: 0, answer, interval, answer_delay: Duration::ZERO, is_numbered: false }
    }

    /// This configuration with another time from one query to the next, rounded up to a servo period.
    #[must_use]
    pub const fn every(self, interval: Duration) -> Self {
        Self { interval, ..self }
    }

    /// This configuration with another greatest time from the end of a query to the first byte of its answer.
    #[must_use]
    pub const fn answering_within(self, answer_delay: Duration) -> Self {
        Self { answer_delay, ..self }
    }

    /// This configuration for a device whose answers carry the number of their query. The driver skips an answer with
    /// another number.
    #[must_use]
    pub const fn numbered(self) -> Self {
        Self { is_numbered: true, ..self }
    }

    /// Whether the device sends by itself.
    pub const fn is_streamed(&self) -> bool {
        self.query == 0
    }

    /// Time on the line of a query and its answer.
    pub fn line_time(&self) -> Duration {
        self.settings.line_time(self.query + self.answer)
    }

    /// Longest time from sending a query to the end of its answer, or between two samples of a device that sends by
    /// itself.
    pub fn answer_timeout(&self, period: Duration) -> Duration {
        let interval = if self.is_streamed() { self.interval } else { Duration::ZERO };
        self.line_time() + self.answer_delay + interval + 2 * period + Self::SPARE
    }

    /// Time for which the line must be quiet before the next query, once an answer is missing. An answer without a
    /// number that takes up to three times its limit is therefore not taken for the answer to a later query.
    pub fn quiet_time(&self, period: Duration) -> Duration {
        if self.is_numbered || self.is_streamed() { Duration::ZERO } else { 2 * self.answer_timeout(period) }
    }

    /// Time from one query to the next, rounded up to a whole number of periods.
    pub(super) fn query_interval(&self, period: Duration) -> Duration {
        match self.interval.as_nanos().div_ceil(period.as_nanos().max(1)).try_into() {
            Ok(periods) if !period.is_zero() => period * periods,
            _ => self.interval,
        }
    }

    /// Greatest time from one missing sample to the next.
    pub fn loss_time(&self, period: Duration) -> Duration {
        let interval = if self.is_streamed() { Duration::ZERO } else { self.interval };
        interval + self.answer_timeout(period) + self.quiet_time(period) + 2 * period
    }

    /// Shortest time between two samples: the device answers at once.
    pub fn least_sample_time(&self, period: Duration) -> Duration {
        if self.is_streamed() {
            return self.interval;
        }
        let nanos = period.as_nanos().max(1);
        // An answer that is not numbered precedes a reading without bytes.
        let readings = self.line_time().as_nanos().div_ceil(nanos).max(1) + u128::from(!self.is_numbered);
        let least = period * u32::try_from(readings).unwrap_or(u32::MAX);
        least.max(self.query_interval(period))
    }

    /// Time from one sample to the next without lost answers.
    pub fn sample_time(&self, period: Duration) -> Duration {
        let exchange = self.line_time() + self.answer_delay + 2 * period;
        if self.is_streamed() { self.interval } else { exchange.max(self.interval) }
    }
}
