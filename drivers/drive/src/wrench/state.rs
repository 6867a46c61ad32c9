//! State of a force/torque sensor in one cycle, its reader and its requests.

use std::array;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use can::Instant;

use super::fault::{self, WrenchFault};
use crate::latest::{Latest, Publisher, latest};
use crate::{Request, Word};

/// One component of a wrench, in the order of [`WrenchState::wrench`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WrenchAxis {
    /// Force along x.
    Fx,
    /// Force along y.
    Fy,
    /// Force along z.
    Fz,
    /// Torque about x.
    Tx,
    /// Torque about y.
    Ty,
    /// Torque about z.
    Tz,
}

impl WrenchAxis {
    /// In the order of a wrench.
    pub const ALL: [Self; 6] = [Self::Fx, Self::Fy, Self::Fz, Self::Tx, Self::Ty, Self::Tz];
}

/// `Fx` to `Tz`.
impl fmt::Display for WrenchAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

/// State of a force/torque sensor in one cycle. Cycles count from 0 at the end of bring-up.
///
/// The driver publishes a state in every cycle. If the cycle does not run, [`at`](Self::at) of the latest state does
/// not advance. All numbers are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchState {
    /// Number of the cycle that published the state.
    pub cycle: u64,
    /// Time of that cycle.
    pub at: Instant,
    /// Forces along x, y and z, N, and torques about x, y and z, N·m, in the frame of the sensor: the load of the tool
    /// on the sensor, minus the zero. The value comes from the last sample and does not change during a fault;
    /// [`measured`](Self::measured) excludes faults.
    pub wrench: [f64; 6],
    /// Time of the last sample.
    pub sampled: Instant,
    /// Samples since the end of bring-up.
    pub samples: u64,
    /// Number of cycles since the cycle that took the last sample; 0 in this cycle itself.
    pub age: u32,
    /// State of the zero.
    pub zeroing: Zeroing,
    /// The request whose zero is in force; `None` if the sensor was not zeroed since bring-up, or lost its own zero.
    pub zeroed: Option<ZeroRequest>,
    /// The latched fault.
    pub fault: Option<WrenchFault>,
}

/// State of the zero of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zeroing {
    /// The sensor was not zeroed since bring-up, or lost its own zero. The wrench is relative to the zero that the
    /// sensor itself has.
    None,
    /// The zeroing takes samples. The previous zero is still in force.
    UnderWay {
        /// The request in progress.
        request: ZeroRequest,
        /// Samples taken so far.
        samples: u16,
    },
    /// The zero is in force, from this state on.
    Done {
        /// The last request that was carried out.
        request: ZeroRequest,
        /// Number of samples in the mean; 0 if the sensor has executed its bias command.
        samples: u16,
    },
    /// The zeroing failed. The previous zero is still in force, unless the sensor had already executed its bias command
    /// ([`ZeroMethod::Device`](super::ZeroMethod::Device)). After a new bring-up, the wrench is relative to the zero that
    /// the sensor itself has.
    Failed {
        /// The request that was not carried out.
        request: ZeroRequest,
        /// Why the zeroing failed.
        cause: ZeroFailure,
    },
}

/// Why a zeroing failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ZeroFailure {
    /// A fault of the sensor, or a new bring-up.
    Interrupted,
    /// The samples differ by more than [`ZERO_SCATTER`](super::ZERO_SCATTER) of the range: the robot moved, or the tool
    /// touched something.
    Unsteady {
        /// Channel with this difference.
        axis: WrenchAxis,
    },
    /// After the bias command, a channel reads more than [`ZERO_SCATTER`](super::ZERO_SCATTER) of the range.
    NotBiased {
        /// Channel with this reading.
        axis: WrenchAxis,
    },
}

/// Number of a request for a zero, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ZeroRequest(u64);

impl ZeroRequest {
    /// The number, from 1.
    pub const fn number(self) -> u64 {
        self.0
    }
}

impl ZeroFailure {
    fn number(self) -> u16 {
        match self {
            Self::Interrupted => 0,
            Self::Unsteady { axis } => 1 + axis as u16,
            Self::NotBiased { axis } => 7 + axis as u16,
        }
    }

    fn of_number(number: u16) -> Self {
        let axis = |first| WrenchAxis::ALL[usize::from(number - first) % 6];
        match number {
            0 => Self::Interrupted,
            1..=6 => Self::Unsteady { axis: axis(1) },
            _ => Self::NotBiased { axis: axis(7) },
        }
    }
}

impl Zeroing {
    /// Whether the zero of `request`, or of a later request, is in force.
    pub fn is_done(self, request: ZeroRequest) -> bool {
        matches!(self, Self::Done { request: done, .. } if done >= request)
    }

    /// Whether `request`, or a later request, has failed.
    pub fn has_failed(self, request: ZeroRequest) -> bool {
        matches!(self, Self::Failed { request: failed, .. } if failed >= request)
    }
}

/// Length of an encoded state, words of 64 bits.
const WORDS: usize = 17;

/// The writing end of the states of a sensor.
pub(super) type StatePublisher = Publisher<WORDS>;

impl WrenchState {
    /// The state before operation.
    pub(super) const NOT_STARTED: Self = Self {
        cycle: 0,
        at: Instant::ZERO,
        wrench: [0.0; 6],
        sampled: Instant::ZERO,
        samples: 0,
        age: 0,
        zeroing: Zeroing::None,
        zeroed: None,
        fault: Some(WrenchFault::NotStarted),
    };

    /// The wrench of the last sample; `None` while the sensor has a [`fault`](Self::fault).
    pub fn measured(&self) -> Option<[f64; 6]> {
        self.fault.is_none().then_some(self.wrench)
    }

    pub(super) fn words(&self) -> [u64; WORDS] {
        let (zeroing, request, samples) = match self.zeroing {
            Zeroing::None => (0, ZeroRequest(0), 0),
            Zeroing::UnderWay { request, samples } => (1, request, samples),
            Zeroing::Done { request, samples } => (2, request, samples),
            Zeroing::Failed { request, cause } => (3, request, cause.number()),
        };
        let mut words = [0; WORDS];
        for (word, component) in words.iter_mut().zip(self.wrench) {
            *word = component.to_bits();
        }
        words[6..14].copy_from_slice(&[
            self.cycle,
            self.at.as_nanos(),
            self.sampled.as_nanos(),
            self.samples,
            u64::from(self.age),
            zeroing | u64::from(samples) << 8,
            request.0,
            self.zeroed.map_or(0, ZeroRequest::number),
        ]);
        words[14..].copy_from_slice(&fault::words(self.fault));
        words
    }

    pub(super) fn from_words(words: &[u64; WORDS]) -> Self {
        let [cycle, at, sampled, samples, age, zeroing, request, in_force] = array::from_fn(|word| words[6 + word]);
        let (request, zeroed) = (ZeroRequest(request), (zeroing >> 8) as u16);
        Self {
            cycle,
            at: Instant::from_nanos(at),
            wrench: array::from_fn(|component| f64::from_bits(words[component])),
            sampled: Instant::from_nanos(sampled),
            samples,
            age: age as u32,
            zeroing: match zeroing as u8 {
                1 => Zeroing::UnderWay { request, samples: zeroed },
                2 => Zeroing::Done { request, samples: zeroed },
                3 => Zeroing::Failed { request, cause: ZeroFailure::of_number(zeroed) },
                _ => Zeroing::None,
            },
            zeroed: (in_force > 0).then_some(ZeroRequest(in_force)),
            fault: fault::of_words(array::from_fn(|word| words[14 + word])),
        }
    }
}

/// The controller's end of a force/torque sensor, for any number of readers. No call waits or allocates.
#[derive(Clone, Debug)]
pub struct WrenchLink {
    latest: Latest<WORDS>,
    requests: Requests,
}

/// Requests to the driver of a sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Requests(Arc<RequestWords>);

#[derive(Debug, Default)]
struct RequestWords {
    /// Number of the last request for a zero.
    zero: AtomicU64,
    /// Number of the request for a zero that the driver took last.
    taken: Arc<AtomicU64>,
    reset: Request,
}

impl WrenchLink {
    /// A link before operation, and the driver's end of it.
    pub(super) fn new() -> (StatePublisher, Requests, Self) {
        let (publisher, latest) = latest(WrenchState::NOT_STARTED.words());
        let requests = Requests::default();
        (publisher, requests.clone(), Self { latest, requests })
    }

    /// The latest state. All fields belong to the same cycle.
    pub fn read(&self) -> WrenchState {
        WrenchState::from_words(&self.latest.read())
    }

    /// Requests a zero: afterwards, the present load reads as zero. The driver begins in its next cycle.
    /// [`WrenchState::zeroing`] shows the progress of the returned request. A request during a zeroing restarts the
    /// zeroing. A request before operation takes effect in the first cycle. A request during a fault fails.
    ///
    /// The robot must stand still until the zeroing is done. The zeroing fails if its samples differ too much
    /// ([`ZeroFailure`]). A constant contact force is not detected: the force becomes part of the zero.
    pub fn zero(&self) -> ZeroRequest {
        ZeroRequest(self.requests.0.zero.fetch_add(1, Ordering::AcqRel) + 1)
    }

    /// Requests a reset of the latched fault. The fault ends with the next sample, so that no old wrench becomes valid.
    /// A fault that persists is latched again.
    pub fn reset_fault(&self) {
        self.requests.0.reset.request();
    }

    /// The words that the driver takes.
    pub fn words(&self) -> [Word; 2] {
        let requests = self.requests.clone();
        let repeat = move |number| requests.0.zero.store(number, Ordering::Release);
        [Word { taken: Arc::clone(&self.requests.0.taken), repeat: Box::new(repeat) }, self.requests.0.reset.word()]
    }
}

impl Requests {
    /// The last request for a zero; `None` before the first.
    pub(super) fn zero(&self) -> Option<ZeroRequest> {
        let number = self.0.zero.load(Ordering::Acquire);
        self.0.taken.store(number, Ordering::Relaxed);
        (number > 0).then_some(ZeroRequest(number))
    }

    /// Whether there was a request for a reset since the last call.
    pub(super) fn take_reset(&self) -> bool {
        self.0.reset.take()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_published_is_read(
            wrench in any::<[i32; 6]>(),
            [cycle, at, sampled, samples] in any::<[u64; 4]>(),
            age in any::<u32>(),
            (zeroing, request, zeroed) in (0..=3, any::<u64>(), any::<u16>()),
            failure in 0..13_u16,
            fault in fault::tests::any_fault(),
        ) {
            let request = ZeroRequest(request);
            let state = WrenchState {
                cycle,
                at: Instant::from_nanos(at),
                wrench: wrench.map(|counts| f64::from(counts) / 940.0),
                sampled: Instant::from_nanos(sampled),
                samples,
                age,
                zeroing: match zeroing {
                    1 => Zeroing::UnderWay { request, samples: zeroed },
                    2 => Zeroing::Done { request, samples: zeroed },
                    3 => Zeroing::Failed { request, cause: ZeroFailure::of_number(failure) },
                    _ => Zeroing::None,
                },
                zeroed: (cycle > 0).then_some(ZeroRequest(cycle)),
                fault,
            };
            let (mut publisher, _, link) = WrenchLink::new();
            prop_assert_eq!(link.read(), WrenchState::NOT_STARTED);
            publisher.publish(&state.words());
            prop_assert_eq!(link.read(), state);
            prop_assert_eq!(link.read().measured(), fault.is_none().then_some(state.wrench));
        }
    }

    #[test]
    fn requests_are_numbered_and_a_reset_is_taken_once() {
        let (_publisher, requests, link) = WrenchLink::new();
        assert_eq!(requests.zero(), None);
        let (first, second) = (link.zero(), link.clone().zero());
        assert!(first < second);
        assert_eq!(requests.zero(), Some(second));
        let done = Zeroing::Done { request: first, samples: 10 };
        assert!(done.is_done(first) && !done.is_done(second) && !done.has_failed(first));
        let failed = Zeroing::Failed { request: second, cause: ZeroFailure::Interrupted };
        assert!(failed.has_failed(first) && failed.has_failed(second) && !failed.is_done(first));
        assert!(!requests.take_reset());
        link.reset_fault();
        assert!(requests.take_reset() && !requests.take_reset());
    }
}
