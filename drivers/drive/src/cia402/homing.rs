//! Homing of one CiA 402 drive (CiA 402-2 §11).

use can::Instant;
use canopen::cia402::{Controlword, HomingStatus, Statusword};

use super::axis::ANSWERS_TO_EFFECT;
use super::search_evidence::{Evidence, SearchAnswer, SearchFailure, SearchRules};
use crate::{Homing, Increments};

/// State machine of one axis's homing, and whether the axis has a reference.
///
/// ```text
///         wanted            0x6061 is HM         bits 10, 12, 13; counter
///   Idle ────────► Preparing ─────────► Searching ────────────────► Ended
///    ▲               │ left               │ left                      │ left
///    ├───────────────┘                    ▼                           │
///    ├◄──────────── stands ─────────── Halting ◄──── failed ──────────┤
///    └◄──────────────────────────────── attained ─────────────────────┘
/// ```
///
/// A loss of power ends every search at once. The mode of operation is HM from Preparing to Halting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Search {
    rules: SearchRules,
    step: Step,
    /// A search succeeded, and the counter has not become doubtful since.
    attained: bool,
    /// Bit 15 of the last statusword: EPOS drives keep their reference while they are powered.
    kept: bool,
    /// The counter jumped or may have lost counts. The axis has no reference until the next search, even if the drive
    /// reports one.
    pub(super) doubted: bool,
    /// Number of further answers in which the drive may still set its counter, as the end of a search does.
    may_set_counter: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Step {
    #[default]
    Idle,
    /// Object 0x6061 must come to show mode HM.
    Preparing,
    /// Controlword bit 4 is set.
    Searching(Evidence),
    /// The search has ended, with or without a reference.
    Ended { attained: bool },
    /// Controlword bit 4 is clear and the halt bit is set. `last`: the counter of the last answer, and its time.
    Halting { answers: u32, last: Option<(Increments, Instant)> },
}

impl Search {
    pub(super) fn new(rules: SearchRules) -> Self {
        Self { rules, step: Step::Idle, attained: false, kept: false, doubted: false, may_set_counter: 0 }
    }

    /// Advances once a cycle. `wanted` is the commanded state, `powered` and `in_homing_mode` are the state of the drive.
    pub(super) fn command(&mut self, wanted: bool, powered: bool, in_homing_mode: bool, now: Instant) {
        self.step = match self.step {
            _ if !powered => Step::Idle,
            Step::Idle if wanted => Step::Preparing,
            Step::Preparing if !wanted => Step::Idle,
            Step::Preparing if in_homing_mode => {
                let referenced = self.is_referenced();
                self.attained = false;
                Step::Searching(Evidence::new(now, referenced))
            }
            Step::Searching(_) | Step::Ended { attained: false } if !wanted => Step::Halting { answers: 0, last: None },
            Step::Ended { attained: true } if !wanted => Step::Idle,
            step => step,
        };
    }

    /// Takes the statusword of the last answer before operation.
    pub(super) fn learnt(&mut self, word: Statusword) {
        self.keep(word);
    }

    /// Takes an answer that was sampled by the SYNC sent at `sampled`, and received at `at`. Returns why the search
    /// failed, if the answer ends the search so.
    pub(super) fn answered(
        &mut self,
        word: Statusword,
        counter: Increments,
        sampled: Instant,
        at: Instant,
    ) -> Option<SearchFailure> {
        self.keep(word);
        match &mut self.step {
            Step::Idle | Step::Preparing | Step::Ended { .. } => {}
            Step::Searching(evidence) => {
                let answer = SearchAnswer { status: HomingStatus::of(word), counter, sampled, at };
                let end = evidence.take(&answer, &self.rules, self.doubted)?;
                self.step = Step::Ended { attained: end.is_ok() };
                match end {
                    Ok(()) => (self.attained, self.doubted) = (true, false),
                    Err(failure) => {
                        // The drive may report an earlier reference, or one that its counter contradicts.
                        self.doubted |= failure != SearchFailure::Reported;
                        return Some(failure);
                    }
                }
            }
            Step::Halting { answers, last } => {
                *answers = answers.saturating_add(1);
                let before = last.replace((counter, sampled));
                // Bit 10 may be of an earlier result, while the motor moves.
                let still =
                    before.is_some_and(|(from, since)| self.rules.is_still(from, counter, sampled.since(since)));
                if *answers > ANSWERS_TO_EFFECT && word.target_reached() && still {
                    self.step = Step::Idle;
                }
            }
        }
        None
    }

    fn keep(&mut self, word: Statusword) {
        if self.kept && !word.has(Statusword::EPOS_REFERENCED) {
            self.attained = false;
        }
        self.kept = word.has(Statusword::EPOS_REFERENCED);
        self.may_set_counter =
            if self.needs_homing_mode() { ANSWERS_TO_EFFECT + 1 } else { self.may_set_counter.saturating_sub(1) };
    }

    /// Whether the drive may set its counter. A drive continues its search until the controlword that ends it takes
    /// effect. The statusword may show the end of the search before the position shows the new count.
    pub(super) fn may_set_counter(&self) -> bool {
        self.may_set_counter > 0
    }

    /// Whether the drive has reported that it searches, and not yet that its search has ended.
    pub(super) fn has_begun(&self) -> bool {
        matches!(self.step, Step::Searching(evidence) if evidence.is_searching())
    }

    /// Discards the reference because the counter may be wrong, also the reference that a search finds now.
    pub(super) fn doubt(&mut self) {
        self.doubted = true;
        if matches!(self.step, Step::Searching(_) | Step::Ended { .. }) {
            self.step = Step::Ended { attained: false };
        }
    }

    /// Discards the reference: a node that booted has lost its counter. A counter that jumped still needs a search,
    /// because a boot does not correct it.
    pub(super) fn forget(&mut self) {
        *self = Self { doubted: self.doubted, ..Self::new(self.rules) };
    }

    pub(super) fn needs_homing_mode(&self) -> bool {
        self.step != Step::Idle
    }

    pub(super) fn halting(&self) -> bool {
        matches!(self.step, Step::Halting { .. })
    }

    fn is_referenced(&self) -> bool {
        (self.attained || self.kept) && !self.doubted
    }

    /// Adds the start bit (bit 4) or the halt bit to a controlword.
    pub(super) fn controlword(&self, word: Controlword) -> Controlword {
        let started = matches!(self.step, Step::Searching(_) | Step::Ended { .. });
        word.with(Controlword::START, started).with(Controlword::HALT, self.halting())
    }

    pub(super) fn state(&self) -> Homing {
        match self.step {
            Step::Preparing | Step::Searching(_) => Homing::InProgress,
            Step::Ended { attained: true } => Homing::Attained,
            Step::Ended { attained: false } => Homing::Failed,
            Step::Idle if self.is_referenced() => Homing::Attained,
            Step::Idle | Step::Halting { .. } => Homing::NotHomed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::bench::{PERIOD, axis_config, group_config};
    use super::*;

    const SEARCHING: u16 = 0x0237;
    const INTERRUPTED: u16 = 0x0637;
    const ATTAINED: u16 = 0x1237;
    const DONE: u16 = 0x1637;
    const DONE_AND_KEPT: u16 = 0x9637;
    const FAILED: u16 = 0x2637;

    /// A search with a clock. The counter reads 700 increments at first, within the following error from zero.
    struct Timed {
        search: Search,
        now: Instant,
        /// Time of the last SYNC.
        sampled: Instant,
        counter: i32,
        failure: Option<SearchFailure>,
    }

    impl Timed {
        fn new() -> Self {
            let rules = SearchRules::new(&group_config(), &axis_config(2));
            let now = Instant::ZERO + PERIOD;
            Self { search: Search::new(rules), now, sampled: now, counter: 700, failure: None }
        }

        /// The next cycle reads an answer to the SYNC of the cycle before.
        fn answered(&mut self, word: u16) {
            self.now += PERIOD;
            let at = self.sampled + PERIOD / 2;
            let failure = self.search.answered(Statusword(word), Increments(self.counter), self.sampled, at);
            self.failure = self.failure.or(failure);
            self.sampled = self.now;
        }

        fn command(&mut self, wanted: bool, powered: bool, in_homing_mode: bool) {
            self.search.command(wanted, powered, in_homing_mode, self.now);
        }

        fn state(&self) -> Homing {
            self.search.state()
        }

        fn word(&self) -> u16 {
            self.search.controlword(Controlword::ENABLE_OPERATION).0
        }
    }

    fn searching() -> Timed {
        let mut timed = Timed::new();
        timed.command(true, true, false);
        assert_eq!(timed.state(), Homing::InProgress);
        timed.command(true, true, true);
        timed
    }

    /// A search long enough under way that its start surely shows in an answer.
    fn begun() -> Timed {
        let mut timed = searching();
        for _ in 0..ANSWERS_TO_EFFECT {
            timed.answered(SEARCHING);
        }
        timed
    }

    #[test]
    fn a_reference_in_doubt_is_no_reference_and_ends_its_search() {
        let mut timed = searching();
        for word in [SEARCHING, SEARCHING] {
            timed.answered(word);
        }
        assert!(timed.search.has_begun());
        timed.search.doubt();
        assert_eq!((timed.search.has_begun(), timed.state()), (false, Homing::Failed));
        // The drive finds a place, and keeps it.
        timed.answered(DONE_AND_KEPT);
        assert_eq!(timed.state(), Homing::Failed);
        timed.command(false, false, true);
        assert_eq!(timed.state(), Homing::NotHomed);
    }

    #[test]
    fn a_search_ends_as_the_drive_says() {
        let table: &[(&[u16], Homing)] = &[
            (&[SEARCHING], Homing::InProgress),
            (&[SEARCHING, ATTAINED], Homing::InProgress),
            (&[SEARCHING, ATTAINED, DONE], Homing::Attained),
            (&[SEARCHING, FAILED], Homing::Failed),
            (&[SEARCHING, INTERRUPTED], Homing::Failed),
            (&[SEARCHING, 0x3637], Homing::Failed),
        ];
        for (words, state) in table {
            let mut timed = begun();
            timed.counter = 0;
            words.iter().for_each(|&word| timed.answered(word));
            assert_eq!(timed.state(), *state, "{words:04X?}");
            assert_eq!(timed.word(), 0x001F);
        }
    }

    #[test]
    fn what_the_drive_said_before_it_could_begin_ends_no_search() {
        const STALE: usize = ANSWERS_TO_EFFECT as usize;
        let table: &[(&[u16], u16, Homing)] = &[
            // Statuswords left over from the previous search.
            (&[DONE; STALE], SEARCHING, Homing::InProgress),
            (&[FAILED; STALE], SEARCHING, Homing::InProgress),
            (&[DONE; 100 * STALE], DONE, Homing::InProgress),
            (&[FAILED; 100 * STALE], FAILED, Homing::InProgress),
            (&[INTERRUPTED; STALE], INTERRUPTED, Homing::InProgress),
            // Mode HM has just begun, and no search was commanded yet.
            (&[SEARCHING, INTERRUPTED], SEARCHING, Homing::InProgress),
            (&[SEARCHING, DONE, DONE, DONE, DONE, DONE], DONE, Homing::InProgress),
            // Method 37 ends before any answer shows a search.
            (&[INTERRUPTED, INTERRUPTED, DONE, DONE, DONE, DONE, DONE, DONE], DONE, Homing::Attained),
        ];
        for (words, last, state) in table {
            let mut timed = searching();
            for &word in *words {
                timed.answered(word);
                assert_eq!(timed.state(), Homing::InProgress, "{words:04X?}");
            }
            timed.answered(*last);
            assert_eq!(timed.state(), *state, "{words:04X?} {last:04X}");
        }
    }

    #[test]
    fn a_drive_that_never_searches_keeps_no_result() {
        for word in [DONE, FAILED, INTERRUPTED] {
            let mut timed = searching();
            for _ in 0..600 {
                timed.answered(word);
            }
            assert_eq!(timed.state(), Homing::Failed, "{word:04X}");
            assert!(matches!(timed.failure, Some(SearchFailure::NotSeen { .. })), "{word:04X}");
        }
    }

    #[test]
    fn leaving_an_unfinished_search_halts_the_drive_before_the_mode_changes() {
        let mut timed = searching();
        timed.answered(SEARCHING);
        timed.command(false, true, true);
        assert_eq!(timed.word(), 0x010F);
        for _ in 0..10 {
            timed.answered(SEARCHING);
            assert!(timed.search.needs_homing_mode());
        }
        timed.answered(INTERRUPTED);
        assert!(!timed.search.needs_homing_mode());
        assert_eq!((timed.word(), timed.state()), (0x000F, Homing::NotHomed));
    }

    #[test]
    fn an_old_result_does_not_end_the_halt_of_a_motor_that_moves() {
        let mut timed = begun();
        timed.command(false, true, true);
        for _ in 0..10 {
            timed.counter += 20;
            timed.answered(DONE);
            assert!(timed.search.needs_homing_mode());
        }
        timed.answered(DONE);
        assert!(!timed.search.needs_homing_mode());
    }

    #[test]
    fn a_loss_of_power_ends_the_search() {
        let mut timed = searching();
        timed.command(true, false, true);
        assert_eq!((timed.search.needs_homing_mode(), timed.state()), (false, Homing::NotHomed));
    }

    #[test]
    fn the_reference_outlives_the_search_until_the_drive_drops_it() {
        let mut timed = begun();
        timed.counter = 0;
        timed.answered(DONE_AND_KEPT);
        timed.command(false, true, true);
        assert_eq!((timed.search.needs_homing_mode(), timed.state()), (false, Homing::Attained));
        timed.answered(0x8637);
        assert_eq!(timed.state(), Homing::Attained);
        timed.answered(0x0637);
        assert_eq!(timed.state(), Homing::NotHomed);
    }

    #[test]
    fn a_drive_without_bit_15_keeps_the_reference_of_this_run() {
        let mut timed = begun();
        timed.counter = 0;
        timed.answered(DONE);
        timed.command(false, true, true);
        timed.answered(0x0637);
        assert_eq!(timed.state(), Homing::Attained);
        timed.search.forget();
        assert_eq!(timed.state(), Homing::NotHomed);
    }
}
