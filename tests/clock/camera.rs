//! Network cameras over TCP, by the clock.

use ::mrroc::bench::BenchKind;
use kit::camera::{REFUSED, assert_found, refusal, run};
use kit::{PERIOD, by_the_clock};

#[test]
fn box_is_located_within_1_mm_from_a_picture_over_tcp() {
    by_the_clock(0.3, PERIOD, || {
        assert_found(&run(BenchKind::Emulated, |_| {}), 0.713, 0.887);
    });
}

#[test]
fn absent_silent_garbled_and_other_cameras_are_refused_over_tcp() {
    for (change, expected) in REFUSED {
        by_the_clock(0.25, PERIOD, || {
            let refused = refusal(BenchKind::Emulated, change);
            assert!(refused.contains(expected), "{expected}: {refused}");
        });
    }
}
