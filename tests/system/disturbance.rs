//! The rule by which a run by the clock is repeated, and the budget of processors of these runs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::Duration;

use kit::disturbance::{Evidence, PERIOD, RUNS, judged};
use kit::processors::{ALL, Budget};
use serde_json::{Value, json};

fn us(time: u64) -> Duration {
    Duration::from_micros(time)
}

#[test]
fn a_delay_of_a_period_disturbs_and_a_shorter_one_does_not() {
    let of = |late, waited: Option<u64>, stolen| Evidence {
        late: us(late),
        waited: waited.map(us),
        stolen: us(stolen),
        ..Evidence::default()
    };
    for (evidence, expected) in [
        (of(2000, Some(0), 0), true),
        (of(1999, Some(0), 0), false),
        (of(0, Some(2000), 0), true),
        (of(0, Some(1999), 0), false),
        (of(0, Some(0), 2000), true),
        (of(0, Some(0), 1999), false),
        (of(0, None, 0), false),
        (of(2000, None, 0), true),
        // A worker of the kernel, which carries the bytes of pseudo-terminals.
        (Evidence { worker: us(2000), ..Evidence::default() }, true),
        (Evidence { worker: us(1999), ..Evidence::default() }, false),
        // Delays do not add up.
        (of(1999, Some(1999), 1999), false),
    ] {
        assert_eq!(evidence.disturbs(PERIOD), expected, "{evidence}");
    }
}

/// A report with its latest cycles: lateness, µs, and cause.
fn report(worst: &[(f64, &str)], missed: u64, missed_answers: u64) -> Value {
    let worst: Vec<_> = worst.iter().map(|(late, cause)| json!({ "late_us": late, "cause": cause })).collect();
    json!({ "cycle": { "missed": missed, "worst": worst }, "buses": [{ "missed_answers": missed_answers }] })
}

#[test]
fn late_cycles_by_the_host_disturb_and_defects_of_the_program_do_not() {
    for (report, expected) in [
        (report(&[(2000.0, "preempted")], 1, 0), true),
        (report(&[(1999.0, "preempted")], 0, 0), false),
        (report(&[(300.0, "own step"), (2000.0, "host")], 1, 0), true),
        (report(&[(2000.0, "late wake-up")], 1, 0), true),
        (report(&[], 0, 0), false),
        // Work of the program.
        (report(&[(9000.0, "own step"), (9000.0, "bus"), (9000.0, "between cycles")], 12, 0), false),
        (report(&[(9000.0, "page fault")], 4, 0), false),
        // A servo that is late by 300 µs in each cycle.
        (report(&[(300.0, "late wake-up"); 8], 0, 0), false),
        // A drive that loses one frame in a thousand.
        (report(&[], 0, 17), false),
        // A run that was refused has no report.
        (Value::Null, false),
    ] {
        assert_eq!(Evidence::of_report(&report).disturbs(PERIOD), expected, "{report}");
    }
}

/// Number of runs, and whether the test passed, for runs that pass from number `passing` on.
fn runs(passing: usize, evidence: Evidence) -> (usize, bool) {
    let mut count = 0;
    let verdict = catch_unwind(AssertUnwindSafe(|| {
        judged(PERIOD, |number| {
            count = number;
            (catch_unwind(|| assert!(number >= passing, "a negative verdict")), evidence)
        });
    }));
    (count, verdict.is_ok())
}

#[test]
fn only_a_disturbed_run_with_a_negative_verdict_is_repeated_and_not_for_ever() {
    let disturbed = Evidence { late: PERIOD, ..Evidence::default() };
    let quiet = Evidence::default();
    assert_eq!(runs(1, disturbed), (1, true));
    assert_eq!(runs(1, quiet), (1, true));
    assert_eq!(runs(2, quiet), (1, false));
    assert_eq!(runs(3, disturbed), (3, true));
    assert_eq!(runs(RUNS, disturbed), (RUNS, true));
    assert_eq!(runs(RUNS + 1, disturbed), (RUNS, false));
}

#[test]
fn shares_of_the_processors_never_exceed_the_budget_and_none_waits_for_ever() {
    let budget = Budget::new(180);
    let (running, most) = (AtomicU32::new(0), AtomicU32::new(0));
    thread::scope(|scope| {
        for number in 0..40 {
            let (budget, running, most) = (&budget, &running, &most);
            scope.spawn(move || {
                let processors = [0.3, 0.5, 1.2, ALL][number % 4];
                let share = budget.take(processors);
                assert!(budget.used() <= 180);
                let now = running.fetch_add(1, Ordering::Relaxed) + 1;
                most.fetch_max(now, Ordering::Relaxed);
                assert!(processors.is_finite() || now == 1, "{now} beside one that takes all");
                thread::yield_now();
                running.fetch_sub(1, Ordering::Relaxed);
                drop(share);
            });
        }
    });
    assert_eq!(budget.used(), 0);
    assert!(most.load(Ordering::Relaxed) <= 6);
}
