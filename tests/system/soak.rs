//! A soak of two minutes. `cargo bench -p mrroc-tests --bench soak` runs hours.

use std::time::Duration;

use ::faults::soak::{MOST_GROWTH_KIB, SoakOptions, soak};
use ::mrroc::cell::CellFile;
use kit::mrroc::example;

#[test]
fn two_minutes_with_faults_lose_nothing_are_the_same_again_and_a_memory_that_grows_is_not_good() {
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
    let mut report = grown(MOST_GROWTH_KIB);
    assert!(report.is_good(), "{report}");
    let sums = [report.sum(|kind| kind.injected), report.sum(|kind| kind.detected + kind.tolerated)];
    assert_eq!(sums, [2, 2], "{report}");
    assert!(report.references >= 1 && report.rounds >= 8, "{report}");
    assert!(report.comparisons.iter().sum::<u64>() >= report.rounds, "{report}");
    let mut leaking = grown(MOST_GROWTH_KIB + 1);
    assert!(!leaking.is_good(), "{leaking}");
    // The memory is the only difference.
    (report.memory_kib, leaking.memory_kib) = (None, None);
    assert_eq!(leaking.to_string(), report.to_string());
}
