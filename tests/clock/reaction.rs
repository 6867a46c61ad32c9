//! Reaction of a robot to a light gate by the clock.

use ::mrroc::bench::BenchKind;
use kit::by_the_clock;
use kit::reaction::{BOUNDS, BY_THE_CLOCK, EDGES, Reaction, run};

/// Most reactions of a run are judged.
const MOST: usize = EDGES * 9 / 10;

#[test]
fn a_light_gate_changes_the_set_points_within_3_periods_or_5_after_the_reading_by_the_clock() {
    for (pace, after_reading, at_any_moment) in BOUNDS {
        // A delay of a fraction of the period is too long for the controller, which has a period for its step.
        by_the_clock(0.4, BY_THE_CLOCK / 4, || {
            let reactions = run(BenchKind::Emulated, BY_THE_CLOCK, pace).expect("a run without faults");
            // A late host stretches the periods, so that SYNC frames count them.
            let bound = |it: &Reaction| if it.read_after <= BY_THE_CLOCK { after_reading } else { at_any_moment };
            let within = reactions.iter().filter(|it| it.syncs <= bound(it)).count();
            println!("{} periods: {within} of {EDGES} reactions within their bounds", pace.periods);
            assert!(within >= MOST, "{reactions:?}");
        });
    }
}
