//! Reaction of a robot to a light gate in lockstep.

use std::time::Duration;

use ::mrroc::bench::BenchKind;
use kit::reaction::{BOUNDS, PERIOD, Reaction, run};

#[test]
fn a_light_gate_changes_the_set_points_within_3_periods_or_5_after_the_reading_in_lockstep() {
    for (pace, after_reading, at_any_moment) in BOUNDS {
        let reactions = run(BenchKind::Lockstep, PERIOD, pace).expect("a run in lockstep has no delays");
        let periods = |time: Duration| time.as_secs_f64() / PERIOD.as_secs_f64();
        let longest = |some: &mut dyn Iterator<Item = &Reaction>| some.map(|it| periods(it.time)).fold(0.0, f64::max);
        let read_at_once = longest(&mut reactions.iter().filter(|it| it.read_after <= PERIOD));
        let any = longest(&mut reactions.iter());
        println!("{} periods: {read_at_once:.2} periods after the reading, {any:.2} at most", pace.periods);
        assert!(read_at_once > 0.0 && read_at_once <= after_reading as f64, "{reactions:?}");
        assert!(any <= at_any_moment as f64, "{reactions:?}");
    }
}
