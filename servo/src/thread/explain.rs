//! Causes of late cycles and skipped slots.

use std::time::Duration;

use can::Instant;

use super::{Awake, Cause, LateCycle, Run, Spent};

/// A SYNC that leaves late by more than this fraction of the period, given as a divisor, is explained.
pub(super) const LATE: u32 = 100;

/// Shortest time between two reads of the clock in a spin that counts as a loss of the CPU.
pub const GAP: Duration = Duration::from_micros(5);

/// Data of the last cycle for the next one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Before {
    /// Time at which SYNC was sent, time at which sending had ended, and time at which the caller got the thread.
    pub sync: Instant,
    pub done: Instant,
    pub called: Instant,
    /// Lateness of the last cycle; zero if punctual.
    pub late: Duration,
}

impl Run {
    /// Finds the causes of a late cycle and of the slots skipped before it. The kernel's counts are read only after
    /// something unusual. Returns the one with the greater lateness.
    pub(super) fn explain(&mut self, late: Duration, spent: &Spent, step: Duration) -> Option<LateCycle> {
        let is_late = late > self.period / LATE;
        let long = step > self.usual.get();
        self.usual.observe(step);
        let skipped = self.skipped.take();
        self.before.late = Duration::ZERO;
        if !is_late && !long && spent.gap <= GAP && skipped.is_none() {
            self.account.pass(spent.wake_up);
            return None;
        }
        let counted = self.account.settle(skipped.map_or(late, |(before, _)| before.max(late)));
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

    /// Use of the time up to the end of a wait. `begun` is the time at which the caller was done. A wait without a
    /// sleep after skipped slots belongs to their delay, because the time since the previous SYNC is already explained.
    pub(super) fn waited(&self, begun: Instant, awake: &Awake) -> Spent {
        let Before { sync, done, called, .. } = self.before;
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
