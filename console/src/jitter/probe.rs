//! The measuring threads: the servo's wait without a servo, and cyclictest's algorithm.

use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::clock::{now, sleep_until};
use servo::Histogram;
use servo::thread::{
    self, Cause, Denial, LateCycle, LateCycles, RealtimePolicy, Usage, Wait, Waiter,
};

/// Bytes of the thread's stack.
const STACK: usize = 512 * 1024;

/// Wake-ups of one probe.
pub(crate) struct Wakeups {
    /// From the deadline to when the thread was there.
    pub late: Histogram,
    /// Deadlines that passed while the thread was late for one before.
    pub missed: u64,
    /// Those that were more than a hundredth of the period late.
    pub causes: LateCycles,
}

impl Wakeups {
    pub(crate) fn new() -> Self {
        Self {
            late: Histogram::new(),
            missed: 0,
            causes: LateCycles::default(),
        }
    }
}

/// Waits for deadlines for `time` as the servo thread does.
pub(crate) fn wait(waiter: &mut Waiter, wakeups: &mut Wakeups, period: Duration, time: Duration) {
    let began = now();
    let (mut ended, mut due, end) = (began, began + period, began + time);
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
            wakeups.causes.record(LateCycle {
                cycle: wakeups.late.count() - 1,
                due: due.since(began),
                late,
                cause,
            });
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
}
