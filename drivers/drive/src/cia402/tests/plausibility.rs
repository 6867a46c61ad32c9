//! Rejection of measured positions that the motor cannot have reached.

use std::f64::consts::TAU;
use std::time::Duration;

use super::bench::*;
use crate::Homing;
use crate::cia402::*;

const STAND: &[AxisCommand] = &[AxisCommand::Stand];
const RESET: &[AxisCommand] = &[AxisCommand::ResetFault];

/// 10 turns per second: 20 000 increments/s, 40 per period.
const FASTEST: f64 = 10.0 * TAU;

/// The drive stands enabled at 1000 increments.
fn enabled() -> Bench {
    let axis = AxisConfig { plausible_velocity: FASTEST, ..axis_config(2) };
    let mut bench = Bench::up_with(group_config(), &[axis]);
    bench.enable();
    bench
}

fn at(bench: &mut Bench, position: i32) {
    bench.cycle(&[answer(2, 0x0737, position)], STAND);
}

/// The check allows at least two periods: 80 increments, and two increments of rounding.
#[test]
fn a_jump_that_the_motor_cannot_have_made_is_a_fault_and_not_believed() {
    for (moved, believed) in [(82, true), (-82, true), (83, false), (-83, false)] {
        let mut bench = enabled();
        let before = bench.states[0];
        at(&mut bench, 1_000 + moved);
        let state = bench.states[0];
        if believed {
            assert_eq!((state.increments.0, state.fault), (1_000 + moved, None));
            continue;
        }
        let fault = Fault::Implausible { node: 2, moved, most: 82, within: 2 * PERIOD };
        assert_eq!(state.fault, Some(fault));
        assert_eq!(state.increments, before.increments);
        assert_eq!(state.position, before.position);
        assert_eq!(state.velocity, before.velocity);
        assert!(!state.following);
    }
    let fault = Fault::Implausible { node: 2, moved: -83, most: 82, within: Duration::from_millis(4) };
    let text = "node 2: position jumped by -83 increments within 4.0ms; the motor cannot have turned by more than 82";
    assert_eq!(fault.to_string(), text);
}

/// The motor accelerates by 0.4 increments per period², and answers may be four periods late.
#[test]
fn a_step_in_motion_that_no_acceleration_explains_is_a_jump() {
    for (step, found) in [(60, true), (-60, true), (15, false), (-15, false)] {
        let axis = AxisConfig { plausible_velocity: FASTEST, plausible_acceleration: 50.0 * TAU, ..axis_config(2) };
        let mut bench = Bench::up_with(group_config(), &[axis]);
        bench.enable();
        let mut position = 1_000;
        for cycle in 0..20 {
            position += 5 + if cycle == 15 { step } else { 0 };
            at(&mut bench, position);
            let jumped = matches!(bench.states[0].fault, Some(Fault::Implausible { moved, .. }) if moved == 5 + step);
            assert_eq!(jumped, found && cycle >= 17, "{step}, cycle {cycle}: {:?}", bench.states[0].fault);
        }
        assert_eq!(bench.states[0].increments.0, position);
    }
}

#[test]
fn a_counter_that_wraps_does_not_jump() {
    let mut bench = enabled();
    let mut position = i32::MAX - 100;
    // After so long a time, the displacement from the initial position is plausible.
    bench.now += Duration::from_secs(200_000);
    bench.cycle(&[answer(2, 0x0740, position)], &[AxisCommand::ResetFault]);
    bench.cycle(&[answer(2, 0x0740, position), "702#05".into()], RESET);
    bench.cycle(&[answer(2, 0x0740, position)], RESET);
    assert_eq!(bench.states[0].increments.0, position);
    for _ in 0..5 {
        position = position.wrapping_add(40);
        bench.cycle(&[answer(2, 0x0740, position)], &[AxisCommand::Off]);
        assert_eq!(bench.states[0].increments.0, position);
        assert!(!matches!(bench.states[0].fault, Some(Fault::Implausible { .. })));
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
    assert!(matches!(bench.states[0].fault, Some(Fault::Implausible { .. })));
}

/// A bus or an adapter that delayed answers delivers all of them after the last SYNC.
#[test]
fn answers_that_come_in_a_burst_are_no_jump() {
    let mut bench = enabled();
    bench.cycle(NONE, STAND);
    bench.cycle(NONE, STAND);
    let burst = [1_040, 1_080, 1_120].map(|position| answer(2, 0x0737, position));
    bench.cycle(&burst, STAND);
    let state = bench.states[0];
    assert_eq!((state.increments.0, state.fault), (1_120, None));
}

/// The counter at the end of a search, and of an aborted search, in answers after the last answer of the search.
#[test]
fn a_counter_that_a_search_sets_anew_late_does_not_jump() {
    for (command, late) in [(AxisCommand::Stand, true), (AxisCommand::Off, true), (AxisCommand::Stand, false)] {
        let mut bench = enabled();
        for statusword in [0x0737, 0x0737, 0x0737, 0x0237, 0x0237, 0x0237, 0x0237] {
            bench.cycle(&[answer(2, statusword, 1_000)], &[AxisCommand::Home]);
        }
        let end = if command == AxisCommand::Off { 0x0237 } else { 0x9637 };
        // The group waits for a counter that the drive sets behind its success.
        for _ in 0..if command == AxisCommand::Off { 0 } else { 4 } {
            bench.cycle(&[answer(2, end, 1_000)], &[AxisCommand::Home]);
        }
        bench.cycle(&[answer(2, end, 1_000)], &[command]);
        for _ in 0..if late { 3 } else { 10 } {
            bench.cycle(&[answer(2, 0x9637, 1_000)], &[command]);
        }
        bench.cycle(&[answer(2, 0x9637, 0)], &[command]);
        let state = bench.states[0];
        let jumped = matches!(state.fault, Some(Fault::Implausible { moved: -1_000, .. }));
        assert_eq!(jumped, !late, "{:?}", state.fault);
        let homing = if late { Homing::Attained } else { Homing::NotHomed };
        assert_eq!(state.homing, homing);
    }
}

/// Bring-up resets the communication of a drive, but not its counter.
#[test]
fn a_bring_up_does_not_make_a_counter_that_jumped_a_reference() {
    let mut bench = enabled();
    at(&mut bench, 2_000);
    assert_eq!(bench.bring_up(), Ok(()));
    for _ in 0..3 {
        bench.cycle(&[answer(2, 0x8740, 2_000)], &[AxisCommand::Off]);
        let state = bench.states[0];
        assert_eq!((state.fault, state.homing), (None, Homing::NotHomed));
    }
}

/// A target at the last plausible position would move the motor by the jump.
#[test]
fn a_drive_whose_counter_jumped_is_stopped_where_it_counts() {
    let mut bench = enabled();
    let frames = bench.cycle(&[answer(2, 0x0737, 2_000)], STAND);
    // A quick stop, 2000 increments.
    assert_eq!(frames[1], "202#0200D0070000");
}

#[test]
fn an_axis_whose_counter_jumped_stays_in_fault_until_the_jump_has_had_time() {
    let mut bench = enabled();
    let sampled = bench.now - PERIOD;
    at(&mut bench, 3_000);
    // An answer that still shows the jump is latched again after a reset.
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
    // Bit 15: the drive reports that it has its reference.
    bench.cycle(&[answer(2, 0x8737, 1_000)], STAND);
    assert_eq!(bench.states[0].homing, Homing::Attained);
    bench.cycle(&[answer(2, 0x8737, 2_000)], STAND);
    assert_eq!(bench.states[0].homing, Homing::NotHomed);
    for _ in 0..60 {
        bench.cycle(&[answer(2, 0x8740, 2_000)], RESET);
    }
    let state = bench.states[0];
    assert_eq!((state.fault, state.homing), (None, Homing::NotHomed));
    for statusword in [0x8740, 0x8721, 0x8723, 0x8737, 0x8737, 0x8737, 0x8737, 0x8737] {
        bench.cycle(&[answer(2, statusword, 2_000)], STAND);
    }
    // The drive is in mode HM after two cycles. The search shows some cycles later, and the drive sets its counter.
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
        let axis = AxisConfig { plausible_velocity, ..axis_config(2) };
        let group = CanBus::new(BusEnd::default(), group_config(), &[axis]);
        let (node, quantity) = (2, Quantity::PlausibleVelocity);
        assert_eq!(group.err(), Some(ConfigError::OutOfRange { node, quantity }));
    }
}

/// Whether the axis still has a reference after EMCY and fault with `code`, at rest and after the reset.
fn keeps_reference(code: u16) -> bool {
    let mut bench = enabled();
    bench.cycle(&[answer(2, 0x8737, 1_000)], STAND);
    assert_eq!(bench.states[0].homing, Homing::Attained);
    let [low, high] = code.to_le_bytes();
    bench.cycle(&[answer(2, 0x8208, 1_000), format!("082#{low:02X}{high:02X}000000000000")], STAND);
    assert_eq!(bench.states[0].fault, Some(Fault::Drive { node: 2, code }));
    let homing = bench.states[0].homing;
    for statusword in [0x8208, 0x8240, 0x8240, 0x8240] {
        bench.cycle(&[answer(2, statusword, 1_000)], &[AxisCommand::ResetFault]);
    }
    assert_eq!((bench.states[0].fault, bench.states[0].homing), (None, homing), "{code:#x}");
    homing == Homing::Attained
}

/// An encoder that counted backwards for a while ends in a following error of the drive, and its counter goes on from
/// where it is.
#[test]
fn a_fault_by_which_the_counter_may_be_wrong_discards_the_reference() {
    let cases = [
        (0x2310, true),
        (0x3210, true),
        (0x4380, true),
        (0x7121, true),
        (0x7300, false),
        (0x7320, false),
        (0x7392, false),
        (0x8130, true),
        (0x8400, false),
        (0x8500, false),
        (0x8611, false),
        (0x8700, true),
        (0x8A80, true),
    ];
    for (code, kept) in cases {
        assert_eq!(keeps_reference(code), kept, "{code:#x}");
    }
}

/// The controller of the run before may have ended with the doubt.
#[test]
fn a_drive_that_is_found_with_a_following_error_has_no_reference() {
    for (code, homing) in [(0x8611_u16, Homing::NotHomed), (0x2310, Homing::Attained)] {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        bench.stores[0].put(0x6041, 0, &[0x08, 0x82]);
        bench.stores[0].put(0x603F, 0, &code.to_le_bytes());
        assert_eq!(bench.bring_up(), Ok(()));
        bench.cycle(NONE, &[AxisCommand::Off]);
        assert_eq!(bench.states[0].homing, homing, "{code:#x}");
    }
}
