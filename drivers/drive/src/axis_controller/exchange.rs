//! Accounts of the exchange with one drive: answers that are due, late or missing, and telegrams that were not sent.

use can::Instant;

use super::AxisCounters;
use super::fault::AxisControllerFault;

/// Cycles over which missing answers are counted together, and how many of them may be missing.
const WINDOW: u32 = 200;
const MISSING_IN_WINDOW: u32 = WINDOW / 4;

/// Requests, answers and telegrams of one axis.
#[derive(Clone, Debug)]
pub(super) struct Exchange {
    tolerated_missing: u32,
    /// Requests whose answers can still come: at most 2, since an answer later than the next one does not count.
    pub(super) pending: u32,
    /// When the line took the last telegram.
    pub(super) sent_at: Instant,
    /// When the line took the oldest telegram that can still be answered.
    sent_first: Instant,
    /// When the line took the telegram that the last answer answers. One answer to two telegrams counts as that to the
    /// older one.
    pub(super) asked_at: Instant,
    pub(super) reading: Reading,
    /// Cycles in a row without an accepted answer.
    age: u32,
    /// Telegrams in a row that the line did not take.
    unsent: u32,
    window: Window,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Reading {
    /// No answer, or a refused one.
    #[default]
    Missing,
    /// An answer that the next one has to confirm.
    Unconfirmed,
    Accepted,
}

/// Answers that were due since the window began, and how many of those were missing.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    due: u32,
    missing: u32,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct EndOfReading {
    /// Cycles in a row without an accepted answer.
    pub(super) age: u32,
    /// An answer was due and is missing. An unconfirmed answer is not missing.
    pub(super) missing: bool,
    /// Faults in the order in which they explain each other.
    pub(super) faults: [Option<AxisControllerFault>; 3],
}

impl Exchange {
    /// Accounts that begin at `at`, the time of the last request of bring-up.
    pub(super) fn new(tolerated_missing: u32, at: Instant) -> Self {
        Self {
            tolerated_missing,
            pending: 0,
            sent_at: at,
            sent_first: at,
            asked_at: at,
            reading: Reading::Missing,
            age: 0,
            unsent: 0,
            window: Window::default(),
        }
    }

    /// Counts the answers of one reading. Returns whether the last of them answers a request.
    pub(super) fn receive(&mut self, answers: u32, counters: &mut AxisCounters) -> bool {
        counters.surplus += u64::from(answers.saturating_sub(self.pending));
        counters.late += u64::from(answers.min(self.pending).saturating_sub(1));
        let expected = answers > 0 && self.pending > 0;
        if expected {
            self.asked_at = if answers < self.pending { self.sent_first } else { self.sent_at };
            // An answer to an older request never comes, or comes next and is then one too many.
            self.pending = 0;
        }
        expected
    }

    /// Ends the reading of a cycle. `due` says whether the cycle before asked for an answer.
    pub(super) fn end_of_reading(&mut self, due: bool) -> EndOfReading {
        let reading = std::mem::take(&mut self.reading);
        if reading == Reading::Accepted {
            self.age = 0;
        } else if due {
            self.age = self.age.saturating_add(1);
        }
        let missing = due && reading == Reading::Missing;
        let tolerated = self.tolerated_missing;
        let not_sent = AxisControllerFault::NotSent { cycles: self.unsent };
        let silent = AxisControllerFault::Silent { cycles: self.age };
        // Short gaps are tolerated one by one, and a loop on old samples is still unsafe.
        let late = (tolerated < MISSING_IN_WINDOW).then(|| self.window.count(due, missing)).flatten();
        EndOfReading {
            age: self.age,
            missing,
            faults: [
                // A telegram that was not sent may be the cause of the silence.
                (self.unsent > tolerated).then_some(not_sent),
                (self.age > tolerated).then_some(silent),
                late,
            ],
        }
    }

    /// Counts a telegram. `taken` says whether the line took all of it.
    pub(super) fn send(&mut self, taken: bool, now: Instant, counters: &mut AxisCounters) {
        if taken {
            counters.sent += 1;
            self.unsent = 0;
            // The telegram before the last is the oldest one that can still be answered.
            self.sent_first = if self.pending == 0 { now } else { self.sent_at };
            self.sent_at = now;
            self.pending = (self.pending + 1).min(2);
        } else {
            counters.refused += 1;
            self.unsent = self.unsent.saturating_add(1);
        }
    }

    /// Whether the line took the last telegram.
    pub(super) fn was_sent(&self) -> bool {
        self.unsent == 0
    }
}

impl Window {
    fn count(&mut self, due: bool, missing: bool) -> Option<AxisControllerFault> {
        self.due += u32::from(due);
        self.missing += u32::from(missing);
        let Self { due: cycles, missing } = *self;
        let late = missing > MISSING_IN_WINDOW;
        if late || cycles >= WINDOW {
            *self = Self::default();
        }
        late.then_some(AxisControllerFault::Late { missing, cycles })
    }
}
