//! Recovery of a drive that booted in operation, by a reset of its fault.

use std::time::Duration;

use can::PortError;

use super::bench::*;
use crate::cia402::GroupConfig;
use crate::{Homing, Power};

const RESET: [AxisCommand; 2] = [AxisCommand::Stand, AxisCommand::ResetFault];
const OFF: [AxisCommand; 2] = [AxisCommand::Stand, AxisCommand::Off];

/// Two enabled drives, of which node 2 has booted.
fn booted() -> Bench {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    bench.cycle(&[answer(1, 0x0737, 1_000), "702#00".to_owned()], &[AxisCommand::Stand; 2]);
    assert_eq!(bench.states[1].fault, Some(Fault::LeftOperational { node: 2 }));
    bench
}

/// Cycles under a reset of node 2 until its recovery has ended. Node 1 goes on, and node 2 answers SYNC by `answers` once
/// it was started. Returns the frames sent, cycle by cycle.
fn recover(bench: &mut Bench, answers: &[&str]) -> Vec<Vec<String>> {
    let (mut all, mut started) = (Vec::new(), false);
    loop {
        let mut frames = vec![answer(1, 0x0737, 1_000), "701#05".to_owned()];
        frames.extend(answers.iter().filter(|_| started).map(|text| (*text).to_owned()));
        let sent = bench.cycle(&frames, &RESET);
        started |= sent.contains(&"000#0102".to_owned());
        all.push(sent);
        assert!(bench.states[0].following && bench.states[0].fault.is_none());
        if all.len() > 2 && !bench.states[1].recovering {
            return all;
        }
        assert!(all.len() < 3_000, "{:?}", bench.states[1]);
    }
}

#[test]
fn a_reset_brings_a_drive_that_booted_up_again_while_the_other_goes_on() {
    let mut bench = booted();
    // The drive counts from another place since it booted, and a hand moves the axis meanwhile.
    bench.stores[1].put(0x6064, 0, &77_i32.to_le_bytes());
    bench.stores[1].put(0x6085, 0, &[0; 4]);
    let sent = recover(&mut bench, &[&answer(2, 0x0240, 80)]);
    for cycle in &sent {
        let service = cycle.iter().filter(|frame| frame.starts_with("000#") || frame.starts_with("60")).count();
        assert!(service <= 1, "{cycle:?}");
        assert_eq!(cycle[..2], ["080#", "201#0F00E8030000"], "the other drive holds its position");
        // No controlword enables the drive.
        assert!(
            cycle.iter().filter(|frame| frame.starts_with("202#")).all(|frame| frame.starts_with("202#0000")
                || frame.starts_with("202#8000")
                || frame.starts_with("202#0600")),
            "{cycle:?}"
        );
    }
    let all: Vec<&String> = sent.iter().flatten().collect();
    let commands: Vec<_> = all.iter().filter(|frame| frame.starts_with("000#")).collect();
    assert_eq!(commands, [&&"000#8202".to_owned(), &&"000#0102".to_owned()]);
    // The drive hears the host before it starts.
    let start = sent.iter().find(|cycle| cycle.contains(&"000#0102".to_owned())).unwrap();
    assert_eq!(start[start.len() - 2..], ["77F#05", "000#0102"]);
    assert_eq!(bench.stores[1].objects[&(0x6085, 0)], bench.stores[0].objects[&(0x6085, 0)]);
    let state = bench.states[1];
    assert_eq!((state.fault, state.homing, state.power), (None, Homing::NotHomed, Power::Off));
    // The next sample counts from the position that bring-up read, without a jump of the counter.
    bench.cycle(&[answer(1, 0x0737, 1_000), answer(2, 0x0240, 81)], &OFF);
    assert_eq!((bench.states[1].fault, bench.states[1].increments.0), (None, 81));
    for statusword in [0x0240, 0x0221, 0x0223, 0x0237, 0x0237, 0x0237, 0x0237] {
        bench.cycle(&[answer(1, 0x0737, 1_000), answer(2, statusword, 81)], &[AxisCommand::Stand; 2]);
    }
    assert!(bench.states[1].following);
}

#[test]
fn a_node_in_another_state_is_brought_up_again_too() {
    for state in ["702#7F", "702#04"] {
        let mut bench = Bench::up(&[1, 2]);
        bench.enable();
        bench.cycle(&[answer(1, 0x0737, 1_000), answer(2, 0x0737, 1_000), state.to_owned()], &[AxisCommand::Stand; 2]);
        recover(&mut bench, &[&answer(2, 0x0240, 1_000)]);
        assert_eq!(bench.states[1].fault, None, "{state}");
    }
}

#[test]
fn a_drive_is_brought_up_again_once_both_its_answers_and_its_heartbeats_are_missing() {
    let config = GroupConfig { heartbeat_period: Duration::from_millis(10), ..group_config() };
    // Cycles with an answer, then cycles without. Two missing answers and 30 ms without a heartbeat are tolerated.
    for (answered, missing, is_recovered) in [(14, 2, false), (12, 3, false), (13, 3, true), (0, 30, true)] {
        let mut bench = Bench::up_with(config, &[axis_config(2)]);
        // The first cycle of operation counts as a heartbeat.
        bench.cycle(NONE, &[AxisCommand::Off]);
        for _ in 0..answered {
            bench.cycle(&[answer(2, 0x0740, 1_000)], &[AxisCommand::Off]);
        }
        for _ in 1..missing {
            bench.cycle(NONE, &[AxisCommand::Off]);
        }
        bench.cycle(NONE, &[AxisCommand::ResetFault]);
        let sent = bench.cycle(NONE, &[AxisCommand::ResetFault]);
        let case = format!("{answered} {missing} {sent:?}");
        assert_eq!(sent.contains(&"000#8202".to_owned()), is_recovered, "{case}");
        assert_eq!(bench.states[0].recovering, is_recovered, "{case}");
    }
}

#[test]
fn a_reference_that_the_drive_reports_counts_unless_its_counter_jumped() {
    let table = [
        (&["boot", "stands"], Homing::Attained),
        (&["boot", "jumps"], Homing::NotHomed),
        (&["jumps", "boot"], Homing::NotHomed),
    ];
    for (order, expected) in table {
        let mut bench = Bench::up(&[1, 2]);
        bench.enable();
        for event in order {
            let position = if *event == "jumps" { 1_000_000 } else { 1_000 };
            for position in [1_000, position] {
                let mut frames = vec![answer(1, 0x0737, 1_000), answer(2, 0x8740, position)];
                frames.extend((*event == "boot").then(|| "702#00".to_owned()));
                bench.cycle(&frames, &OFF);
            }
        }
        recover(&mut bench, &[&answer(2, 0x8240, 80)]);
        bench.cycle(&[answer(1, 0x0737, 1_000), answer(2, 0x8240, 80)], &OFF);
        assert_eq!((bench.states[1].fault, bench.states[1].homing), (None, expected), "{order:?}");
    }
}

#[test]
fn another_drive_in_its_place_is_refused_and_the_same_order_does_not_try_again() {
    let mut bench = booted();
    bench.stores[1].put(0x1018, 2, &[0x00, 0x00, 0x50, 0x61]);
    recover(&mut bench, &[]);
    let error = BringUpError::WrongIdentity { node: 2, subindex: 2, expected: 0x6050_0000, found: 0x6150_0000 };
    assert_eq!(bench.states[1].fault, Some(Fault::NotBack { error }));
    for _ in 0..100 {
        bench.cycle(&[answer(1, 0x0737, 1_000)], &RESET);
        assert_eq!((bench.states[1].recovering, bench.states[1].fault), (false, Some(Fault::NotBack { error })));
    }
    // The right drive is back, and a new order finds it.
    bench.stores[1].put(0x1018, 2, &[0x00, 0x00, 0x50, 0x60]);
    bench.cycle(&[answer(1, 0x0737, 1_000)], &OFF);
    recover(&mut bench, &[&answer(2, 0x0240, 80)]);
    assert_eq!(bench.states[1].fault, None);
}

#[test]
fn a_drive_that_stays_away_is_told_within_the_time_out_of_its_boot() {
    let mut bench = booted();
    (bench.stores[1].boots, bench.stores[1].mute) = (false, Some((0x1000, 0)));
    let began = bench.now;
    recover(&mut bench, &[]);
    let fault = bench.states[1].fault.unwrap();
    assert!(matches!(fault, Fault::NotBack { error: BringUpError::NeverBooted { node: 2, .. } }), "{fault}");
    assert!(bench.now.since(began) < Duration::from_millis(1_020));
    assert_eq!(fault.to_string(), "reset failed: node 2: never booted, waited 1.0s");
}

#[test]
fn a_drive_that_does_not_answer_sync_after_its_start_is_told() {
    let mut bench = booted();
    let began = bench.now;
    recover(&mut bench, &[]);
    let fault = bench.states[1].fault.unwrap();
    assert!(matches!(fault, Fault::NotBack { error: BringUpError::NotOperational { node: 2, .. } }), "{fault}");
    assert!(bench.now.since(began) < Duration::from_secs(5));
}

#[test]
fn a_boot_after_the_start_ends_the_recovery() {
    let mut bench = booted();
    recover(&mut bench, &["702#00"]);
    assert_eq!(bench.states[1].fault, Some(Fault::LeftOperational { node: 2 }));
    recover_after_off(&mut bench);
}

/// A new reset after one that failed.
fn recover_after_off(bench: &mut Bench) {
    bench.cycle(&[answer(1, 0x0737, 1_000)], &OFF);
    recover(bench, &[&answer(2, 0x0240, 80)]);
    assert_eq!(bench.states[1].fault, None);
}

#[test]
fn a_fault_of_the_bus_ends_a_recovery_and_is_named() {
    let mut bench = booted();
    for _ in 0..20 {
        bench.cycle(&[answer(1, 0x0737, 1_000)], &RESET);
    }
    assert!(bench.states[1].recovering);
    bench.bus.0.lock().unwrap().error = Some(PortError::Down);
    bench.cycle(NONE, &RESET);
    let state = bench.states[1];
    assert_eq!((state.fault, state.recovering), (Some(Fault::Port(PortError::Down)), false));
    bench.bus.0.lock().unwrap().error = None;
    bench.cycle(&[answer(1, 0x0737, 1_000)], &[AxisCommand::Off; 2]);
    bench.cycle(&[answer(1, 0x0740, 1_000)], &[AxisCommand::ResetFault; 2]);
    for statusword in [0x0740, 0x0721, 0x0723, 0x0737, 0x0737, 0x0737, 0x0737, 0x0737] {
        bench.cycle(&[answer(1, statusword, 1_000)], &OFF);
    }
    recover_after_off(&mut bench);
}

/// The frames to node 2 besides its set-points, in half a second after a fault of the bus. The port takes no frame
/// behind the set-points in cycle `at` of the recovery, and fails in the next.
fn sent_after_a_fault_of_the_bus(at: usize) -> Vec<String> {
    let mut bench = booted();
    let mut started = false;
    for cycle in 0..=at {
        let mut frames = vec![answer(1, 0x0737, 1_000)];
        frames.extend(started.then(|| answer(2, 0x0240, 80)));
        bench.bus.0.lock().unwrap().takes = (cycle == at).then_some(3);
        started |= bench.cycle(&frames, &RESET).contains(&"000#0102".to_owned());
    }
    assert!(bench.states[1].recovering);
    bench.bus.0.lock().unwrap().error = Some(PortError::Down);
    bench.cycle(NONE, &RESET);
    let mut bus = bench.bus.0.lock().unwrap();
    (bus.error, bus.takes) = (None, None);
    drop(bus);
    let cycles = (0..250).flat_map(|_| bench.cycle(&[answer(1, 0x0740, 1_000)], &OFF)).collect::<Vec<_>>();
    cycles.into_iter().filter(|frame| frame.starts_with("000#") || frame.starts_with("602#")).collect()
}

#[test]
fn a_recovery_that_a_fault_of_the_bus_ended_sends_nothing_more() {
    let start = recover(&mut booted(), &[&answer(2, 0x0240, 80)]);
    let start = start.iter().position(|cycle| cycle.contains(&"000#0102".to_owned())).unwrap();
    for at in [1, 2, start / 2, start - 1, start] {
        let sent = sent_after_a_fault_of_the_bus(at);
        assert!(sent.is_empty(), "cycle {at} of {start}: {sent:?}");
    }
}

#[test]
fn without_a_reset_a_drive_that_booted_is_left_alone() {
    let mut bench = booted();
    for _ in 0..100 {
        let sent = bench.cycle(&[answer(1, 0x0737, 1_000)], &OFF);
        assert!(!sent.iter().any(|frame| frame.starts_with("000#") || frame.starts_with("602#")), "{sent:?}");
    }
    assert_eq!(bench.states[1].fault, Some(Fault::LeftOperational { node: 2 }));
}

/// Two enabled drives, of which node 2 lost the heartbeat of the host: it brakes, holds, and shows pre-operational.
fn in_pre_operational() -> Bench {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    // The objects of the drive after its quick stop.
    bench.stores[1].put(0x6041, 0, &[0x17, 0x02]);
    bench.cycle(&[answer(1, 0x0737, 1_000), "702#7F".to_owned()], &[AxisCommand::Stand; 2]);
    assert_eq!(bench.states[1].fault, Some(Fault::LeftOperational { node: 2 }));
    bench
}

/// Frames to node 2 besides its set-points.
fn services(sent: &[Vec<String>]) -> Vec<&str> {
    let all = sent.iter().flatten().map(String::as_str);
    all.filter(|frame| frame.starts_with("000#") || frame.starts_with("602#")).collect()
}

#[test]
fn the_torque_of_a_drive_in_pre_operational_is_removed_by_a_service_request() {
    let mut bench = in_pre_operational();
    let alive = [answer(1, 0x0737, 1_000), "702#7F".to_owned()];
    // A drive that is being stopped keeps its torque.
    let stops: Vec<_> = (0..10).map(|_| bench.cycle(&alive, &[AxisCommand::Stand; 2])).collect();
    assert_eq!(services(&stops), NONE);
    // The drive does not answer as long as its request waits in a buffer.
    bench.stores[1].mute = Some((0x6040, 0));
    let held: Vec<_> = (0..500).map(|_| bench.cycle(&alive, &OFF)).collect();
    let requests = services(&held);
    assert!((3..20).contains(&requests.len()), "{requests:?}");
    assert!(requests.iter().all(|frame| *frame == "602#2B40600000000000" || frame.starts_with("602#80")));
    assert_eq!(bench.states[1].power, Power::Changing);
    bench.stores[1].mute = None;
    bench.stores[1].put(0x6041, 0, &[0x40, 0x02]);
    let off: Vec<_> = (0..200).map(|_| bench.cycle(&alive, &OFF)).collect();
    let requests = services(&off);
    assert_eq!(requests[requests.len() - 2..], ["602#2B40600000000000", "602#4041600000000000"]);
    assert_eq!(bench.states[1].power, Power::Off);
}

#[test]
fn a_drive_in_pre_operational_is_started_without_a_reset_if_its_configuration_is_unchanged() {
    let mut bench = in_pre_operational();
    let before = bench.stores[1].objects.clone();
    let sent = recover(&mut bench, &[&answer(2, 0x0240, 80)]);
    assert_eq!(bench.stores[1].objects, before);
    let requests = services(&sent);
    // The torque goes first, and the NMT start follows the last answer.
    let (start, reads): (Vec<&str>, Vec<&str>) = requests.iter().partition(|frame| frame.starts_with("000#"));
    assert_eq!((start, requests.last()), (vec!["000#0102"], Some(&"000#0102")));
    let writes: Vec<_> = reads.iter().filter(|frame| !frame.starts_with("602#40")).collect();
    assert_eq!(writes.first(), Some(&&"602#2B40600000000000"));
    let of_set_points = |frame: &&&&str| frame[6..10] == *"4060" || frame[6..10] == *"B260";
    assert_eq!(writes.iter().filter(of_set_points).count(), writes.len(), "{writes:?}");
    assert_eq!(bench.states[1].fault, None);
}

#[test]
fn a_drive_in_pre_operational_with_another_configuration_is_reset_and_configured() {
    // The heartbeat consumer, a mapping, a setting of the cell, and an object that the drive lost.
    for (index, subindex, bytes) in [(0x1016, 1, &[0; 4][..]), (0x1A00, 0, &[0]), (0x3001, 1, &[1, 0, 0, 0])] {
        let mut bench = in_pre_operational();
        let configured = bench.stores[1].objects[&(index, subindex)].clone();
        bench.stores[1].put(index, subindex, bytes);
        let sent = recover(&mut bench, &[&answer(2, 0x0240, 80)]);
        let commands: Vec<_> = services(&sent).into_iter().filter(|frame| frame.starts_with("000#")).collect();
        assert_eq!(commands, ["000#8202", "000#0102"], "{index:#06x}");
        assert_eq!(bench.states[1].fault, None);
        assert_eq!(bench.stores[1].objects[&(index, subindex)], configured);
    }
}

#[test]
fn a_reset_waits_for_the_heartbeat_that_shows_pre_operational() {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    // Node 2 answers no SYNC, and its heartbeat is not due yet.
    for _ in 0..4 {
        bench.cycle(&[answer(1, 0x0737, 1_000)], &[AxisCommand::Stand; 2]);
    }
    assert!(matches!(bench.states[1].fault, Some(Fault::Silent { node: 2, .. })));
    for _ in 0..10 {
        bench.cycle(&[answer(1, 0x0737, 1_000)], &RESET);
    }
    assert!(!bench.states[1].recovering);
    bench.cycle(&[answer(1, 0x0737, 1_000), "702#7F".to_owned()], &RESET);
    recover(&mut bench, &[&answer(2, 0x0240, 80)]);
    assert_eq!(bench.states[1].fault, None);
}
