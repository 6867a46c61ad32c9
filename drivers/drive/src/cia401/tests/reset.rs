//! Recovery of an I/O node after a fault.

use std::time::Duration;

use can::Instant;
use canopen::Object;

use super::bench::*;

/// A bus whose I/O node booted again during operation.
fn booted() -> Bench {
    let mut bench = up();
    cycle(&mut bench, &["185#0302"]);
    cycle(&mut bench, &["185#0202", "705#00"]);
    assert_eq!(image(&bench).fault, Some(IoFault::LeftOperational { node: IO }));
    bench
}

/// Runs cycles until `done`, and returns all frames sent. Each cycle has at most one service frame.
fn until(bench: &mut Bench, done: impl Fn(&InputImage) -> bool) -> Vec<String> {
    let mut all = Vec::new();
    for _ in 0..3_000 {
        let sent = cycle(bench, &[]);
        let service = sent.iter().filter(|frame| frame.starts_with("000#") || frame.starts_with("60")).count();
        assert!(service <= 1, "{sent:?}");
        assert_eq!(bench.states[0].fault, None);
        all.extend(sent);
        if done(&image(bench)) {
            return all;
        }
        assert_eq!(image(bench).input(0), None);
    }
    panic!("{:?}", image(bench).fault);
}

fn commands(frames: &[String]) -> Vec<&str> {
    frames.iter().filter(|frame| frame.starts_with("000#")).map(String::as_str).collect()
}

#[test]
fn a_reset_configures_and_starts_a_node_that_booted_while_the_axes_go_on() {
    let mut bench = booted();
    let edges = image(&bench).edges;
    bench.links[0].outputs.set_all(0b1111);
    bench.links[0].reset_fault();
    let sent = until(&mut bench, |image| image.fault.is_none());
    assert_eq!(commands(&sent), ["000#8205", "000#0105"]);
    // The heartbeat and the mapping of the inputs are written and read back.
    for request in ["605#2B171000D0070000", "605#4017100000000000", "605#23001A0108010060"] {
        assert!(sent.iter().any(|frame| frame == request), "{request}: {sent:?}");
    }
    // The levels of the start are known. They differ from those before the fault, and the difference is no edge.
    let recovered = image(&bench);
    assert_eq!([0, 1, 9].map(|input| recovered.input(input).unwrap().level), [true, false, true]);
    assert_eq!((recovered.edges, recovered.error), (edges, None));
    // The outputs have their error values until the next command.
    cycle(&mut bench, &["185#0302"]);
    let after = image(&bench);
    assert_eq!((after.sent.unwrap().levels, bench.links[0].outputs.levels()), (0b0001, 0b0001));
    assert_eq!(after.input(1).unwrap().edges, edges[1] + 1);
    bench.links[0].outputs.set_all(0b0110);
    assert!(cycle(&mut bench, &["185#0302"]).contains(&"205#06".to_owned()));
}

#[test]
fn a_reset_keeps_the_outputs_that_keep_their_levels_in_an_error() {
    let mut bench = up();
    bench.links[0].outputs.set_all(0b0110);
    (0..3).for_each(|_| _ = cycle(&mut bench, &["185#0302"]));
    assert_eq!(image(&bench).sent.unwrap().levels, 0b0110);
    cycle(&mut bench, &["185#0202", "705#00"]);
    bench.links[0].reset_fault();
    until(&mut bench, |image| image.fault.is_none());
    cycle(&mut bench, &["185#0302"]);
    // Output 2 keeps its level, and the others take their error values.
    assert_eq!(image(&bench).sent.unwrap().levels, 0b0101);
}

/// Resets the node while the port has room for SYNC and the set-point only from the start of the node on. The node then
/// is sent no command before its next fault.
fn reset_without_command(bench: &mut Bench) {
    bench.links[0].reset_fault();
    for _ in 0..3_000 {
        if cycle(bench, &[]).contains(&"000#0105".to_owned()) {
            bench.bus.0.lock().unwrap().takes = Some(2);
        }
        if image(bench).fault.is_none() {
            assert_eq!(image(bench).sent, None);
            return;
        }
    }
    panic!("{:?}", image(bench).fault);
}

#[test]
fn a_kept_output_outlasts_faults_before_the_first_command_of_a_reset() {
    let mut bench = up();
    bench.links[0].outputs.set_all(0b0110);
    (0..3).for_each(|_| _ = cycle(&mut bench, &["185#0302"]));
    assert_eq!(image(&bench).sent.unwrap().levels, 0b0110);
    let boot: &[&str] = &["705#00"];
    // The node boots, stops, enters pre-operational with an error, sends nothing, and sends no heartbeat.
    for frames in [boot, &["705#04"], &["085#1050010000000000", "705#7F"], NONE, &["185#0302", "702#05"]] {
        while image(&bench).fault.is_none() {
            cycle(&mut bench, frames);
            assert!(bench.now < Instant::ZERO + Duration::from_secs(60), "{frames:?}");
        }
        reset_without_command(&mut bench);
        // A command that the port does not take is no level to keep.
        bench.links[0].outputs.set(2, false);
        while image(&bench).fault.is_none() {
            cycle(&mut bench, &[]);
        }
        assert!(matches!(image(&bench).fault, Some(IoFault::OutputsNotSent { node: IO, .. })));
        bench.bus.0.lock().unwrap().takes = None;
        bench.links[0].reset_fault();
        until(&mut bench, |image| image.fault.is_none());
        cycle(&mut bench, &["185#0302"]);
        assert_eq!((image(&bench).sent.unwrap().levels, bench.links[0].outputs.levels()), (0b0101, 0b0101));
    }
    bench.links[0].outputs.set_all(0b0000);
    (0..2).for_each(|_| _ = cycle(&mut bench, &["185#0302"]));
    cycle(&mut bench, &["705#00"]);
    bench.links[0].reset_fault();
    until(&mut bench, |image| image.fault.is_none());
    cycle(&mut bench, &["185#0302"]);
    assert_eq!(image(&bench).sent.unwrap().levels, 0b0001);
}

#[test]
fn a_kept_output_outlasts_a_second_bring_up() {
    let mut bench = up();
    assert_eq!(bench.links[0].outputs.levels(), 0b0001);
    bench.links[0].outputs.set_all(0b0110);
    (0..3).for_each(|_| _ = cycle(&mut bench, &["185#0302"]));
    // A power cycle of the node is seen as a boot.
    cycle(&mut bench, &["705#00"]);
    for _ in 0..2 {
        assert_eq!(bench.bring_up(), Ok(()));
        assert_eq!((image(&bench).sent, bench.links[0].outputs.levels()), (None, 0b0101));
        (0..3).for_each(|_| _ = cycle(&mut bench, &["185#0302"]));
        assert_eq!(image(&bench).sent.unwrap().levels, 0b0101);
    }
}

#[test]
fn a_recovered_node_is_watched_again() {
    let mut bench = booted();
    bench.links[0].reset_fault();
    until(&mut bench, |image| image.fault.is_none());
    (0..100).for_each(|_| _ = cycle(&mut bench, &["705#05"]));
    assert!(matches!(image(&bench).fault, Some(IoFault::InputsSilent { node: IO, .. })));
    bench.links[0].reset_fault();
    until(&mut bench, |image| image.fault.is_none());
    cycle(&mut bench, &["705#04"]);
    assert_eq!(image(&bench).fault, Some(IoFault::LeftOperational { node: IO }));
}

#[test]
fn a_reset_of_a_node_without_a_fault_sends_nothing_then_and_later() {
    let mut bench = up();
    bench.links[0].reset_fault();
    cycle(&mut bench, &["185#0302"]);
    assert_eq!(image(&bench).fault, None);
    cycle(&mut bench, &["705#00"]);
    let sent: Vec<_> = (0..100).flat_map(|_| cycle(&mut bench, &["185#0302"])).collect();
    assert_eq!(commands(&sent), Vec::<&str>::new());
    assert_eq!(image(&bench).fault, Some(IoFault::LeftOperational { node: IO }));
}

#[test]
fn a_node_that_stays_away_says_so_and_can_be_reset_again() {
    let mut bench = booted();
    bench.stores[1].boots = false;
    bench.stores[1].mute = Some((0x1000, 0));
    bench.links[0].reset_fault();
    until(&mut bench, |image| matches!(image.fault, Some(IoFault::NotBack { .. })));
    let fault = image(&bench).fault.unwrap();
    let text = fault.to_string();
    assert!(text.starts_with("node 5: reset failed: not back in operation after 1.0"), "{text}");
    bench.stores[1].boots = true;
    bench.stores[1].mute = None;
    bench.links[0].reset_fault();
    until(&mut bench, |image| image.fault.is_none());
}

#[test]
fn a_reset_that_a_node_refuses_names_the_object() {
    type Change = fn(&mut Store);
    let table: [(Change, Object); 4] = [
        (|store| store.put(0x1000, 0, &[0x92, 1, 2, 0]), Object::new(0x1000, 0)),
        (|store| store.put(0x1018, 1, &[1, 0, 0, 0]), Object::new(0x1018, 1)),
        (|store| store.put(0x6000, 0, &[1]), Object::new(0x6000, 0)),
        (|store| store.forgetful = Some((0x6206, 1)), Object::new(0x6206, 1)),
    ];
    for (change, object) in table {
        let mut bench = booted();
        change(&mut bench.stores[1]);
        if object.index == 0x6206 {
            bench.stores[1].put(0x6206, 1, &[0]);
        }
        bench.links[0].reset_fault();
        let refused = IoFault::NotConfigured { node: IO, object };
        until(&mut bench, |image| image.fault != Some(IoFault::LeftOperational { node: IO }));
        assert_eq!(image(&bench).fault, Some(refused));
        assert_eq!(refused.to_string(), format!("node 5: reset failed at object {object}"));
    }
}

#[test]
fn a_fault_of_the_bus_ends_a_reset_and_stays_until_the_next_one() {
    let mut bench = booted();
    bench.links[0].reset_fault();
    (0..20).for_each(|_| _ = cycle(&mut bench, &[]));
    let sign = Sign::Setpoint { node: IO };
    cycle(&mut bench, &["205#0F"]);
    let sent: Vec<_> = (0..500).flat_map(|_| cycle(&mut bench, &[])).collect();
    assert_eq!(commands(&sent), Vec::<&str>::new());
    assert_eq!(image(&bench).fault, Some(IoFault::OtherController { sign }));
}

#[test]
fn two_nodes_are_reset_one_command_per_cycle() {
    let other = 6;
    let mut bench = Bench::up_with_io(
        group_config(),
        &[axis_config(DRIVE)],
        &[io_config(IO), io_config(other)],
        vec![io_store(IO), io_store(other)],
    );
    cycle(&mut bench, &["705#00", "706#00"]);
    bench.links.iter().for_each(IoLink::reset_fault);
    let both = |bench: &Bench| bench.links.iter().all(|link| link.inputs.read().fault.is_none());
    let mut sent = Vec::new();
    while !both(&bench) {
        let frames = cycle(&mut bench, &["185#0302", "186#0302"]);
        assert!(frames.iter().filter(|frame| frame.starts_with("000#") || frame.starts_with("60")).count() <= 1);
        sent.extend(frames);
        assert!(bench.now < Instant::ZERO + Duration::from_secs(20), "{sent:?}");
    }
    let mut commands = commands(&sent);
    commands.sort_unstable();
    assert_eq!(commands, ["000#0105", "000#0106", "000#8205", "000#8206"]);
}
