//! True age of the answers of one drive, in periods.
//!
//! TPDO 1 has no number. An answer that comes `n` periods late is otherwise taken for the answer to a later SYNC, and its
//! latency is known modulo the period alone.
//!
//! - Bring-up measures the latency of a SYNC that stands alone, which gives the first [`lag`](AnswerAge::lag).
//! - In operation, the SYNCs without an answer, minus the answers, are the balance. A lag begins with missing answers, and
//!   the balance keeps them after the answers have come back. A lost answer has the same effect, so the balance alone proves
//!   nothing.
//! - A SYNC that is left out decides: its answer is missing in the same period, or `n` periods later if all answers are `n`
//!   periods late.
//!
//! Answers that are late once and come in a burst take the balance back, so that no SYNC is left out for them.
//!
//! # What is not seen
//! - Set-points that come late while SYNC and answers do not.
//! - Lag that begins without a missing answer: an answer is replaced by an earlier one, or another sender fills the gap.
//! - The balance cannot tell the end of a lag from surplus answers. The smaller lag holds until the next SYNC that is left
//!   out.

/// Periods between the beginning of operation and the first balance, beyond the lag.
const SETTLING: u32 = 2;

/// The time from one batch of the host to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Slot {
    /// The batch began with a SYNC.
    synced: bool,
    /// The SYNC was left out to prove the age of the answers.
    proves: bool,
    answers: u32,
}

/// What the answers of a period show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finding {
    /// A SYNC that was left out proves this lag, periods.
    Proven(u32),
    /// Answers without a SYNC.
    Surplus(u32),
}

/// Age of the answers of one drive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AnswerAge {
    lag: u32,
    /// SYNCs minus answers. Equal to the lag if no answer was lost and none was surplus.
    balance: i64,
    /// The lag was reduced without a proof.
    reduced: bool,
    /// Periods until the balance counts.
    settling: u32,
    /// The present period, and the one before. Answers of the latter may still be unread.
    present: Slot,
    before: Slot,
    /// Periods since the SYNC that was left out, all of them with an answer.
    proof: Option<u32>,
}

impl AnswerAge {
    /// Answers that are all late by `lag` periods.
    pub(super) fn of(lag: u32) -> Self {
        Self { lag, balance: i64::from(lag), settling: lag.saturating_add(SETTLING), ..Self::default() }
    }

    /// Answers of unknown age, which the next SYNC that is left out proves.
    pub(super) fn unknown() -> Self {
        Self { reduced: true, settling: SETTLING, ..Self::default() }
    }

    /// Periods by which the answers come later than in the period of their SYNC.
    pub(super) fn lag(&self) -> u32 {
        self.lag
    }

    /// Counts an answer, of the present period or of an earlier one.
    pub(super) fn count(&mut self, present: bool) {
        let slot = if present { &mut self.present } else { &mut self.before };
        slot.answers = slot.answers.saturating_add(1);
    }

    /// Whether only a SYNC that is left out gives the age: answers were missing, and have come back.
    pub(super) fn is_doubtful(&self) -> bool {
        let owed = self.balance + self.before.owed() + self.present.owed();
        let answered = self.before.answers > 0 && self.present.answers > 0;
        answered && self.settling == 0 && self.proof.is_none() && (self.reduced || owed > i64::from(self.lag))
    }

    /// Begins a period. `synced` says that its batch has a SYNC, and `proves` that the SYNC was left out for a proof. A gap
    /// is looked for in at most `longest` periods.
    pub(super) fn begin_period(&mut self, synced: bool, proves: bool, longest: u32) -> Option<Finding> {
        let closed = std::mem::replace(&mut self.before, self.present);
        self.present = Slot { synced, proves, answers: 0 };
        if let Some(left) = self.settling.checked_sub(1) {
            (self.settling, self.balance) = (left, i64::from(self.lag));
            return None;
        }
        if closed.proves {
            self.proof = Some(0);
        }
        if let Some(periods) = self.proof {
            return self.look_for_gap(closed, periods, longest);
        }
        self.balance += closed.owed();
        let lag = i64::from(self.lag);
        if self.balance >= lag {
            return None;
        }
        let surplus = u32::try_from(-self.balance).unwrap_or(0);
        self.balance = self.balance.max(0);
        self.reduced |= self.lag > 0;
        self.lag = u32::try_from(self.balance).unwrap_or(self.lag);
        (surplus > 0).then_some(Finding::Surplus(surplus))
    }

    fn look_for_gap(&mut self, closed: Slot, periods: u32, longest: u32) -> Option<Finding> {
        if closed.answers == 0 {
            (self.lag, self.proof, self.reduced) = (periods, None, false);
            self.balance = i64::from(periods);
            return Some(Finding::Proven(periods));
        }
        self.proof = (periods < longest).then_some(periods + 1);
        if self.proof.is_none() {
            // Another sender fills the gap.
            (self.balance, self.reduced) = (i64::from(self.lag), false);
        }
        None
    }
}

impl Slot {
    fn owed(self) -> i64 {
        i64::from(self.synced) - i64::from(self.answers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONGEST: u32 = 6;

    /// Plays periods with these numbers of answers. A SYNC is left out `left_out` periods after the first doubt, if given.
    /// Returns the findings, with the number of the period, and the final age.
    fn play(
        mut age: AnswerAge,
        answers: impl Fn(u32, &[u32]) -> u32,
        periods: u32,
    ) -> (Vec<(u32, Finding)>, AnswerAge) {
        let (mut findings, mut left_out) = (Vec::new(), Vec::new());
        for period in 0..periods {
            let proves = left_out.is_empty() && age.is_doubtful();
            left_out.extend(proves.then_some(period));
            findings.extend(age.begin_period(!proves, proves, LONGEST).map(|finding| (period, finding)));
            (0..answers(period, &left_out)).for_each(|_| age.count(true));
        }
        (findings, age)
    }

    /// Number of answers of a drive whose answers are `lag` periods late from period 20 on.
    fn late(lag: u32) -> impl Fn(u32, &[u32]) -> u32 {
        move |period, left_out| {
            let lag = if period < 20 { 0 } else { lag };
            let of_sync = period >= 20 + lag || period < 20;
            u32::from(of_sync && !left_out.contains(&period.wrapping_sub(lag)))
        }
    }

    #[test]
    fn a_lag_that_begins_in_operation_is_proven_by_a_sync_that_is_left_out() {
        for lag in 1..=LONGEST {
            let (findings, age) = play(AnswerAge::of(0), late(lag), 100);
            // Two answers end the doubt, and the gap is read two periods after it.
            assert_eq!(findings, [(20 + 2 * lag + 4, Finding::Proven(lag))], "lag {lag}");
            assert_eq!((age.lag(), age.is_doubtful()), (lag, false));
        }
    }

    #[test]
    fn a_lost_answer_is_no_lag() {
        for lost in 1..=4 {
            let answers = |period: u32, left_out: &[u32]| {
                u32::from(!(20..20 + lost).contains(&period) && !left_out.contains(&period))
            };
            let (findings, age) = play(AnswerAge::of(0), answers, 100);
            assert_eq!(findings, [(20 + lost + 4, Finding::Proven(0))], "{lost} lost");
            assert_eq!((age.lag(), age.is_doubtful()), (0, false));
        }
    }

    #[test]
    fn answers_in_a_burst_and_in_the_next_period_raise_no_doubt() {
        let burst = |period: u32, _: &[u32]| match period {
            20..23 => 0,
            23 => 4,
            _ => 1,
        };
        let swapped = |period: u32, _: &[u32]| if period < 20 { 1 } else { period % 2 * 2 };
        for (findings, age) in [play(AnswerAge::of(0), burst, 100), play(AnswerAge::of(0), swapped, 100)] {
            assert_eq!((findings, age.lag(), age.is_doubtful()), (vec![], 0, false));
        }
    }

    #[test]
    fn a_lag_from_bring_up_is_kept_and_its_end_reduces_it() {
        let from_start = |period: u32, _: &[u32]| u32::from(period >= 3);
        let (findings, age) = play(AnswerAge::of(3), from_start, 100);
        assert_eq!((findings, age.lag(), age.is_doubtful()), (vec![], 3, false));
        let ends = |period: u32, left_out: &[u32]| match period {
            0..3 => 0,
            50 => 4,
            _ => u32::from(!left_out.contains(&period)),
        };
        let (findings, age) = play(AnswerAge::of(3), ends, 100);
        assert_eq!((findings, age.lag()), (vec![(55, Finding::Proven(0))], 0));
    }

    #[test]
    fn surplus_answers_are_counted_and_a_second_sender_proves_nothing() {
        let twice = |period: u32, _: &[u32]| 1 + u32::from(period == 20);
        let (findings, age) = play(AnswerAge::of(0), twice, 40);
        assert_eq!((findings, age.lag(), age.is_doubtful()), (vec![(22, Finding::Surplus(1))], 0, false));
        // An answer is lost, and another sender sends one in each period from then on.
        let filled = |period: u32, left_out: &[u32]| match period {
            20 => 0,
            _ => 1 + u32::from(period > 20 && !left_out.contains(&period)),
        };
        let (findings, age) = play(AnswerAge::of(0), filled, 40);
        assert!(findings.iter().all(|(_, finding)| matches!(finding, Finding::Surplus(_))), "{findings:?}");
        assert_eq!(age.lag(), 0);
    }

    #[test]
    fn an_unknown_age_is_proven_as_soon_as_answers_come() {
        let answers = |period: u32, left_out: &[u32]| u32::from(!left_out.contains(&period));
        let (findings, age) = play(AnswerAge::unknown(), answers, 20);
        assert!(matches!(findings[..], [(_, Finding::Proven(0))]), "{findings:?}");
        assert!(!age.is_doubtful());
    }
}
