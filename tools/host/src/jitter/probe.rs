//! The measuring threads: the wait of the servo thread without a servo, and the algorithm of cyclictest.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::clock::{now, sleep_until};
use servo::thread::{
    self, Account, Cause, Denial, GAP, LateCycle, LateCycles, Realtime, Spent, Stamps, Tracer, Waiter,
};

use super::interval::Recorder;

/// Stack of the thread, bytes.
const STACK: usize = 512 * 1024;

/// Time between two readings of the intermediate results.
pub(super) const LOOK: Duration = Duration::from_millis(20);

/// End of a turn.
#[derive(Clone, Copy)]
pub(super) struct Turn<'a> {
    pub period: Duration,
    pub time: Duration,
    /// Flag that ends the turn early.
    pub over: &'a Arc<AtomicBool>,
}

impl Turn<'_> {
    pub(super) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }
}

/// Measurements of the wake-ups of one probe.
pub(super) struct Wakeups {
    /// Number of wake-ups.
    cycles: u64,
    /// Time from the deadline to the wake-up of the thread.
    pub late: Recorder,
    /// Deadlines that passed while the thread was late for an earlier one.
    pub missed: u64,
    /// Wake-ups that were late by more than a hundredth of the period.
    pub causes: LateCycles,
    /// The wake-ups around the latest ones.
    pub spikes: Tracer,
}

impl Wakeups {
    pub(super) fn new(late: Recorder) -> Self {
        Self { cycles: 0, late, missed: 0, causes: LateCycles::default(), spikes: Tracer::new(Arc::default()) }
    }
}

/// Waits for deadlines as the servo thread does.
pub(super) fn wait(waiter: &mut Waiter, wakeups: &mut Wakeups, turn: Turn) {
    let began = now();
    let (mut ended, mut due, end) = (began, began + turn.period, began + turn.time);
    let mut account = Account::open();
    waiter.pause();
    wakeups.spikes.pause();
    wakeups.late.begin(ended);
    while due <= end && !turn.is_over() {
        let awake = waiter.wait(due, Duration::ZERO);
        let late = awake.at.since(due);
        wakeups.late.record(late, awake.at);
        let before = Spent { own: awake.asked_at.since(ended), ..Spent::default() };
        let spent = Spent::waiting(&awake, before);
        let is_late = late > turn.period / 100;
        let counted = if is_late || awake.gap > GAP {
            Some(account.settle(late))
        } else {
            account.pass(spent.wake_up);
            None
        };
        let of_cycle = counted.filter(|_| is_late).map(|counted| LateCycle {
            cycle: wakeups.cycles,
            due: due.since(began),
            late,
            cause: Cause::of_cycle(late, &spent, counted),
        });
        of_cycle.into_iter().for_each(|late| wakeups.causes.record(late));
        wakeups.spikes.record(Stamps::of_wait(wakeups.cycles, due, awake, of_cycle));
        ended = awake.at;
        wakeups.cycles += 1;
        due += turn.period;
        while due <= ended {
            due += turn.period;
            wakeups.missed += 1;
        }
    }
}

/// Waits for deadlines as cyclictest does: an absolute sleep, one reading of the clock, then the next deadline that has
/// not passed.
pub(super) fn probe(wakeups: &mut Wakeups, turn: Turn) {
    let start = now();
    let (mut next, end) = (start + turn.period, start + turn.time);
    wakeups.late.begin(start);
    while next <= end && !turn.is_over() {
        sleep_until(next);
        let woken = now();
        wakeups.late.record(woken.since(next), woken);
        next += turn.period;
        while next <= woken {
            next += turn.period;
            wakeups.missed += 1;
        }
    }
}

/// Runs `body` on a new thread under `realtime`, and calls `meanwhile` on this thread repeatedly. Returns what the host
/// denied.
pub(super) fn on_thread(
    realtime: &Realtime,
    period: Duration,
    body: impl FnOnce() + Send,
    mut meanwhile: impl FnMut(),
) -> anyhow::Result<Vec<Denial>> {
    std::thread::scope(|scope| {
        let thread = Builder::new()
            .name("jitter".into())
            .stack_size(STACK)
            .spawn_scoped(scope, || {
                let denied = thread::demand(realtime, period);
                body();
                denied
            })
            .context("no thread to measure on can be made")?;
        while !thread.is_finished() {
            meanwhile();
            sleep_until(now() + LOOK);
        }
        thread.join().map_err(|_| anyhow!("the measuring thread panicked"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jitter::interval::recording;

    #[test]
    fn every_deadline_is_met_or_counted() {
        let over = Arc::default();
        let turn = Turn { period: Duration::from_micros(500), time: Duration::from_millis(50), over: &over };
        for probe in [
            |wakeups: &mut Wakeups, turn: Turn| {
                wait(&mut Waiter::new(&Realtime::default(), turn.period), wakeups, turn);
            },
            probe,
        ] {
            let (recorder, mut ledger) = recording(now(), None);
            let mut wakeups = Wakeups::new(recorder);
            probe(&mut wakeups, turn);
            wakeups.late.hand_over();
            ledger.drain().unwrap();
            let counted = ledger.total.len() + wakeups.missed;
            // The last wake-up may be so late that further deadlines have passed.
            assert!(counted >= 100, "{counted}");
            assert!(counted == 100 || ledger.total.max() >= 500_000);
        }
    }

    /// A thread of higher priority takes the CPU of a measuring thread for longer than a period, every 20 ms.
    fn starved() -> Vec<LateCycle> {
        let over = Arc::default();
        let turn = Turn { period: Duration::from_millis(1), time: Duration::from_millis(400), over: &over };
        let realtime = |priority| Realtime { priority, cpu: Some(0), lock_memory: false, ..Realtime::PLAIN };
        let end = now() + turn.time;
        let hog = std::thread::spawn(move || {
            let denied = thread::demand(&realtime(90), turn.period);
            while now() < end {
                sleep_until(now() + Duration::from_millis(20));
                let over = now() + Duration::from_micros(1500);
                while now() < over {}
            }
            denied
        });
        let (recorder, _ledger) = recording(now(), None);
        let mut wakeups = Wakeups::new(recorder);
        let mut waiter = Waiter::new(&Realtime::PLAIN, turn.period);
        let measure = || wait(&mut waiter, &mut wakeups, turn);
        let denied = on_thread(&realtime(80), turn.period, measure, || {}).unwrap();
        assert_eq!(denied, [], "grant it, or leave it out: MRROC_LEAVE_OUT=realtime");
        assert_eq!(hog.join().unwrap(), []);
        wakeups.causes.worst().collect()
    }

    #[test]
    fn a_thread_that_could_run_when_it_asked_to_be_woken_was_preempted() {
        let left_out = std::env::var("MRROC_LEAVE_OUT").unwrap_or_default();
        if left_out.split(',').any(|part| part == "realtime") {
            println!("left out: realtime");
            return;
        }
        // The host may cause one or two further delays.
        let attempts = [(); 2].map(|()| {
            let worst = starved();
            let named = worst.iter().filter(|one| one.cause == Cause::Preempted);
            (named.count() >= 6).then_some(()).ok_or(worst)
        });
        assert!(attempts.iter().any(Result::is_ok), "{attempts:?}");
    }
}
