//! Outputs: when a command is sent, and what happens if the port does not take it.

use super::bench::*;

/// The frames of a cycle except those of the drive.
fn of_io(frames: &[String]) -> Vec<&str> {
    frames.iter().map(String::as_str).filter(|frame| !frame.starts_with("080") && !frame.starts_with("202")).collect()
}

#[test]
fn outputs_are_sent_behind_the_set_points_when_they_change() {
    let mut bench = up();
    // A node that has not heard the host would not notice its silence.
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["77F#05"]);
    assert_eq!(image(&bench).sent, None);
    // The error values first.
    let frames = cycle(&mut bench, &[]);
    assert_eq!(frames, ["080#", "202#0000E8030000", "205#01"]);
    let at = bench.now;
    assert_eq!(of_io(&cycle(&mut bench, &[])), NONE);
    assert_eq!(image(&bench).sent, Some(SentOutputs { levels: 1, cycle: 1, at }));

    bench.links[0].outputs.set(3, true);
    bench.links[0].outputs.set(0, false);
    // An output that the node lacks.
    bench.links[0].outputs.set(4, true);
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["205#08"]);
    let at = bench.now;
    assert_eq!(of_io(&cycle(&mut bench, &[])), NONE);
    assert_eq!(image(&bench).sent, Some(SentOutputs { levels: 8, cycle: 3, at }));
}

#[test]
fn outputs_that_the_port_does_not_take_are_sent_in_the_next_cycle() {
    let mut bench = up();
    (0..3).for_each(|_| _ = cycle(&mut bench, &[]));
    bench.links[0].outputs.set_all(0b0110);
    // SYNC and the set-point.
    bench.bus.0.lock().unwrap().takes = Some(2);
    for _ in 0..2 {
        assert_eq!(of_io(&cycle(&mut bench, &[])), NONE);
        assert_eq!(image(&bench).sent.unwrap().levels, 1);
    }
    // Of two changes the last one is sent.
    bench.links[0].outputs.set_all(0b0111);
    bench.bus.0.lock().unwrap().takes = None;
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["205#07"]);
    cycle(&mut bench, &[]);
    assert_eq!((image(&bench).sent.unwrap().cycle, image(&bench).fault), (5, None));
    assert_eq!(bench.group.counters().dropped_setpoints, 0);
}

#[test]
fn outputs_behind_a_heartbeat_are_offered_again_and_delay_no_heartbeat() {
    let mut bench = up_with_heartbeats(5);
    (0..5).for_each(|_| _ = cycle(&mut bench, &[]));
    bench.links[0].outputs.set_all(0b0110);
    // SYNC, the set-point and the heartbeat.
    bench.bus.0.lock().unwrap().takes = Some(3);
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["77F#05"]);
    bench.bus.0.lock().unwrap().takes = None;
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["205#06"]);
    // No heartbeat either: both follow in the next cycle.
    (0..3).for_each(|_| assert_eq!(of_io(&cycle(&mut bench, &[])), NONE));
    bench.bus.0.lock().unwrap().takes = Some(2);
    assert_eq!(of_io(&cycle(&mut bench, &[])), NONE);
    bench.bus.0.lock().unwrap().takes = None;
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["77F#05", "205#06"]);
}

/// A drive and an I/O node, brought up, with a heartbeat period of so many cycles.
fn up_with_heartbeats(cycles: u32) -> Bench {
    let config = GroupConfig { heartbeat_period: cycles * PERIOD, ..group_config() };
    Bench::up_with_io(config, &[axis_config(DRIVE)], &[io_config(IO)], vec![io_store(IO)])
}

#[test]
fn the_last_outputs_are_repeated_with_each_heartbeat() {
    let mut bench = up_with_heartbeats(5);
    (0..2).for_each(|_| _ = cycle(&mut bench, &[]));
    bench.links[0].outputs.set_all(0b0110);
    assert_eq!(of_io(&cycle(&mut bench, &["705#05"])), ["205#06"]);
    let at = bench.now;
    for _ in 0..4 {
        while of_io(&cycle(&mut bench, &["705#05"])).is_empty() {}
        // The loop has ended at a heartbeat.
        let frames = sent(&bench);
        assert_eq!(frames[frames.len() - 2..], ["77F#05", "205#06"]);
        cycle(&mut bench, &["705#05"]);
        // A repetition is no new command.
        assert_eq!(image(&bench).sent, Some(SentOutputs { levels: 0b0110, cycle: 2, at }));
    }
    assert_eq!(image(&bench).fault, None);
}

#[test]
fn inverted_outputs_are_inverted_on_the_bus_only() {
    let mut bench = up_with(IoConfig { inverted_outputs: 0b1001, ..io_config(IO) });
    cycle(&mut bench, &[]);
    // The error value 0001.
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["205#08"]);
    bench.links[0].outputs.set_all(0b1100);
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["205#05"]);
    // The error state: output 0 on, 1 and 3 off, output 2 as it is.
    assert_eq!(of_io(&cycle(&mut bench, &["705#7F"])), ["205#0C"]);
    assert_eq!(image(&bench).sent.unwrap().levels, 0b1100);
}

#[test]
fn outputs_that_the_port_never_takes_are_a_fault() {
    let mut bench = up();
    (0..3).for_each(|_| _ = cycle(&mut bench, &[]));
    bench.links[0].outputs.set_all(0b0110);
    bench.bus.0.lock().unwrap().takes = Some(2);
    // Two are tolerated.
    for _ in 0..3 {
        cycle(&mut bench, &[]);
        assert_eq!(image(&bench).fault, None);
    }
    cycle(&mut bench, &[]);
    assert_eq!(image(&bench).fault, Some(IoFault::OutputsNotSent { node: IO, cycles: 3 }));
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn a_command_that_is_taken_back_before_it_was_sent_is_no_fault() {
    let mut bench = up();
    (0..3).for_each(|_| _ = cycle(&mut bench, &[]));
    for _ in 0..4 {
        bench.links[0].outputs.set_all(0b0110);
        bench.bus.0.lock().unwrap().takes = Some(2);
        (0..2).for_each(|_| _ = cycle(&mut bench, &[]));
        bench.links[0].outputs.set_all(0b0001);
        cycle(&mut bench, &[]);
    }
    assert_eq!(image(&bench).fault, None);
}

#[test]
fn the_outputs_of_a_faulted_node_are_commanded_to_their_error_state() {
    let mut bench = up();
    (0..3).for_each(|_| _ = cycle(&mut bench, &[]));
    bench.links[0].outputs.set_all(0b1110);
    assert_eq!(of_io(&cycle(&mut bench, &[])), ["205#0E"]);
    // Output 2 keeps its level.
    assert_eq!(of_io(&cycle(&mut bench, &["705#7F"])), ["205#05"]);
    bench.links[0].outputs.set_all(0b1010);
    assert_eq!(of_io(&cycle(&mut bench, &[])), NONE);
}

#[test]
fn the_bus_load_counts_inputs_by_their_inhibit_time_and_outputs_in_every_cycle() {
    let axes = [axis_config(DRIVE)];
    let none = IoConfig { inputs: 0, ..io_config(6) };
    let frames = traffic(&group_config(), &axes, &[io_config(IO), none], &[]);
    let of_io = frames.iter().filter(|frame| matches!(frame.cob_id.raw() & 0x7F, 5 | 6));
    let of_io: Vec<_> =
        of_io.map(|frame| (frame.cob_id.raw(), frame.bytes, frame.period.as_micros(), frame.what)).collect();
    let expected = [
        (0x205, 1, 2_000, "outputs"),
        (0x185, 2, 1_000, "inputs"),
        (0x705, 1, 2_000_000, "heartbeat"),
        (0x206, 1, 2_000, "outputs"),
        (0x706, 1, 2_000_000, "heartbeat"),
    ];
    assert_eq!(of_io, expected);
}

#[test]
fn a_bus_of_io_nodes_alone_carries_no_sync() {
    let config = GroupConfig { heartbeat_period: 5 * PERIOD, ..group_config() };
    let mut bench = Bench::up_with_io(config, &[], &[io_config(IO)], vec![io_store(IO)]);
    let cycle = |bench: &mut Bench| bench.cycle(&["705#05"], &[]);
    // The heartbeat of the host, and the error values behind it. Then the bus is silent until the next heartbeat.
    assert_eq!(cycle(&mut bench), ["77F#05"]);
    assert_eq!(cycle(&mut bench), ["205#01"]);
    (0..3).for_each(|_| assert_eq!(cycle(&mut bench), NONE));
    assert_eq!(cycle(&mut bench), ["77F#05", "205#01"]);
    bench.links[0].outputs.set_all(0b0110);
    assert_eq!(cycle(&mut bench), ["205#06"]);
    // Refused outputs do not count as refused set-points, and other buses continue to receive set-points.
    bench.links[0].outputs.set_all(0b0111);
    bench.bus.0.lock().unwrap().takes = Some(0);
    assert_eq!(cycle(&mut bench), NONE);
    assert!(bench.group.send(bench.now));
    bench.bus.0.lock().unwrap().takes = None;
    assert_eq!(cycle(&mut bench), ["205#07"]);
    let counters = bench.group.counters();
    assert_eq!((counters.dropped_syncs, counters.dropped_setpoints, counters.unexpected), (0, 0, 0));
    assert_eq!(image(&bench).fault, None);
}

#[test]
fn the_bus_load_counts_sync_only_for_nodes_with_synchronous_process_data() {
    let syncs = |axes: &[AxisConfig]| {
        let traffic = traffic(&group_config(), axes, &[io_config(IO)], &[]);
        traffic.iter().filter(|frame| frame.what == "SYNC").count()
    };
    assert_eq!((syncs(&[axis_config(DRIVE)]), syncs(&[])), (1, 0));
}
