//! Why a cycle was late, or slots were let go before it.

use std::time::Duration;

use can::Instant;

use super::{Awake, Cause, LateCycle, Run, Spent};

/// Share of the period, as a divisor, by which a SYNC may leave late without a question why.
pub(super) const LATE: u32 = 100;

/// Time between two reads of the clock in a spin from which on somebody took the CPU.
pub const GAP: Duration = Duration::from_micros(5);

/// What the cycle before leaves to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Before {
    /// When its SYNC was handed over, when that was done, and when all else was and the caller was called.
    pub sync: Instant,
    pub done: Instant,
    pub called: Instant,
    /// How late that was, zero if it was punctual.
    pub late: Duration,
}

impl Run {
    /// Attributes the cycle's lateness, and that of the slots let go before it. The kernel is asked only if something
    /// was out of the ordinary. Returns the worse of them.
    pub(super) fn explain(
        &mut self,
        late: Duration,
        spent: &Spent,
        step: Duration,
    ) -> Option<LateCycle> {
        let is_late = late > self.period / LATE;
        let long = step > self.usual.get();
        self.usual.observe(step);
        let skipped = self.skipped.take();
        self.before.late = Duration::ZERO;
        if !is_late && !long && spent.gap <= GAP && skipped.is_none() {
            self.account.pass(spent.wake_up);
            return None;
        }
        let latest = skipped.map_or(late, |(before, _)| before.max(late));
        let counted = self.account.settle(latest);
        let mut worse = None;
        for (late, spent) in skipped.iter().chain(is_late.then_some(&(late, *spent))) {
            let of_cycle = LateCycle {
                cycle: self.number,
                due: self.deadline.since(self.first),
                late: *late,
                cause: Cause::of_cycle(*late, spent, counted),
            };
            self.timing.late.record(of_cycle);
            self.before.late = *late;
            if worse.is_none_or(|worse: LateCycle| of_cycle.late > worse.late) {
                worse = Some(of_cycle);
            }
        }
        worse
    }

    /// Where the time went up to the end of a wait, of a cycle that `begun` then. What is left of the delay that let a slot go is of that: without
    /// a sleep of its own the time since the SYNC before has been told of.
    pub(super) fn waited(&self, begun: Instant, awake: &Awake) -> Spent {
        let Before {
            sync, done, called, ..
        } = self.before;
        let before = Spent {
            own: called.since(done) + awake.asked_at.since(begun),
            bus: done.since(sync),
            between: begun.since(called),
            ..Spent::default()
        };
        match self.skipped {
            Some((_, spent)) if awake.wake_up_latency().is_none() => spent,
            _ => Spent::waiting(awake, before),
        }
    }
}
