//! The measuring threads: the servo's wait without a servo, and cyclictest's algorithm.

use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::clock::{now, sleep_until};
use servo::Histogram;
use servo::thread::{self, Cause, Denial, RealtimePolicy, Usage, Wait, Waiter};

/// Bytes of the thread's stack.
const STACK: usize = 512 * 1024;

/// Late cycles that are kept one by one.
pub(crate) const WORST: usize = 5;

/// Wake-ups of one probe.
pub(crate) struct Wakeups {
    /// From the deadline to when the thread was there.
    pub late: Histogram,
    /// Deadlines that passed while the thread was late for one before.
    pub missed: u64,
    /// How many were more than a hundredth of the period late, by [`Cause::ALL`].
    pub causes: [u64; Cause::ALL.len()],
    /// The latest, the worst first; of no cause where there were fewer.
    pub worst: [(Duration, Option<Cause>); WORST],
}

impl Wakeups {
    pub(crate) fn new() -> Self {
        Self {
            late: Histogram::new(),
            missed: 0,
            causes: Default::default(),
            worst: Default::default(),
        }
    }

    fn attribute(&mut self, late: Duration, cause: Cause) {
        let index = Cause::ALL.iter().position(|one| *one == cause);
        self.causes[index.expect("all causes are among them")] += 1;
        if let Some(place) = self.worst.iter().position(|worst| late > worst.0) {
            self.worst[place..].rotate_right(1);
            self.worst[place] = (late, Some(cause));
        }
    }
}

/// Waits for deadlines for `time` as the servo thread does.
pub(crate) fn wait(waiter: &mut Waiter, wakeups: &mut Wakeups, period: Duration, time: Duration) {
    let mut ended = now();
    let (mut due, end) = (ended + period, ended + time);
    let mut counted = Usage::of_this_thread();
    waiter.pause();
    while due <= end {
        let awake = waiter.wait(due, Duration::ZERO);
        let late = awake.at.since(due);
        wakeups.late.record(late);
        let usage = Usage::of_this_thread();
        if late > period / 100 {
            let worked = awake.asked_at.since(ended);
            let cause = Cause::of(late, worked, &awake, usage.since(counted));
            wakeups.attribute(late, cause);
        }
        (ended, counted) = (awake.at, usage);
        due += period;
        while due <= ended {
            due += period;
            wakeups.missed += 1;
        }
    }
}

/// Waits for deadlines for `time` as cyclictest does: an absolute sleep, one read of the clock, and the next deadline
/// that has not passed.
pub(crate) fn probe(wakeups: &mut Wakeups, period: Duration, time: Duration) {
    let start = now();
    let (mut next, end) = (start + period, start + time);
    while next <= end {
        sleep_until(next);
        let woken = now();
        wakeups.late.record(woken.since(next));
        next += period;
        while next <= woken {
            next += period;
            wakeups.missed += 1;
        }
    }
}

/// Runs `body` on a thread of its own with what `policy` asks for; returns what the host denied as well.
pub(crate) fn on_thread<T: Send>(
    policy: &RealtimePolicy,
    body: impl FnOnce() -> T + Send,
) -> anyhow::Result<(T, Vec<Denial>)> {
    std::thread::scope(|scope| {
        let thread = Builder::new()
            .name("jitter".into())
            .stack_size(STACK)
            .spawn_scoped(scope, || {
                let denied = thread::demand(policy);
                (body(), denied)
            })
            .context("no thread to measure on can be made")?;
        thread
            .join()
            .map_err(|_| anyhow!("the measuring thread panicked"))
    })
}

/// The wait of the command line, for `period`.
pub(crate) fn waiter(hybrid: bool, period: Duration) -> Waiter {
    Waiter::new(if hybrid { Wait::HYBRID } else { Wait::Plain }, period)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_deadline_is_met_or_counted() {
        let period = Duration::from_micros(500);
        for probe in [
            |wakeups: &mut Wakeups, period, time| {
                wait(&mut waiter(true, period), wakeups, period, time);
            },
            probe,
        ] {
            let mut wakeups = Wakeups::new();
            probe(&mut wakeups, period, 100 * period);
            let counted = wakeups.late.count() + wakeups.missed;
            // The last may be met so late that others have passed by then.
            assert!(counted >= 100, "{counted}");
            assert!(counted == 100 || wakeups.late.max() >= period);
        }
    }

    #[test]
    fn the_worst_are_kept_in_order() {
        let mut wakeups = Wakeups::new();
        for micros in [3, 9, 1, 7, 8, 2, 9] {
            wakeups.attribute(Duration::from_micros(micros), Cause::Host);
        }
        let kept = wakeups.worst.map(|worst| worst.0.as_micros());
        assert_eq!(kept, [9, 9, 8, 7, 3]);
        assert_eq!(wakeups.causes.iter().sum::<u64>(), 7);
    }
}
