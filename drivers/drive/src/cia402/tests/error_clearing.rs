//! Errors that end when their cause ends. In these cases, other CANopen stacks kept an error for ever, cleared the
//! error of another cause, or stopped more nodes than necessary.

use std::time::Duration;

use can::{ControllerState, PortError};

use super::bench::*;
use crate::cia402::GroupConfig;

const STAND: &[AxisCommand] = &[AxisCommand::Stand; 2];
const OFF: &[AxisCommand] = &[AxisCommand::Off; 2];
const RESET: &[AxisCommand] = &[AxisCommand::ResetFault; 2];

/// Two drives with heartbeats of 10 ms, which the host misses after 30 ms.
fn watched() -> Bench {
    let config = GroupConfig { heartbeat_period: Duration::from_millis(10), ..group_config() };
    let mut bench = Bench::up_with(config, &[axis_config(1), axis_config(2)]);
    beat(&mut bench, &["701#05", "702#05"], 20);
    bench
}

/// Runs `cycles` with answers of drives that are off, and with these heartbeats in every fifth cycle.
fn beat(bench: &mut Bench, heartbeats: &[&str], cycles: u32) {
    run(bench, heartbeats, cycles, OFF);
}

fn run(bench: &mut Bench, heartbeats: &[&str], cycles: u32, commands: &[AxisCommand]) {
    for cycle in 0..cycles {
        let mut answers = bench.answers(0x0740, 1_000);
        let due = heartbeats.iter().filter(|_| cycle % 5 == 0);
        answers.extend(due.map(|text| (*text).to_owned()));
        bench.cycle(&answers, commands);
    }
}

fn faults(bench: &Bench) -> Vec<Option<Fault>> {
    bench.states.iter().map(|state| state.fault).collect()
}

/// CANopenNode issue 631: after a short circuit of the wires, the consumer never hears the heartbeats again.
#[test]
fn heartbeats_that_return_after_a_dead_bus_are_heard_each_time() {
    let mut bench = watched();
    for round in 0..20 {
        assert_eq!(faults(&bench), [None; 2], "round {round}");
        beat(&mut bench, &[], 30);
        for fault in faults(&bench) {
            assert!(matches!(fault, Some(Fault::HeartbeatLost { .. })), "round {round}: {fault:?}");
        }
        // The loss stays until the heartbeats return, and the fault stays until the reset.
        run(&mut bench, &[], 2, RESET);
        beat(&mut bench, &[], 2);
        assert!(faults(&bench).iter().all(Option::is_some), "round {round}");
        beat(&mut bench, &["701#05", "702#05"], 10);
        assert!(faults(&bench).iter().all(Option::is_some), "round {round}");
        run(&mut bench, &["701#05", "702#05"], 2, RESET);
        beat(&mut bench, &["701#05", "702#05"], 10);
    }
}

/// CANopenNode issue 618: the recovery of one node clears the error of another. Issue 632: the error of a node that is
/// back stays until a node that never was there is heard.
#[test]
fn the_loss_of_each_node_ends_by_that_node_alone() {
    let mut bench = watched();
    beat(&mut bench, &[], 30);
    beat(&mut bench, &["701#05"], 10);
    run(&mut bench, &["701#05"], 2, RESET);
    beat(&mut bench, &["701#05"], 10);
    let [one, other] = [bench.states[0].fault, bench.states[1].fault];
    assert_eq!(one, None);
    assert!(matches!(other, Some(Fault::HeartbeatLost { node: 2, .. })), "{other:?}");
    run(&mut bench, &["701#05", "702#05"], 2, RESET);
    beat(&mut bench, &["701#05", "702#05"], 10);
    assert_eq!(faults(&bench), [None; 2]);
}

/// CANopenNode issue 374: one missed heartbeat of one node takes the whole master out of operation.
#[test]
fn a_missed_heartbeat_of_one_drive_leaves_the_host_and_the_other_drive_in_operation() {
    let mut bench = watched();
    // One heartbeat of node 2 is missing: 20 ms of silence.
    beat(&mut bench, &["701#05"], 5);
    beat(&mut bench, &["701#05", "702#05"], 5);
    assert_eq!(faults(&bench), [None; 2]);
    // Node 2 falls silent for good. Node 1 gets no fault, and the host still says that it is operational.
    let before = sent(&bench).len();
    beat(&mut bench, &["701#05"], 50);
    let [one, other] = [bench.states[0].fault, bench.states[1].fault];
    assert_eq!(one, None);
    assert!(matches!(other, Some(Fault::HeartbeatLost { node: 2, .. })), "{other:?}");
    let sent = sent(&bench).split_off(before);
    let own: Vec<_> = sent.iter().filter(|frame| frame.starts_with("77F#")).collect();
    assert!(own.len() >= 9 && own.iter().all(|frame| *frame == "77F#05"), "{own:?}");
    assert!(!sent.iter().any(|frame| frame.starts_with("000#")), "no NMT command");
}

/// c-open pull request 34: bus-off is reported at the event and not at the recovery, and the stack works after the restart.
#[test]
fn bus_off_is_a_fault_at_the_event_and_ends_after_each_restart() {
    let mut bench = watched();
    let heartbeats = ["701#05", "702#05"];
    for round in 0..10 {
        bench.bus.0.lock().unwrap().state = ControllerState::BusOff;
        bench.cycle(NONE, STAND);
        assert_eq!(faults(&bench), [Some(Fault::BusOff); 2], "round {round}");
        bench.bus.0.lock().unwrap().state = ControllerState::Active;
        beat(&mut bench, &heartbeats, 5);
        assert_eq!(faults(&bench), [Some(Fault::BusOff); 2], "round {round}: a restart alone resets nothing");
        run(&mut bench, &heartbeats, 2, RESET);
        beat(&mut bench, &heartbeats, 5);
        assert_eq!(faults(&bench), [None; 2], "round {round}");
    }
}

/// ros_canopen issues 244 and 468: the socket never recovers after an error of the bus.
#[test]
fn a_port_that_fails_again_and_again_works_after_each_failure() {
    let mut bench = watched();
    let heartbeats = ["701#05", "702#05"];
    for error in [PortError::Down, PortError::Os(105), PortError::Down] {
        bench.bus.0.lock().unwrap().error = Some(error);
        bench.cycle(NONE, OFF);
        assert_eq!(faults(&bench), [Some(Fault::Port(error)); 2]);
        bench.bus.0.lock().unwrap().error = None;
        run(&mut bench, &heartbeats, 5, OFF);
        run(&mut bench, &heartbeats, 2, RESET);
        beat(&mut bench, &heartbeats, 5);
        assert_eq!(faults(&bench), [None; 2], "{error}");
    }
}
