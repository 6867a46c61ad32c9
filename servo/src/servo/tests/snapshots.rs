//! Snapshots: the state of an effector in every cycle, with the times of its samples.

use super::*;

#[test]
fn every_cycle_is_published_with_the_times_of_its_samples_also_without_power() {
    let mut rig = Rig::new(2);
    let latest = rig.link.latest.clone();
    rig.world().axes[1].state.position = 0.25;
    for cycle in 0..10 {
        let now = rig.now;
        rig.run(1);
        let snapshot = latest.read();
        assert_eq!((snapshot.cycle, snapshot.at, snapshot.phase, snapshot.axes), (cycle, now, Phase::Off, 2));
        assert_eq!(snapshot, latest.read(), "a read changes nothing");
        if cycle > 0 {
            assert_eq!(snapshot.sampled[..3], [now - PERIOD, now - PERIOD, Instant::ZERO]);
            assert_eq!(snapshot.measured[1], 0.25);
        }
    }
    assert_eq!(rig.reports(), []);
}

#[test]
fn a_silent_drive_keeps_the_time_of_its_last_sample_and_its_age_grows() {
    let mut rig = Rig::standing(2);
    let last = rig.link.latest.read();
    rig.world().axes[0].silent = true;
    for age in 1..=3 {
        // The answer to the SYNC before the silence comes first.
        if age == 1 {
            rig.run(1);
        }
        rig.run(1);
        let snapshot = rig.link.latest.read();
        assert_eq!((snapshot.age[0], snapshot.age[1]), (age, 0));
        assert_eq!(snapshot.sampled[0], last.sampled[0] + PERIOD);
        assert_eq!(snapshot.sampled[1], snapshot.at - PERIOD);
    }
}

#[test]
fn torque_and_switches_are_those_of_the_sample() {
    let mut rig = Rig::standing(1);
    {
        let mut world = rig.world();
        world.axes[0].state.torque = 0.125;
        world.axes[0].limit_above = Some(-1.0);
    }
    rig.run(2);
    let snapshot = rig.link.latest.read();
    assert_eq!(snapshot.torque[0], 0.125);
    assert!(snapshot.switches[0].upper_limit && !snapshot.switches[0].lower_limit);
}

#[test]
fn the_trail_has_at_the_time_of_a_sample_the_set_point_that_the_sample_shows() {
    let mut rig = Rig::standing(1);
    rig.accelerate(500.0, 4, 2);
    let mut accelerated = 0;
    for cycle in 0..30 {
        rig.run(1);
        let (snapshot, trail) = (rig.link.latest.read(), rig.link.latest.trail());
        let [before, there, after] = trail.around(snapshot.sampled[0]).map(|motors| motors[0]);
        assert!((there - snapshot.measured[0]).abs() < 1e-12, "{cycle}: {there} {snapshot:?}");
        let period = trail.period();
        accelerated += u32::from(((before - 2.0 * there + after) / (period * period) - 500.0).abs() < 1e-3);
    }
    // The motion accelerates for 40 periods.
    assert!(accelerated >= 10, "{accelerated}");
}
