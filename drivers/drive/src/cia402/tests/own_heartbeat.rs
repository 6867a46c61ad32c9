//! The heartbeat of the host, by which the drives monitor the host.

use std::time::Duration;

use super::bench::*;
use crate::cia402::*;

/// A heartbeat every fifth cycle; it is lost after 15.
fn short() -> GroupConfig {
    GroupConfig { heartbeat_period: 5 * PERIOD, ..group_config() }
}

/// The drives answer, and their own heartbeats come.
fn cycle(bench: &mut Bench, statusword: u16, command: AxisCommand) -> Vec<String> {
    let mut answers = bench.answers(statusword, 1_000);
    let nodes = bench.stores.iter().map(|store| store.raw);
    answers.extend(nodes.map(|raw| format!("{:03X}#05", 0x700 + u16::from(raw))));
    let commands = vec![command; bench.stores.len()];
    bench.cycle(&answers, &commands)
}

#[test]
fn a_heartbeat_that_the_port_never_takes_is_a_fault_of_every_axis() {
    let mut bench = Bench::up_with(short(), &[axis_config(1), axis_config(2)]);
    bench.enable();
    // SYNC and the set-points.
    bench.bus.0.lock().unwrap().takes = Some(3);
    for _ in 0..10 {
        cycle(&mut bench, 0x0737, AxisCommand::Stand);
        assert_eq!(bench.states[0].fault, None);
    }
    for _ in 0..10 {
        cycle(&mut bench, 0x0737, AxisCommand::Stand);
    }
    for state in &bench.states {
        let text = state.fault.map(|fault| fault.to_string());
        let text = text.unwrap_or_default();
        let expected = "bus: the host's heartbeat was not sent for ";
        assert!(text.starts_with(expected), "{text:?}");
    }
    let frames = cycle(&mut bench, 0x0737, AxisCommand::Stand);
    assert!(frames[1].starts_with("201#0200") && frames[2].starts_with("202#0200"));
    // It cannot be reset away; a heartbeat that is taken lets it.
    cycle(&mut bench, 0x0740, AxisCommand::ResetFault);
    cycle(&mut bench, 0x0740, AxisCommand::ResetFault);
    assert!(bench.states[0].fault.is_some());
    bench.bus.0.lock().unwrap().takes = None;
    for _ in 0..3 {
        cycle(&mut bench, 0x0740, AxisCommand::ResetFault);
    }
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn a_heartbeat_that_is_late_by_less_than_three_periods_is_no_fault() {
    let mut bench = Bench::up_with(short(), &[axis_config(2)]);
    bench.enable();
    for _ in 0..5 {
        bench.bus.0.lock().unwrap().takes = Some(2);
        for _ in 0..12 {
            cycle(&mut bench, 0x0737, AxisCommand::Stand);
        }
        bench.bus.0.lock().unwrap().takes = None;
        cycle(&mut bench, 0x0737, AxisCommand::Stand);
    }
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn no_drive_gets_torque_before_a_heartbeat_was_sent() {
    let mut bench =
        Bench::up_with(GroupConfig { heartbeat_period: Duration::from_secs(2), ..short() }, &[axis_config(2)]);
    bench.bus.0.lock().unwrap().takes = Some(2);
    for statusword in [0x0740, 0x0721, 0x0723, 0x0723, 0x0723] {
        let sent = cycle(&mut bench, statusword, AxisCommand::Stand);
        assert!(!sent[1].starts_with("202#0F"), "{sent:?}");
    }
    bench.bus.0.lock().unwrap().takes = None;
    let sent = cycle(&mut bench, 0x0723, AxisCommand::Stand);
    assert_eq!(sent[1..], ["202#0700E8030000", "77F#05"]);
    let sent = cycle(&mut bench, 0x0723, AxisCommand::Stand);
    assert_eq!(sent[1..], ["202#0F00E8030000"]);
}
