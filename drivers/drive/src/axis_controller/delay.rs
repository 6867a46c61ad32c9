//! Delay of answers, in periods: which request an answer belongs to.
//!
//! Bring-up accepts a line whose answers come within a period. In operation, an adapter or a driver may begin to hold
//! answers. If every answer comes later by the same time, every cycle still has an answer, and each is as old as the
//! delay.
//!
//! # NFv2
//! The objects of an answer name its request modulo 3 ([`Objects`]). A delay of three periods or a multiple is not
//! seen. Such a delay cannot begin without three missing answers in a row.
//!
//! # The older protocol
//! Answers name nothing. A telegram is left out after the first missing answer in a row ([`Gaps`]), and once more if
//! the answers then return and a delay of one period is still possible. Two telegrams in a row are never left out. An
//! answer in the cycle of a left-out telegram belongs to an older request, which proves a delay. A delay of two periods
//! or more moves the gap to a later cycle, where it is a missing answer again.
//!
//! A delay that changes is seen at the next missing answer only: one that is longer while answers are missing, and then
//! settles at fewer periods. A device that answers twice to one request, or of itself, can hide a delay.

use super::objects::Objects;

/// Requests that can still be answered. Bit *n* is the request of *n* cycles before the last one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Requests(u16);

impl Requests {
    pub(super) fn count(self) -> u32 {
        self.0.count_ones()
    }

    /// Whether the telegram of the last cycle can still be answered.
    pub(super) fn has_last(self) -> bool {
        self.0 & 1 != 0
    }

    /// Adds the telegram of this cycle.
    pub(super) fn send(&mut self) {
        self.0 |= 1;
    }

    /// Begins a cycle. Requests older than 15 cycles are never answered.
    pub(super) fn age(&mut self) {
        self.0 <<= 1;
    }

    fn without_oldest(self, count: u32) -> Self {
        (0..count).fold(self, |Self(bits), _| Self(bits & !oldest(bits)))
    }
}

/// The highest bit.
fn oldest(bits: u16) -> u16 {
    bits.checked_ilog2().map_or(0, |bit| 1 << bit)
}

/// Whether an answer came in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Timing {
    /// The answer belongs to the last request, or may do so.
    InTime,
    /// The answer belongs to an older request: the last one less this number, at least 1.
    Late(u32),
}

/// Which telegrams were left out, and which delays of the line are possible by the answers since.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gaps {
    /// Possible delays besides none: bit *n* is a delay of *n* periods. Bit 0 is never set.
    delays: u16,
    /// An answer in a gap has proven a delay, and no answer has disproven it since.
    proven: bool,
    /// An answer was missing, and none has come in time since.
    missing: bool,
    /// The next telegram is to be left out.
    wanted: bool,
}

impl Gaps {
    /// Whether the next telegram is to be left out.
    pub(super) fn is_wanted(&self) -> bool {
        self.wanted
    }

    /// Takes a reading without an answer.
    pub(super) fn silence(&mut self, requests: Requests) {
        if requests.has_last() {
            self.delays = !1;
            self.wanted = !self.missing;
            self.missing = true;
        } else {
            // A delay by which an answer was due is none, unless the answer is lost.
            self.delays &= !requests.0;
            self.wanted = false;
        }
    }

    /// Takes the answers of one reading: one at least, and no more than there are `requests`. Returns the timing of the
    /// last one.
    pub(super) fn answers(&mut self, count: u32, requests: &mut Requests) -> Timing {
        // Answers keep the order of their requests, of which some may have no answer.
        let possible = requests.without_oldest(count - 1);
        let last = possible.has_last();
        let all = count == requests.count();
        *requests = requests.without_oldest(count);
        if last && all {
            *self = Self::default();
            return Timing::InTime;
        }
        if !last {
            self.proven = true;
            self.delays = possible.0;
            self.wanted = false;
            return Timing::Late(possible.0.trailing_zeros());
        }
        self.delays &= possible.0;
        if self.proven && self.delays != 0 {
            self.wanted = self.delays & 0b10 != 0;
            return Timing::Late(self.delays.trailing_zeros());
        }
        if self.delays == 0 {
            *self = Self::default();
            *requests = Requests::default();
        }
        self.missing = false;
        self.wanted = self.delays & 0b10 != 0;
        Timing::InTime
    }
}

/// Timing of an answer with `objects` to one of `requests`, while the last request asked for `last`.
pub(super) fn by_objects(objects: Objects, last: Objects, requests: &mut Requests) -> Timing {
    // Cycles since the last telegram that the line took.
    let sent = requests.0.trailing_zeros();
    let delay = objects.requests_before(last) + sent;
    requests.0 &= 1_u16.unbounded_shl(delay).wrapping_sub(1);
    if delay == 0 { Timing::InTime } else { Timing::Late(delay) }
}
