//! A soak of a minute. `cargo bench -p mrroc-tests --bench soak` runs hours.

use std::time::Duration;

use ::faults::soak::{MOST_GROWTH_KIB, SoakOptions, soak};
use ::mrroc::cell::CellFile;
use kit::mrroc::example;

#[test]
fn a_minute_with_a_fault_loses_nothing_and_is_the_same_again() {
    let file = CellFile::read(example("irb6")).unwrap();
    let options = SoakOptions { duration: Duration::from_secs(60), seed: 1 };
    let run = || soak(&file, &options, &mut |_| None).unwrap();
    let report = run();
    assert!(report.is_good(), "{report}");
    let sums = [report.sum(|kind| kind.injected), report.sum(|kind| kind.detected + kind.tolerated)];
    assert_eq!(sums, [1, 1], "{report}");
    assert!(report.references >= 1 && report.rounds >= 4, "{report}");
    assert!(report.comparisons.iter().sum::<u64>() >= report.rounds, "{report}");
    assert_eq!(run().to_string(), report.to_string());
}

#[test]
fn a_soak_whose_memory_grows_is_not_good() {
    let file = CellFile::read(example("irb6")).unwrap();
    let options = SoakOptions { duration: Duration::from_secs(120), seed: 1 };
    let grown = |per_minute: u64| {
        let mut memory = 10_000;
        let mut progress = |_| {
            memory += per_minute;
            Some(memory)
        };
        soak(&file, &options, &mut progress).unwrap()
    };
    let bounded = grown(MOST_GROWTH_KIB);
    assert!(bounded.is_good(), "{bounded}");
    let leaking = grown(MOST_GROWTH_KIB + 1);
    assert!(!leaking.is_good(), "{leaking}");
}
