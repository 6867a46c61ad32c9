//! Positions that a motor cannot have reached.

use std::f64::consts::TAU;
use std::time::Duration;

use super::bench::*;
use crate::Homing;
use crate::cia402::*;

const STAND: &[AxisCommand] = &[AxisCommand::Stand];
const RESET: &[AxisCommand] = &[AxisCommand::ResetFault];

/// 10 turns a second: 20 000 increments/s, 40 in a period.
const FASTEST: f64 = 10.0 * TAU;

/// The drive stands enabled at 1000 increments.
fn enabled() -> Bench {
    let axis = AxisConfig {
        plausible_velocity: FASTEST,
        ..axis_config(2)
    };
    let mut bench = Bench::up_with(group_config(), &[axis]);
    bench.enable();
    bench
}

fn at(bench: &mut Bench, position: i32) {
    bench.cycle(&[answer(2, 0x0737, position)], STAND);
}

/// An answer comes half a period after its SYNC, so that a period and a half lies between the SYNC before and it: 60
/// increments, and two that rounding may cost.
#[test]
fn a_jump_that_the_motor_cannot_have_made_is_a_fault_and_not_believed() {
    for (moved, believed) in [(62, true), (-62, true), (63, false), (-63, false)] {
        let mut bench = enabled();
        let before = bench.states[0];
        at(&mut bench, 1_000 + moved);
        let state = bench.states[0];
        if believed {
            assert_eq!((state.increments.0, state.fault), (1_000 + moved, None));
            continue;
        }
        let within = 3 * PERIOD / 2;
        let node = 2;
        let fault = Fault::Implausible {
            node,
            moved,
            within,
        };
        assert_eq!(state.fault, Some(fault));
        assert_eq!(state.increments, before.increments);
        assert_eq!(state.position, before.position);
        assert_eq!(state.velocity, before.velocity);
        assert!(!state.following);
    }
    let fault = Fault::Implausible {
        node: 2,
        moved: -63,
        within: Duration::from_millis(3),
    };
    let text = "node 2: position jumped by -63 increments within 3.0ms, further than the motor can have turned";
    assert_eq!(fault.to_string(), text);
}

#[test]
fn a_counter_that_wraps_does_not_jump() {
    let mut bench = enabled();
    let mut position = i32::MAX - 100;
    // From where it stands, by a way that takes long enough.
    bench.now += Duration::from_secs(200_000);
    bench.cycle(&[answer(2, 0x0740, position)], &[AxisCommand::ResetFault]);
    bench.cycle(&[answer(2, 0x0740, position), "702#05".into()], RESET);
    bench.cycle(&[answer(2, 0x0740, position)], RESET);
    assert_eq!(bench.states[0].increments.0, position);
    for _ in 0..5 {
        position = position.wrapping_add(40);
        bench.cycle(&[answer(2, 0x0740, position)], &[AxisCommand::Off]);
        assert_eq!(bench.states[0].increments.0, position);
        assert!(!matches!(
            bench.states[0].fault,
            Some(Fault::Implausible { .. })
        ));
    }
    assert!(position < 0);
}

#[test]
fn a_way_that_missed_answers_leave_time_for_is_believed() {
    let mut bench = enabled();
    bench.cycle(NONE, STAND);
    bench.cycle(NONE, STAND);
    at(&mut bench, 1_000 + 140);
    assert_eq!(bench.states[0].fault, None);
    bench.cycle(NONE, STAND);
    bench.cycle(NONE, STAND);
    at(&mut bench, 1_140 + 143);
    assert!(matches!(
        bench.states[0].fault,
        Some(Fault::Implausible { .. })
    ));
}

#[test]
fn an_axis_whose_counter_jumped_stays_in_fault_until_the_jump_has_had_time() {
    let mut bench = enabled();
    let sampled = bench.now - PERIOD;
    at(&mut bench, 3_000);
    // What shows the jump still is latched again after a reset.
    while bench.now.since(sampled) < Duration::from_millis(100) - 2 * PERIOD {
        bench.cycle(&[answer(2, 0x0740, 3_000)], RESET);
        assert_eq!(bench.states[0].increments.0, 1_000);
    }
    for _ in 0..4 {
        bench.cycle(&[answer(2, 0x0740, 3_000)], RESET);
    }
    let state = bench.states[0];
    assert_eq!((state.increments.0, state.fault), (3_000, None));
    assert!(state.velocity.abs() <= FASTEST * 1.1);
}

#[test]
fn a_counter_that_jumped_is_no_reference_until_the_axis_is_homed_again() {
    let mut bench = enabled();
    // Bit 15: the drive says that it has its reference.
    bench.cycle(&[answer(2, 0x8737, 1_000)], STAND);
    assert_eq!(bench.states[0].homing, Homing::Attained);
    bench.cycle(&[answer(2, 0x8737, 2_000)], STAND);
    assert_eq!(bench.states[0].homing, Homing::NotHomed);
    for _ in 0..60 {
        bench.cycle(&[answer(2, 0x8740, 2_000)], RESET);
    }
    let state = bench.states[0];
    assert_eq!((state.fault, state.homing), (None, Homing::NotHomed));
    for statusword in [
        0x8740, 0x8721, 0x8723, 0x8737, 0x8737, 0x8737, 0x8737, 0x8737,
    ] {
        bench.cycle(&[answer(2, statusword, 2_000)], STAND);
    }
    // In mode HM after two cycles, and the search shows after some more; the counter is set anew.
    for _ in 0..10 {
        bench.cycle(&[answer(2, 0x0237, 2_000)], &[AxisCommand::Home]);
    }
    for _ in 0..2 {
        bench.cycle(&[answer(2, 0x9637, 0)], &[AxisCommand::Home]);
    }
    let state = bench.states[0];
    assert_eq!((state.fault, state.homing), (None, Homing::Attained));
    assert_eq!(state.increments.0, 0);
}

#[test]
fn an_axis_without_a_plausible_velocity_is_refused() {
    for plausible_velocity in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let axis = AxisConfig {
            plausible_velocity,
            ..axis_config(2)
        };
        let group = Cia402Group::new(BusEnd::default(), group_config(), &[axis]);
        let (node, quantity) = (2, Quantity::PlausibleVelocity);
        assert_eq!(
            group.err(),
            Some(ConfigError::OutOfRange { node, quantity })
        );
    }
}
