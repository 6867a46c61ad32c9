//! Accounts of the exchange with one drive: answers that are due, late or missing, and telegrams that were not sent.

use can::Instant;

use super::AxisCounters;
use super::config::Protocol;
use super::delay::{Gaps, Requests, Timing, by_objects};
use super::fault::AxisControllerFault;
use super::objects::Objects;
use super::stream::{Answer, Found};

/// Cycles over which missing answers are counted together, and how many of them may be missing.
const WINDOW: u32 = 200;
const MISSING_IN_WINDOW: u32 = WINDOW / 4;
/// How many answers may be missing or late in the window.
const LATE_IN_WINDOW: u32 = WINDOW / 2;

/// Successive answers with the same objects that are an old answer again: their requests asked for different objects.
const ANSWERS_TO_REPEAT: u32 = 4;

/// Requests, answers and telegrams of one axis.
#[derive(Clone, Debug)]
pub(super) struct Exchange {
    protocol: Protocol,
    tolerated_missing: u32,
    requests: Requests,
    gaps: Gaps,
    /// Objects of the last telegram and of the next one.
    asked: Objects,
    next: Objects,
    repeats: Repeats,
    /// When the line took the last telegram.
    pub(super) sent_at: Instant,
    /// When the line took the oldest telegram that can still be answered.
    sent_first: Instant,
    /// When the line took the telegram that the last answer answers. One answer to two telegrams of the older protocol
    /// counts as that to the older one.
    pub(super) asked_at: Instant,
    pub(super) reading: Reading,
    /// The telegram of the last cycle was left out.
    left_out: bool,
    /// Cycles in a row without an accepted answer.
    age: u32,
    run: Run,
    /// Telegrams in a row that the line did not take.
    unsent: u32,
    window: Window,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Reading {
    /// No answer, or a refused one.
    #[default]
    Missing,
    /// An answer to an older request, by this number of periods.
    Late(u32),
    /// An answer that the next one has to confirm.
    Unconfirmed,
    Accepted,
}

/// Telegrams in a row without an accepted answer.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    telegrams: u32,
    /// Those since the last late answer.
    silent: u32,
    /// Delay of the last late answer, periods.
    late: Option<u32>,
}

/// Successive answers with the same objects.
#[derive(Clone, Copy, Debug, Default)]
struct Repeats {
    objects: Option<Objects>,
    answers: u32,
}

/// Answers that were due since the window began, how many of those were missing, and how many of these came late.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    due: u32,
    missing: u32,
    late: u32,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct EndOfReading {
    /// Cycles in a row without an accepted answer.
    pub(super) age: u32,
    /// An answer was due and is missing or late. An unconfirmed answer is not missing.
    pub(super) missing: bool,
    /// Faults in the order in which they explain each other.
    pub(super) faults: [Option<AxisControllerFault>; 5],
}

impl Exchange {
    /// Accounts that begin at `at`, the time of the last request of bring-up.
    pub(super) fn new(protocol: Protocol, tolerated_missing: u32, at: Instant) -> Self {
        Self {
            protocol,
            tolerated_missing,
            requests: Requests::default(),
            gaps: Gaps::default(),
            asked: Objects::default(),
            next: Objects::default(),
            repeats: Repeats::default(),
            sent_at: at,
            sent_first: at,
            asked_at: at,
            reading: Reading::Missing,
            left_out: false,
            age: 0,
            run: Run::default(),
            unsent: 0,
            window: Window::default(),
        }
    }

    /// Requests that can still be answered.
    pub(super) fn outstanding(&self) -> u32 {
        self.requests.count()
    }

    /// Objects of the last telegram.
    pub(super) fn asked(&self) -> Objects {
        self.asked
    }

    /// Objects of the next telegram.
    pub(super) fn next(&self) -> Objects {
        self.next
    }

    /// Whether the next telegram is to be left out, to find a delay.
    pub(super) fn wants_gap(&self) -> bool {
        self.gaps.is_wanted()
    }

    /// Takes the answers of one reading. Returns the answer to the last request, if it is among them.
    pub(super) fn receive(&mut self, found: &Found, counters: &mut AxisCounters) -> Option<Answer> {
        let outstanding = self.requests.count();
        counters.surplus += u64::from(found.count.saturating_sub(outstanding));
        let answers = found.count.min(outstanding);
        self.repeats.take(found.answer.filter(|_| self.protocol == Protocol::Nfv2));
        let Some(answer) = found.answer.filter(|_| answers > 0) else {
            if self.protocol == Protocol::HiMoxa {
                self.gaps.silence(self.requests);
            }
            return None;
        };
        let timing = match self.protocol {
            Protocol::Nfv2 => by_objects(answer.objects(), self.asked, &mut self.requests),
            Protocol::HiMoxa => self.gaps.answers(answers, &mut self.requests),
        };
        match timing {
            Timing::InTime => {
                counters.late += u64::from(answers - 1);
                let exact = self.protocol == Protocol::Nfv2 || answers == outstanding;
                self.asked_at = if exact { self.sent_at } else { self.sent_first };
                Some(answer)
            }
            Timing::Late(periods) => {
                counters.late += u64::from(answers);
                self.reading = Reading::Late(periods);
                None
            }
        }
    }

    /// Ends the reading of a cycle. `attempted` says whether the cycle before asked for an answer, or left out its
    /// telegram.
    pub(super) fn end_of_reading(&mut self, attempted: bool) -> EndOfReading {
        let reading = std::mem::take(&mut self.reading);
        let due = attempted && !std::mem::take(&mut self.left_out);
        self.requests.age();
        if reading == Reading::Accepted {
            (self.age, self.run) = (0, Run::default());
        } else {
            self.age = self.age.saturating_add(u32::from(attempted));
            self.run.take(reading, due);
        }
        let came_late = due && matches!(reading, Reading::Late(_));
        let missing = came_late || due && reading == Reading::Missing;
        let tolerated = self.tolerated_missing;
        let Run { telegrams: cycles, silent, late } = self.run;
        let not_sent = AxisControllerFault::NotSent { cycles: self.unsent };
        let silence = AxisControllerFault::Silent { cycles: silent };
        let delayed = late.map(|periods| AxisControllerFault::Delayed { cycles, periods });
        let repeated = AxisControllerFault::Repeated { answers: self.repeats.answers };
        // Short gaps are tolerated one by one, and a loop on old samples is still unsafe.
        let often = (tolerated < MISSING_IN_WINDOW).then(|| self.window.count(attempted, missing, came_late)).flatten();
        EndOfReading {
            age: self.age,
            missing,
            faults: [
                // A telegram that was not sent may be the cause of the silence.
                (self.unsent > tolerated).then_some(not_sent),
                (silent > tolerated).then_some(silence),
                (self.repeats.answers >= ANSWERS_TO_REPEAT).then_some(repeated),
                delayed.filter(|_| cycles > tolerated),
                often,
            ],
        }
    }

    /// Leaves the telegram of this cycle out.
    pub(super) fn leave_out(&mut self, counters: &mut AxisCounters) {
        counters.left_out += 1;
        self.left_out = true;
    }

    /// Counts a telegram. `taken` says whether the line took all of it.
    pub(super) fn send(&mut self, taken: bool, now: Instant, counters: &mut AxisCounters) {
        if taken {
            counters.sent += 1;
            self.unsent = 0;
            // The telegram before the last is the oldest one that is still likely to be answered.
            self.sent_first = if self.requests.count() == 0 { now } else { self.sent_at };
            self.sent_at = now;
            self.requests.send();
            self.asked = self.next;
            self.next = self.next.next();
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

impl Run {
    /// Takes a reading without an accepted answer. `due` says that an answer was due.
    fn take(&mut self, reading: Reading, due: bool) {
        let due = u32::from(due);
        self.telegrams = self.telegrams.saturating_add(due);
        self.silent = self.silent.saturating_add(due);
        if let Reading::Late(periods) = reading {
            (self.silent, self.late) = (0, Some(periods));
        }
    }
}

impl Repeats {
    /// Takes the answer of a reading, if there is one.
    fn take(&mut self, answer: Option<Answer>) {
        let objects = answer.map(Answer::objects);
        let again = objects.is_some() && objects == self.objects;
        self.answers = if again { self.answers.saturating_add(1) } else { u32::from(objects.is_some()) };
        self.objects = objects;
    }
}

impl Window {
    fn count(&mut self, due: bool, missing: bool, late: bool) -> Option<AxisControllerFault> {
        self.due += u32::from(due);
        self.missing += u32::from(missing);
        self.late += u32::from(late);
        let Self { due: cycles, missing, late } = *self;
        let often = missing - late > MISSING_IN_WINDOW || missing > LATE_IN_WINDOW;
        if often || cycles >= WINDOW {
            *self = Self::default();
        }
        often.then_some(AxisControllerFault::Late { missing, cycles })
    }
}
