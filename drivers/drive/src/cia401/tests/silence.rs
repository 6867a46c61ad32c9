//! Silence of an I/O node, and nodes that leave operation.

use std::time::Duration;

use can::{ControllerState, PortError};

use super::bench::*;

/// The number of cycles until the node has a fault, and the fault. `life_sign` arrives in each cycle.
fn silent(bench: &mut Bench, life_sign: &[&str]) -> (u32, IoFault) {
    for cycles in 1..10_000 {
        cycle(bench, life_sign);
        if let Some(fault) = image(bench).fault {
            return (cycles, fault);
        }
    }
    panic!("no fault");
}

#[test]
fn three_event_timers_without_inputs_are_a_fault_and_leave_no_level() {
    let mut bench = up();
    cycle(&mut bench, &[]);
    cycle(&mut bench, &["185#0302"]);
    let received = image(&bench).received;
    // Heartbeats do not stand for inputs.
    let (_, fault) = silent(&mut bench, &["705#05"]);
    let waited = bench.now.since(received);
    assert_eq!(fault, IoFault::InputsSilent { node: IO, waited });
    assert!(waited > Duration::from_millis(150) && waited <= Duration::from_millis(150) + PERIOD, "{waited:?}");
    assert_eq!(image(&bench).input(0), None);
    assert_eq!(fault.to_string(), "node 5: no inputs for 151.0ms");
    // The fault is latched, and the axes go on.
    cycle(&mut bench, &["185#0302"]);
    assert_eq!((image(&bench).fault, bench.states[0].fault), (Some(fault), None));
}

#[test]
fn inputs_that_come_once_per_event_timer_are_no_fault() {
    let mut bench = up();
    for _ in 0..20 {
        (0..24).for_each(|_| _ = cycle(&mut bench, &[]));
        cycle(&mut bench, &["185#0302", "705#05"]);
        assert_eq!(image(&bench).fault, None);
    }
}

#[test]
fn three_heartbeat_periods_without_a_heartbeat_are_a_fault() {
    let mut bench = up_with(IoConfig { inputs: 0, ..io_config(IO) });
    for _ in 0..10 {
        cycle(&mut bench, &["705#05"]);
    }
    let last = image(&bench).heard;
    let (_, fault) = silent(&mut bench, &["702#05"]);
    let waited = bench.now.since(last);
    assert_eq!(fault, IoFault::HeartbeatLost { node: IO, waited });
    assert!(waited > Duration::from_secs(6) && waited <= Duration::from_secs(6) + PERIOD, "{waited:?}");
}

#[test]
fn a_node_that_boots_or_stops_is_a_fault_at_once() {
    for text in ["705#00", "705#04", "705#7F"] {
        let mut bench = up();
        cycle(&mut bench, &["185#0302", text]);
        assert_eq!(image(&bench).fault, Some(IoFault::LeftOperational { node: IO }), "{text}");
        // The next heartbeat does not undo what the boot lost.
        cycle(&mut bench, &["705#05"]);
        assert_eq!(image(&bench).fault, Some(IoFault::LeftOperational { node: IO }), "{text}");
    }
}

#[test]
fn a_wait_between_bring_up_and_the_first_cycle_is_no_silence() {
    let mut bench = up();
    // Another group of the cell took a second to come up.
    bench.now += Duration::from_secs(1);
    cycle(&mut bench, &[]);
    assert_eq!(image(&bench).fault, None);
    // From here the node must speak.
    let (cycles, _) = silent(&mut bench, &["705#05"]);
    assert_eq!(cycles, 76);
}

#[test]
fn a_second_master_that_commands_outputs_stops_every_axis() {
    let mut bench = up();
    cycle(&mut bench, &["205#0F"]);
    let sign = Sign::Setpoint { node: IO };
    assert_eq!(bench.states[0].fault, Some(Fault::OtherController { sign }));
    assert_eq!(image(&bench).fault, Some(IoFault::OtherController { sign }));
    assert_eq!(image(&bench).input(0), None);
}

#[test]
fn a_fault_of_the_bus_is_a_fault_of_every_io_node() {
    type Break = fn(&mut Bus);
    let table: [(Break, IoFault); 2] = [
        (|bus| bus.state = ControllerState::BusOff, IoFault::BusOff),
        (|bus| bus.error = Some(PortError::Down), IoFault::Port(PortError::Down)),
    ];
    for (fail, fault) in table {
        let mut bench = up();
        cycle(&mut bench, &["185#0302"]);
        assert_eq!(image(&bench).fault, None);
        fail(&mut bench.bus.0.lock().unwrap());
        cycle(&mut bench, &[]);
        assert_eq!((image(&bench).fault, image(&bench).input(0)), (Some(fault), None));
        // The fault stays when the bus works again.
        let mut bus = bench.bus.0.lock().unwrap();
        (bus.state, bus.error) = (ControllerState::Active, None);
        drop(bus);
        cycle(&mut bench, &["185#0302"]);
        assert_eq!(image(&bench).fault, Some(fault), "{fault}");
    }
}

#[test]
fn a_heartbeat_of_the_host_that_is_never_taken_is_a_fault() {
    let config = GroupConfig { heartbeat_period: 5 * PERIOD, ..group_config() };
    let mut bench = Bench::up_with_io(config, &[axis_config(DRIVE)], &[io_config(IO)], vec![io_store(IO)]);
    // SYNC and the set-point.
    bench.bus.0.lock().unwrap().takes = Some(2);
    let (_, fault) = silent(&mut bench, &["705#05", "185#0302"]);
    assert!(matches!(fault, IoFault::HeartbeatNotSent { waited } if waited > 15 * PERIOD), "{fault}");
}

#[test]
fn a_bus_that_is_dropped_leaves_no_valid_level() {
    let mut bench = up();
    cycle(&mut bench, &["185#0302"]);
    let Bench { group, links, .. } = bench;
    assert_eq!(links[0].inputs.read().fault, None);
    drop(group);
    let image = links[0].inputs.read();
    assert_eq!((image.fault, image.input(0)), (Some(IoFault::Ended { node: IO }), None));
}
