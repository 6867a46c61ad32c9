//! Reaction of a robot to a light gate by the clock.

use ::mrroc::bench::BenchKind;
use kit::bench::turn;
use kit::reaction::{BOUNDS, BY_THE_CLOCK, EDGES, Reaction, run};

/// Runs by the clock: a host that delays the controller ends a run, or lengthens a reaction. Most reactions of a run are
/// judged.
const ATTEMPTS: usize = 5;

const MOST: usize = EDGES * 9 / 10;

#[test]
fn a_light_gate_changes_the_set_points_within_3_periods_or_5_after_the_reading_by_the_clock() {
    for (pace, after_reading, at_any_moment) in BOUNDS {
        // A late host stretches the periods, so that SYNC frames count them.
        let bounded = |reactions: &Vec<Reaction>| {
            let bound = |it: &Reaction| if it.read_after <= BY_THE_CLOCK { after_reading } else { at_any_moment };
            let within = reactions.iter().filter(|it| it.syncs <= bound(it)).count();
            println!("{} periods: {within} of {EDGES} reactions within their bounds", pace.periods);
            within >= MOST
        };
        let attempt = |_| {
            let _turn = turn();
            run(BenchKind::Emulated, BY_THE_CLOCK, pace).is_some_and(|reactions| bounded(&reactions))
        };
        assert!((0..ATTEMPTS).any(attempt), "{} periods", pace.periods);
    }
}
