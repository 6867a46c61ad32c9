//! State of a device in one cycle, its samples, its reader and its requests.

use std::array;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use can::Instant;

use super::fault::{self, DeviceFault};
use super::value::MOST_VALUES;
use crate::latest::{Latest, Publisher, latest_of};
use crate::{Request, Word};

/// Capacity of the ring of samples between a device and the files of a run.
const SAMPLES: usize = 512;

/// A sample of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceSample {
    /// Number of the sample since bring-up, from 1; 0 before the first sample.
    pub number: u64,
    /// Time of the cycle that read the end of the sample.
    pub read_at: Instant,
    /// Earliest time of the measurement: end of the query, or for a device that sends by itself, earliest time of the
    /// first byte.
    pub not_before: Instant,
    /// The numbers in the order of their declaration, then zeros. NaN: not measured.
    pub values: [f64; MOST_VALUES],
}

impl DeviceSample {
    /// Before the first sample.
    pub(super) const NONE: Self =
        Self { number: 0, read_at: Instant::ZERO, not_before: Instant::ZERO, values: [0.0; MOST_VALUES] };

    /// Greatest age of the measurement at `now`.
    pub fn age(&self, now: Instant) -> Duration {
        now.since(self.not_before)
    }
}

/// State of a device in one cycle. Cycles count from 0 at the end of bring-up.
///
/// The driver publishes a state in every cycle. If the cycle does not run, [`at`](Self::at) of the latest state does
/// not advance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceState {
    /// Number of the cycle that published the state.
    pub cycle: u64,
    /// Time of that cycle.
    pub at: Instant,
    /// The last sample. The value does not change during a fault; [`measured`](Self::measured) excludes faults.
    pub sample: DeviceSample,
    /// The latched fault.
    pub fault: Option<DeviceFault>,
}

/// Words of an encoded state before its values.
const HEAD: usize = 7;
const WORDS: usize = HEAD + MOST_VALUES;

/// The writing end of the states of a device.
pub(super) type StatePublisher = Publisher<WORDS>;

impl DeviceState {
    /// The state before operation.
    pub(super) const NOT_STARTED: Self =
        Self { cycle: 0, at: Instant::ZERO, sample: DeviceSample::NONE, fault: Some(DeviceFault::NotStarted) };

    /// The last sample; `None` before the first sample, and while the device has a [`fault`](Self::fault).
    pub fn measured(&self) -> Option<&DeviceSample> {
        (self.fault.is_none() && self.sample.number > 0).then_some(&self.sample)
    }

    pub(super) fn words(&self) -> [u64; WORDS] {
        let Self { cycle, at, sample, fault } = self;
        let [kind, number] = fault::words(*fault);
        let DeviceSample { number: of_sample, read_at, not_before, values } = sample;
        let head = [*cycle, at.as_nanos(), *of_sample, read_at.as_nanos(), not_before.as_nanos(), kind, number];
        array::from_fn(|word| match word.checked_sub(HEAD) {
            None => head[word],
            Some(value) => values[value].to_bits(),
        })
    }

    fn of_words(words: &[u64; WORDS]) -> Self {
        let [cycle, at, of_sample, read_at, not_before, kind, number, values @ ..] = words;
        Self {
            cycle: *cycle,
            at: Instant::from_nanos(*at),
            sample: DeviceSample {
                number: *of_sample,
                read_at: Instant::from_nanos(*read_at),
                not_before: Instant::from_nanos(*not_before),
                values: values.map(f64::from_bits),
            },
            fault: fault::of_words([*kind, *number]),
        }
    }
}

/// The controller's end of a device. Clones read the same device.
#[derive(Clone, Debug)]
pub struct DeviceLink {
    latest: Latest<WORDS>,
    reset: Request,
}

/// All samples of a device since the last call, for the files of a run. Samples beyond the capacity are dropped and
/// counted. `None` marks a time from which the last sample is not valid any more.
#[derive(Debug)]
pub struct DeviceSamples {
    ring: rtrb::Consumer<(Instant, Option<DeviceSample>)>,
    lost: Arc<AtomicU64>,
}

impl DeviceSamples {
    /// The next sample with the time of the cycle that read the sample.
    pub fn take(&mut self) -> Option<(Instant, Option<DeviceSample>)> {
        self.ring.pop().ok()
    }

    /// Number of samples that were dropped because the ring was full.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

/// The driver's ends of a device.
pub(super) struct DriverEnds {
    pub(super) publisher: StatePublisher,
    pub(super) reset: Request,
    ring: rtrb::Producer<(Instant, Option<DeviceSample>)>,
    lost: Arc<AtomicU64>,
}

impl DriverEnds {
    /// Hands a sample to the files of the run; `None`: the last sample is not valid any more.
    pub(super) fn hand_over(&mut self, at: Instant, sample: Option<DeviceSample>) {
        if self.ring.push((at, sample)).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// All ends of a device with samples of `count` numbers.
pub(super) fn ends(count: usize) -> (DriverEnds, DeviceLink, DeviceSamples) {
    let (publisher, latest) = latest_of(HEAD + count, DeviceState::NOT_STARTED.words());
    let reset = Request::default();
    let (producer, consumer) = rtrb::RingBuffer::new(SAMPLES);
    let lost = Arc::<AtomicU64>::default();
    let driver = DriverEnds { publisher, reset: reset.clone(), ring: producer, lost: Arc::clone(&lost) };
    (driver, DeviceLink { latest, reset }, DeviceSamples { ring: consumer, lost })
}

impl DeviceLink {
    /// The state of the last cycle.
    pub fn read(&self) -> DeviceState {
        DeviceState::of_words(&self.latest.read())
    }

    /// Requests a reset of the latched fault. The fault ends with the next valid sample. A fault that persists is
    /// latched again.
    pub fn reset_fault(&self) {
        self.reset.request();
    }

    /// The word that the driver takes.
    pub fn word(&self) -> Word {
        self.reset.word()
    }
}
