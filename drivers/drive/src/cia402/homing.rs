//! Homing of one CiA 402 drive (CiA 402-2 §11).

use canopen::cia402::{Controlword, HomingStatus, Statusword};

use super::axis::ANSWERS_TO_EFFECT;
use crate::Homing;

/// State machine of one axis's homing, and whether the axis has a reference.
///
/// ```text
///         wanted            0x6061 is HM           bits 10, 12, 13
///   Idle ────────► Preparing ─────────► Searching ────────────────► Ended
///    ▲               │ left               │ left                      │ left
///    ├───────────────┘                    ▼                           │
///    ├◄──────────── stands ─────────── Halting ◄──── failed ──────────┤
///    └◄──────────────────────────────── attained ─────────────────────┘
/// ```
///
/// A loss of power ends every search at once. The mode of operation is HM from Preparing to Halting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Search {
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
    /// Controlword bit 4 is set. `begun`: the drive has reported that it searches.
    Searching { answers: u32, begun: bool },
    /// The search has ended, with or without a reference.
    Ended { attained: bool },
    /// Controlword bit 4 is clear and the halt bit is set.
    Halting { answers: u32 },
}

impl Search {
    /// Advances once a cycle. `wanted` is the commanded state; the other arguments are the state of the drive.
    pub(super) fn command(&mut self, wanted: bool, powered: bool, in_homing_mode: bool) {
        self.step = match self.step {
            _ if !powered => Step::Idle,
            Step::Idle if wanted => Step::Preparing,
            Step::Preparing if !wanted => Step::Idle,
            Step::Preparing if in_homing_mode => {
                self.attained = false;
                Step::Searching { answers: 0, begun: false }
            }
            Step::Searching { .. } | Step::Ended { attained: false } if !wanted => Step::Halting { answers: 0 },
            Step::Ended { attained: true } if !wanted => Step::Idle,
            step => step,
        };
    }

    /// Takes the statusword of an answer.
    ///
    /// Bits 10, 12 and 13 may still be the result of the previous search. An end of this search is therefore accepted
    /// only after the drive was seen searching, or had time to begin. A drive that has not yet started may seem to
    /// search until it stands, and then to be interrupted. An interruption is therefore accepted only once the drive
    /// had time to begin.
    pub(super) fn answered(&mut self, word: Statusword) {
        if self.kept && !word.has(Statusword::EPOS_REFERENCED) {
            self.attained = false;
        }
        self.kept = word.has(Statusword::EPOS_REFERENCED);
        self.may_set_counter =
            if self.needs_homing_mode() { ANSWERS_TO_EFFECT + 1 } else { self.may_set_counter.saturating_sub(1) };
        match &mut self.step {
            Step::Idle | Step::Preparing | Step::Ended { .. } => {}
            Step::Searching { answers, begun } => {
                *answers = answers.saturating_add(1);
                let had_time = *answers > ANSWERS_TO_EFFECT;
                let timely = *begun || had_time;
                let attained = match HomingStatus::of(word) {
                    HomingStatus::InProgress => {
                        *begun = true;
                        None
                    }
                    HomingStatus::Attained => None,
                    HomingStatus::Done => timely.then_some(true),
                    HomingStatus::Interrupted => (*begun && had_time).then_some(false),
                    HomingStatus::ErrorMoving | HomingStatus::ErrorStanding | HomingStatus::Reserved => {
                        timely.then_some(false)
                    }
                };
                if let Some(attained) = attained {
                    self.step = Step::Ended { attained };
                    if attained {
                        (self.attained, self.doubted) = (true, false);
                    }
                }
            }
            Step::Halting { answers } => {
                *answers = answers.saturating_add(1);
                if *answers > ANSWERS_TO_EFFECT && word.target_reached() {
                    self.step = Step::Idle;
                }
            }
        }
    }

    /// Whether the drive may set its counter. A drive continues its search until the controlword that ends it takes
    /// effect. The statusword may show the end of the search before the position shows the new count.
    pub(super) fn may_set_counter(&self) -> bool {
        self.may_set_counter > 0
    }

    /// Whether the drive has reported that it searches, and not yet that its search has ended.
    pub(super) fn has_begun(&self) -> bool {
        matches!(self.step, Step::Searching { begun: true, .. })
    }

    /// Discards the reference because the counter may be wrong, also the reference that a search finds now.
    pub(super) fn doubt(&mut self) {
        self.doubted = true;
        if matches!(self.step, Step::Searching { .. } | Step::Ended { .. }) {
            self.step = Step::Ended { attained: false };
        }
    }

    /// Discards the reference: a node that booted has lost its counter. A counter that jumped still needs a search,
    /// because a boot does not correct it.
    pub(super) fn forget(&mut self) {
        *self = Self { doubted: self.doubted, ..Self::default() };
    }

    pub(super) fn needs_homing_mode(&self) -> bool {
        self.step != Step::Idle
    }

    pub(super) fn halting(&self) -> bool {
        matches!(self.step, Step::Halting { .. })
    }

    /// Adds the start bit (bit 4) or the halt bit to a controlword.
    pub(super) fn controlword(&self, word: Controlword) -> Controlword {
        let started = matches!(self.step, Step::Searching { .. } | Step::Ended { .. });
        word.with(Controlword::START, started).with(Controlword::HALT, self.halting())
    }

    pub(super) fn state(&self) -> Homing {
        match self.step {
            Step::Preparing | Step::Searching { .. } => Homing::InProgress,
            Step::Ended { attained: true } => Homing::Attained,
            Step::Ended { attained: false } => Homing::Failed,
            Step::Idle if (self.attained || self.kept) && !self.doubted => Homing::Attained,
            Step::Idle | Step::Halting { .. } => Homing::NotHomed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEARCHING: u16 = 0x0237;
    const INTERRUPTED: u16 = 0x0637;
    const ATTAINED: u16 = 0x1237;
    const DONE: u16 = 0x1637;
    const DONE_AND_KEPT: u16 = 0x9637;
    const FAILED: u16 = 0x2637;

    fn searching() -> Search {
        let mut search = Search::default();
        search.command(true, true, false);
        assert_eq!(search.state(), Homing::InProgress);
        search.command(true, true, true);
        search
    }

    fn word(search: &Search) -> u16 {
        search.controlword(Controlword::ENABLE_OPERATION).0
    }

    /// A search long enough under way that its start surely shows in an answer.
    fn begun() -> Search {
        let mut search = searching();
        for _ in 0..ANSWERS_TO_EFFECT {
            search.answered(Statusword(SEARCHING));
        }
        search
    }

    #[test]
    fn a_reference_in_doubt_is_no_reference_and_ends_its_search() {
        let mut search = searching();
        for word in [SEARCHING, SEARCHING] {
            search.answered(Statusword(word));
        }
        assert!(search.has_begun());
        search.doubt();
        assert_eq!((search.has_begun(), search.state()), (false, Homing::Failed));
        // The drive finds a place, and keeps it.
        search.answered(Statusword(DONE_AND_KEPT));
        assert_eq!(search.state(), Homing::Failed);
        search.command(false, false, true);
        assert_eq!(search.state(), Homing::NotHomed);
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
            let mut search = begun();
            words.iter().for_each(|&word| search.answered(Statusword(word)));
            assert_eq!(search.state(), *state, "{words:04X?}");
            assert_eq!(word(&search), 0x001F);
        }
    }

    #[test]
    fn what_the_drive_said_before_it_could_begin_ends_no_search() {
        const STALE: usize = ANSWERS_TO_EFFECT as usize;
        let table: &[(&[u16], u16, Homing)] = &[
            // Statuswords left over from the previous search.
            (&[DONE; STALE], SEARCHING, Homing::InProgress),
            (&[FAILED; STALE], SEARCHING, Homing::InProgress),
            (&[INTERRUPTED; STALE], INTERRUPTED, Homing::InProgress),
            // Mode HM has just begun, and no search was commanded yet.
            (&[SEARCHING, INTERRUPTED], SEARCHING, Homing::InProgress),
            // Method 37 ends before any answer shows a search.
            (&[INTERRUPTED, INTERRUPTED, DONE, DONE], DONE, Homing::Attained),
        ];
        for (words, last, state) in table {
            let mut search = searching();
            for &word in *words {
                search.answered(Statusword(word));
                assert_eq!(search.state(), Homing::InProgress, "{words:04X?}");
            }
            search.answered(Statusword(*last));
            assert_eq!(search.state(), *state, "{words:04X?} {last:04X}");
        }
    }

    #[test]
    fn leaving_an_unfinished_search_halts_the_drive_before_the_mode_changes() {
        let mut search = searching();
        search.answered(Statusword(SEARCHING));
        search.command(false, true, true);
        assert_eq!(word(&search), 0x010F);
        for _ in 0..10 {
            search.answered(Statusword(SEARCHING));
            assert!(search.needs_homing_mode());
        }
        search.answered(Statusword(INTERRUPTED));
        assert!(!search.needs_homing_mode());
        assert_eq!((word(&search), search.state()), (0x000F, Homing::NotHomed));
    }

    #[test]
    fn a_loss_of_power_ends_the_search() {
        let mut search = searching();
        search.command(true, false, true);
        assert_eq!((search.needs_homing_mode(), search.state()), (false, Homing::NotHomed));
    }

    #[test]
    fn the_reference_outlives_the_search_until_the_drive_drops_it() {
        let mut search = searching();
        search.answered(Statusword(SEARCHING));
        search.answered(Statusword(DONE_AND_KEPT));
        search.command(false, true, true);
        assert_eq!((search.needs_homing_mode(), search.state()), (false, Homing::Attained));
        search.answered(Statusword(0x8637));
        assert_eq!(search.state(), Homing::Attained);
        search.answered(Statusword(0x0637));
        assert_eq!(search.state(), Homing::NotHomed);
    }

    #[test]
    fn a_drive_without_bit_15_keeps_the_reference_of_this_run() {
        let mut search = searching();
        search.answered(Statusword(SEARCHING));
        search.answered(Statusword(DONE));
        search.command(false, true, true);
        search.answered(Statusword(0x0637));
        assert_eq!(search.state(), Homing::Attained);
        search.forget();
        assert_eq!(search.state(), Homing::NotHomed);
    }
}
