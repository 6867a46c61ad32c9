//! Set-points that waited for the bus: the set-points of at most one cycle wait, and no drive acts on these set-points.

use std::time::Duration;

use can::ControllerState;

use super::bench::*;
use crate::cia402::{AxisConfig, CyclicMode, GroupConfig};

const STAND: &[AxisCommand] = &[AxisCommand::Stand; 2];

fn enabled() -> Bench {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    bench
}

/// Runs cycles in which the port takes nothing, until both axes have a fault. Returns the number of these cycles.
fn until_fault(bench: &mut Bench, state: ControllerState) -> u32 {
    {
        let mut bus = bench.bus.0.lock().unwrap();
        (bus.takes, bus.state) = (Some(0), state);
    }
    for cycles in 1..10 {
        assert_eq!(bench.cycle(NONE, STAND), NONE);
        if bench.states.iter().all(|state| state.fault.is_some()) {
            return cycles;
        }
    }
    panic!("no fault");
}

#[test]
fn at_most_one_cycle_of_motion_frames_is_in_flight() {
    let bench = enabled();
    // The heartbeat of the host and a service frame may wait behind the set-points.
    assert_eq!(bench.bus.0.lock().unwrap().most_unsent, Some(2));
    // Bring-up sends more.
    let mut bench = bench;
    let _ = bench.group.bring_up(bench.now);
    assert_eq!(bench.bus.0.lock().unwrap().most_unsent, Some(usize::MAX));
}

#[test]
fn after_a_bus_that_took_nothing_the_stops_reach_the_drives_before_the_next_sync() {
    let mut bench = enabled();
    until_fault(&mut bench, ControllerState::Active);
    bench.bus.0.lock().unwrap().takes = None;
    let frames = bench.cycle(NONE, STAND);
    let heads: Vec<_> = frames.iter().map(|frame| &frame[..8]).collect();
    assert_eq!(heads, ["201#0200", "202#0200"]);
    let frames = bench.cycle(NONE, STAND);
    assert_eq!((&frames[0][..], &frames[1][..8], &frames[2][..8]), ("080#", "201#0200", "202#0200"));
}

#[test]
fn a_refusal_that_is_tolerated_omits_no_sync() {
    let mut bench = enabled();
    bench.bus.0.lock().unwrap().takes = Some(0);
    bench.cycle(&bench.answers(0x0737, 1_000), STAND);
    bench.bus.0.lock().unwrap().takes = None;
    let frames = bench.cycle(NONE, STAND);
    assert_eq!((&frames[0][..], &frames[1][..8]), ("080#", "201#0F00"));
    assert!(bench.states.iter().all(|state| state.fault.is_none()));
}

#[test]
fn a_bus_without_acknowledge_is_told_from_a_full_queue() {
    let mut bench = enabled();
    let cycles = until_fault(&mut bench, ControllerState::Passive);
    let fault = Fault::NotAcknowledged { cycles: cycles - 1 };
    assert!(bench.states.iter().all(|state| state.fault == Some(fault)), "{:?}", bench.states);
    assert_eq!(cycles - 1, group_config().tolerated_missing);
    let text = "bus: no node acknowledges the host's frames, for 2 cycles";
    assert_eq!(fault.to_string(), text);
    for state in [ControllerState::Active, ControllerState::Warning] {
        let mut bench = enabled();
        until_fault(&mut bench, state);
        let fault = bench.states[0].fault;
        assert!(matches!(fault, Some(Fault::Silent { .. } | Fault::NotSent { .. })), "{fault:?}");
    }
}

#[test]
fn after_a_reset_the_first_target_is_the_measured_position() {
    let mut bench = enabled();
    bench.cycle(&bench.answers(0x0737, 1_000), &[follow(1_500.0), follow(1_500.0)]);
    until_fault(&mut bench, ControllerState::Passive);
    {
        let mut bus = bench.bus.0.lock().unwrap();
        (bus.takes, bus.state) = (None, ControllerState::Active);
    }
    // The drives have stopped by themselves, elsewhere.
    for statusword in [0x0707, 0x0740, 0x0740] {
        bench.cycle(&bench.answers(statusword, 1_234), &[AxisCommand::ResetFault; 2]);
    }
    let target = answer(1, 0, 1_234)[8..16].to_owned();
    for statusword in [0x0740, 0x0721, 0x0723, 0x0737, 0x0737, 0x0737] {
        let frames = bench.cycle(&bench.answers(statusword, 1_234), STAND);
        assert!(frames[1][8..].starts_with(&target), "{statusword:#06x}: {frames:?}");
    }
    assert!(bench.states.iter().all(|state| state.fault.is_none()), "{:?}", bench.states);
}

/// Two enabled drives of a bus that tolerates `tolerated_missing` missing answers.
fn enabled_with(tolerated_missing: u32) -> Bench {
    let axes = [1, 2].map(axis_config);
    let mut bench = Bench::up_with(GroupConfig { tolerated_missing, ..group_config() }, &axes);
    bench.enable();
    bench
}

/// Identifiers and controlwords of frames.
fn heads(frames: &[String]) -> Vec<&str> {
    frames.iter().map(|frame| frame.get(..8).unwrap_or(frame)).collect()
}

#[test]
fn after_two_unanswered_syncs_sync_alone_is_sent_until_an_answer_or_the_time_out_of_the_drives() {
    let answers = |bench: &Bench| bench.answers(0x0737, 1_000);
    let (stops, alone) = (["080#", "201#0200", "202#0200"], ["080#"]);
    for tolerated in 1..=6 {
        let mut bench = enabled_with(tolerated);
        let dropped = bench.group.counters().dropped_setpoints;
        bench.cycle(&answers(&bench), STAND);
        // With this batch, the set-points of two cycles wait in whatever holds the frames.
        assert_eq!(heads(&bench.cycle(NONE, STAND)), ["080#", "201#0F00", "202#0F00"]);
        for unanswered in 2..20 {
            let frames = bench.cycle(NONE, STAND);
            assert_eq!(heads(&frames), alone, "{tolerated} tolerated, {unanswered} unanswered");
            let faults = bench.states.iter().filter(|state| matches!(state.fault, Some(Fault::Silent { .. })));
            assert_eq!(faults.count() == 2, unanswered > tolerated, "{:?}", bench.states);
        }
        let withheld = 2 * u64::from(tolerated - 1);
        assert_eq!(bench.group.counters().dropped_setpoints - dropped, withheld);
        // An answer shows that the frames arrive. The drives settle within 20 ms.
        let cycles = (1..20).find(|_| heads(&bench.cycle(&answers(&bench), STAND)) == stops);
        assert_eq!(cycles, Some(11));
    }
    // The order to stop is sent although nothing is heard.
    let mut bench = enabled_with(2);
    bench.cycle(&answers(&bench), STAND);
    let began = bench.now;
    while heads(&bench.cycle(NONE, STAND)) != stops {
        assert!(bench.now.since(began) < Duration::from_secs(2));
    }
    assert_eq!(bench.now.since(began), Duration::from_secs(1));
}

#[test]
fn drives_that_do_not_stand_by_themselves_are_stopped_after_the_tolerated_answers() {
    let axes = [1, 2].map(|raw| AxisConfig { mode: CyclicMode::Csv, ..axis_config(raw) });
    let mut bench = Bench::up_with(group_config(), &axes);
    bench.enable();
    bench.cycle(&bench.answers(0x0737, 1_000), STAND);
    let sent: Vec<_> = (0..4).map(|_| bench.cycle(NONE, STAND)).collect();
    let expected = [&["080#", "201#0F00", "202#0F00"][..], &["080#"], &["080#", "201#0200", "202#0200"]];
    assert_eq!(sent[..3].iter().map(|frames| heads(frames)).collect::<Vec<_>>(), expected);
}

#[test]
fn an_answer_of_one_drive_ends_the_withholding() {
    let mut bench = enabled_with(6);
    bench.cycle(&bench.answers(0x0737, 1_000), STAND);
    for _ in 0..3 {
        bench.cycle(NONE, STAND);
    }
    let frames = bench.cycle(&[answer(2, 0x0737, 1_000)], STAND);
    assert_eq!(heads(&frames), ["080#", "201#0F00", "202#0F00"]);
    // A single silent drive withholds nothing. The SYNC that proves the age of the answers is left out once.
    for left_out in [true, false, false] {
        let frames = bench.cycle(&[answer(2, 0x0737, 1_000)], STAND);
        assert_eq!(heads(&frames), if left_out { &[][..] } else { &["080#", "201#0F00", "202#0F00"] });
    }
    assert!(bench.states.iter().all(|state| state.fault.is_none()));
}

#[test]
fn withheld_set_points_are_told_to_the_servo() {
    let mut bench = enabled_with(6);
    bench.cycle(&bench.answers(0x0737, 1_000), STAND);
    for (answers, taken) in [(false, true), (false, false), (false, false), (true, true)] {
        bench.now += PERIOD;
        let at = bench.now - PERIOD / 2;
        let frames = bench.answers(0x0737, 1_000);
        let frames = frames.iter().filter(|_| answers).map(|text| Received { frame: frame(text), at });
        bench.bus.0.lock().unwrap().inbox.extend(frames);
        bench.group.read(bench.now, &mut bench.states);
        bench.group.write(bench.now, STAND);
        assert_eq!(bench.group.send(bench.now), taken);
    }
    assert!(bench.states.iter().all(|state| state.fault.is_none()));
}
