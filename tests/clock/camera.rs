//! Network cameras over TCP, by the clock.

use std::iter;

use ::mrroc::bench::BenchKind;
use ::mrroc::prelude::RunOutcome;
use kit::bench::patient_turn;
use kit::camera::{REFUSED, assert_found, refusal, run};

#[test]
fn box_is_located_within_1_mm_from_a_picture_over_tcp() {
    let _turn = patient_turn();
    // On a busy host, a picture may be late. A run that ended with a fault is repeated.
    let runs = iter::repeat_with(|| run(BenchKind::Emulated, |_| {})).take(8);
    let mut runs = runs.inspect(|run| run.faults.iter().for_each(|fault| println!("{}", fault.what)));
    let found = runs.find(|run| run.outcome == RunOutcome::Completed);
    assert_found(&found.expect("a host that can run the cell for a moment"), 0.713, 0.887);
}

#[test]
fn absent_silent_garbled_and_other_cameras_are_refused_over_tcp() {
    let _turn = patient_turn();
    for (change, expected) in REFUSED {
        // A busy host delays pictures, and the camera is then refused for another reason.
        let mut refused = iter::repeat_with(|| refusal(BenchKind::Emulated, change)).take(8);
        assert!(refused.any(|refused| refused.contains(expected)), "{expected}");
    }
}
