//! Queries, answers and the published state.

use super::*;

#[test]
fn one_query_leaves_per_cycle_and_its_answer_is_published_in_the_next() {
    let mut rig = Rig::up();
    // The first cycle has the last sample of bring-up.
    assert_eq!(rig.cycle().age, 0);
    rig.line.board().heard.clear();
    for cycle in 1..=5_u64 {
        let load = cycle as i16 * 115;
        rig.line.board().load = [load, -load, 1, 470, -94, 0];
        let queried = rig.now;
        // The answer to the query of the cycle before, with the load of that cycle.
        let before = f64::from(load - 115) * FORCE;
        let state = rig.cycle();
        assert_eq!((state.cycle, state.age, state.fault), (cycle, 0, None));
        assert_eq!(state.sampled, queried + BYTE);
        assert_eq!(state.samples, cycle);
        assert!((state.wrench[0] - before).abs() < 1e-12, "{state:?}");
        assert_eq!(state.measured(), Some(state.wrench));
        assert_eq!(rig.line.board().heard.last(), Some(&(rig.now, b'q')));
    }
    assert_eq!(rig.line.board().heard.len(), 5);
}

#[test]
fn counts_become_newtons_and_newton_metres_with_the_sign_of_the_scale() {
    let mut rig = Rig::up_with(config(|sensor| sensor.channels[1].scale = -FORCE), Board::new());
    rig.line.board().load = [115, 115, -230, 940 - 1, -188, 1];
    let [fx, fy, fz, tx, ty, tz] = rig.run(2).wrench;
    let expected = [10.0, -10.0, -20.0, 939.0 * TORQUE, -1.0, TORQUE];
    for (found, expected) in [fx, fy, fz, tx, ty, tz].into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
}

#[test]
fn a_missing_answer_ages_the_last_sample_and_the_line_is_quiet_before_the_next_query() {
    let mut rig = Rig::up();
    rig.line.board().load = [115, 0, 0, 0, 0, 0];
    let last = rig.run(3);
    rig.line.board().mute = 1;
    rig.line.board().load = [230, 0, 0, 0, 0, 0];
    // The answer to the query of the last cycle is on its way.
    let states: Vec<_> = (0..5).map(|_| rig.cycle()).collect();
    assert_eq!(states.iter().map(|state| state.age).collect::<Vec<_>>(), [0, 1, 2, 0, 0]);
    assert!(states.iter().all(|state| state.fault.is_none()));
    for stale in &states[..3] {
        assert_eq!((stale.wrench, stale.sampled), (last.wrench, states[0].sampled));
    }
    assert!((states[3].wrench[0] - 20.0).abs() < 1e-12);
    // The second query after the lost one, a cycle before its answer.
    assert_eq!(states[3].sampled, states[2].at + BYTE);
    assert_eq!(rig.sensor.counters().missed_answers, 1);
}

#[test]
fn an_answer_that_is_a_cycle_late_is_not_that_to_the_next_query() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().delay = 1;
    rig.line.board().load = [115, 0, 0, 0, 0, 0];
    rig.cycle();
    rig.line.board().delay = 0;
    rig.line.board().load = [230, 0, 0, 0, 0, 0];
    let states: Vec<_> = (0..4).map(|_| rig.cycle()).collect();
    assert_eq!(states.iter().map(|state| state.age).collect::<Vec<_>>(), [1, 2, 0, 0]);
    // No sample has the load of the late answer.
    assert!(states.iter().all(|state| (state.wrench[0] - 10.0).abs() > 1.0), "{states:?}");
    assert_eq!(rig.sensor.sensor_counters().late, 1);
}

#[test]
fn a_torn_answer_costs_two_samples_and_shifts_no_byte() {
    let mut rig = Rig::up();
    rig.line.board().load = [1, 2, 3, 4, 5, 6];
    rig.run(3);
    // Ten bytes now, four in the next reading.
    let rest: Vec<u8> = rig.line.board().outbox.drain(10..).collect();
    rig.now += PERIOD;
    rig.sensor.read(rig.now, &mut []);
    rig.line.board().outbox.extend(rest);
    rig.sensor.send(rig.now);
    let ages: Vec<_> = (0..3).map(|_| rig.cycle().age).collect();
    assert_eq!(ages, [2, 0, 0]);
    let counters = rig.sensor.sensor_counters();
    assert_eq!((counters.garbage, counters.late), (1, 1));
    let state = rig.link.read();
    assert!((state.wrench[5] - 6.0 * TORQUE).abs() < 1e-12);
}

#[test]
fn bytes_that_nobody_asked_for_are_garbage_and_the_query_waits_for_a_quiet_line() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().outbox.extend(b"ATI");
    // Seventeen bytes are no answer.
    assert_eq!(rig.cycle().age, 1);
    let heard = rig.line.board().heard.len();
    rig.line.board().outbox.extend(b"more text");
    assert_eq!(rig.cycle().age, 2);
    assert_eq!(rig.line.board().heard.len(), heard);
    assert_eq!(rig.cycle().age, 3);
    assert_eq!(rig.cycle().age, 0);
    assert_eq!(rig.sensor.sensor_counters().garbage, 2);
}

#[test]
fn the_group_counts_requests_answers_and_bytes() {
    let mut rig = Rig::up();
    let before = rig.sensor.counters().port;
    rig.run(10);
    let port = rig.sensor.counters().port;
    assert_eq!((port.sent - before.sent, port.received), (10, 9));
    assert_eq!((rig.sensor.axes(), rig.sensor.counters().unexpected), (0, 0));
}

#[test]
fn a_dropped_driver_leaves_no_valid_wrench() {
    let mut rig = Rig::up();
    assert!(rig.run(3).measured().is_some());
    let Rig { sensor, link, .. } = rig;
    drop(sensor);
    assert_eq!((link.read().fault, link.read().measured()), (Some(WrenchFault::Ended), None));
}
