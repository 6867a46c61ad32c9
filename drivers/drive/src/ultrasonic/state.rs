//! State of an ultrasonic matrix in one cycle, its reader and its requests.

use std::array;
use std::time::Duration;

use can::Instant;
use serial::ultrasonic::NO_ECHO;

use super::fault::{self, UltrasonicFault};
use crate::latest::{Latest, Publisher, latest};
use crate::{Request, Word};

/// Greatest number of shots of a scan.
pub const MOST_SHOTS: usize = 16;

/// Greatest number of echo times of a shot.
pub const MOST_ECHOES: usize = 16;

/// A scan: the echo times of all shots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scan {
    /// Number of the scan since bring-up, from 1; 0 before the first scan.
    pub number: u64,
    /// Time at which the last reply of the scan was read.
    pub ended: Instant,
    /// Arrival times of the queries of the shots.
    pub(super) shots: [Instant; MOST_SHOTS],
    /// Echo times, µs, or [`NO_ECHO`].
    pub(super) times: [[u16; MOST_ECHOES]; MOST_SHOTS],
}

impl Scan {
    /// The scan before the first one: without an echo.
    pub(super) const NONE: Self = Self {
        number: 0,
        ended: Instant::ZERO,
        shots: [Instant::ZERO; MOST_SHOTS],
        times: [[NO_ECHO; MOST_ECHOES]; MOST_SHOTS],
    };

    /// Time from emission to echo `number` of shot `shot`; `None` if no echo was received. By rows: shot and number are
    /// row and column of the element. By pairs: shot and number are the emitter and the receiver, counted row by row.
    pub fn echo(&self, shot: usize, number: usize) -> Option<Duration> {
        let time = *self.times.get(shot)?.get(number)?;
        (time != NO_ECHO).then(|| Duration::from_micros(u64::from(time)))
    }

    /// Time of emission `number` of shot `shot` of a scan by rows with firing slots of the duration `slot`. The
    /// time does not include the delays of tty and adapter: the true emission may be some milliseconds later.
    pub fn emission(&self, shot: usize, number: usize, slot: Duration) -> Instant {
        self.shots.get(shot).copied().unwrap_or(self.ended) + slot * number as u32
    }
}

/// State of a matrix in one cycle. Cycles count from 0 at the end of bring-up.
///
/// The driver publishes a state in every cycle. If the cycle does not run, [`at`](Self::at) of the latest state does
/// not advance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UltrasonicState {
    /// Number of the cycle that published the state.
    pub cycle: u64,
    /// Time of that cycle.
    pub at: Instant,
    /// The last complete scan. The value does not change during a fault; [`measured`](Self::measured) excludes faults.
    pub scan: Scan,
    /// The latched fault.
    pub fault: Option<UltrasonicFault>,
}

/// Length of an encoded state, words of 64 bits: 6, then one per shot, then four echo times in each.
const WORDS: usize = 6 + MOST_SHOTS + MOST_SHOTS * MOST_ECHOES / 4;

/// The writing end of the states of a matrix.
pub(super) type StatePublisher = Publisher<WORDS>;

impl UltrasonicState {
    /// The state before operation.
    pub(super) const NOT_STARTED: Self =
        Self { cycle: 0, at: Instant::ZERO, scan: Scan::NONE, fault: Some(UltrasonicFault::NotStarted) };

    /// The last complete scan; `None` before the first scan, and while the matrix has a [`fault`](Self::fault).
    pub fn measured(&self) -> Option<&Scan> {
        (self.fault.is_none() && self.scan.number > 0).then_some(&self.scan)
    }

    pub(super) fn words(&self) -> [u64; WORDS] {
        let Self { cycle, at, scan, fault } = self;
        let [kind, number] = fault::words(*fault);
        let head = [*cycle, at.as_nanos(), scan.number, scan.ended.as_nanos(), kind, number];
        array::from_fn(|word| match word.checked_sub(head.len()) {
            None => head[word],
            Some(shot) if shot < MOST_SHOTS => scan.shots[shot].as_nanos(),
            Some(after) => {
                let first = 4 * (after - MOST_SHOTS);
                let time = |number: usize| u64::from(scan.times[number / MOST_ECHOES][number % MOST_ECHOES]);
                (0..4).fold(0, |word, part| word | time(first + part) << (16 * part))
            }
        })
    }

    fn of_words(words: &[u64; WORDS]) -> Self {
        let [cycle, at, number, ended, kind, of_fault, rest @ ..] = words;
        let time = |shot: usize, number: usize| {
            let number = shot * MOST_ECHOES + number;
            (rest[MOST_SHOTS + number / 4] >> (16 * (number % 4))) as u16
        };
        let scan = Scan {
            number: *number,
            ended: Instant::from_nanos(*ended),
            shots: array::from_fn(|shot| Instant::from_nanos(rest[shot])),
            times: array::from_fn(|shot| array::from_fn(|number| time(shot, number))),
        };
        Self { cycle: *cycle, at: Instant::from_nanos(*at), scan, fault: fault::of_words([*kind, *of_fault]) }
    }
}

/// The controller's end of a matrix. Clones read the same matrix.
#[derive(Clone, Debug)]
pub struct UltrasonicLink {
    latest: Latest<WORDS>,
    reset: Request,
}

/// The driver's end of the requests.
#[derive(Debug)]
pub(super) struct Requests(Request);

impl UltrasonicLink {
    pub(super) fn new() -> (StatePublisher, Requests, Self) {
        let (publisher, latest) = latest(UltrasonicState::NOT_STARTED.words());
        let reset = Request::default();
        (publisher, Requests(reset.clone()), Self { latest, reset })
    }

    /// The state of the last cycle.
    pub fn read(&self) -> UltrasonicState {
        UltrasonicState::of_words(&self.latest.read())
    }

    /// Requests a reset of the latched fault. The fault ends with the next complete scan. A fault that persists is
    /// latched again.
    pub fn reset_fault(&self) {
        self.reset.request();
    }

    /// The word that the driver takes.
    pub fn word(&self) -> Word {
        self.reset.word()
    }
}

impl Requests {
    /// Whether there was a request for a reset since the last call.
    pub(super) fn take_reset(&self) -> bool {
        self.0.take()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_published_is_read(
            [cycle, at, number, ended] in any::<[u64; 4]>(),
            shots in any::<[u64; MOST_SHOTS]>(),
            times in any::<[[u16; MOST_ECHOES]; MOST_SHOTS]>(),
            queries in any::<u32>(),
            has_fault in any::<bool>(),
        ) {
            let state = UltrasonicState {
                cycle,
                at: Instant::from_nanos(at),
                scan: Scan {
                    number,
                    ended: Instant::from_nanos(ended),
                    shots: shots.map(Instant::from_nanos),
                    times,
                },
                fault: has_fault.then_some(UltrasonicFault::Silent { queries }),
            };
            let (mut publisher, _, link) = UltrasonicLink::new();
            prop_assert_eq!(link.read(), UltrasonicState::NOT_STARTED);
            publisher.publish(&state.words());
            prop_assert_eq!(link.read(), state);
            prop_assert_eq!(link.read().measured().is_some(), !has_fault && number > 0);
            let echo = (times[3][2] != NO_ECHO).then(|| Duration::from_micros(u64::from(times[3][2])));
            prop_assert_eq!(link.read().scan.echo(3, 2), echo);
        }
    }
}
