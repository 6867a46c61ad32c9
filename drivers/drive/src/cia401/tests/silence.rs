//! Silence of an I/O node, and nodes that leave operation.

use std::time::Duration;

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
}
