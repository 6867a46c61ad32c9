//! Faults of a sensor on a bus, and faults of the bus.

use super::bench::*;

#[test]
fn silence_is_counted_in_samples_that_are_due() {
    let every = |every| WrenchNodeConfig { trigger: Trigger::Sync { every }, ..sensor_config() };
    for (config, age) in [(every(1), 3), (every(5), 15), (timed(2), 4), (timed(10), 16)] {
        let mut bench = Bench::down(&config);
        if let Trigger::Sync { every } = config.trigger {
            bench.sender.every = every.into();
        }
        assert_eq!(bench.bring_up(), Ok(()));
        bench.run_to_sample();
        bench.mute();
        let (_, fault) = bench.until_fault();
        assert_eq!(fault, WrenchFault::Silent { cycles: age }, "{:?}", config.trigger);
        assert_eq!(bench.link.read().measured(), None);
        // The drive beside the sensor goes on.
        assert_eq!(bench.states[0].fault, None);
    }
}

#[test]
fn frames_of_another_length_are_garbage() {
    let mut bench = Bench::up();
    bench.run(3);
    bench.sender.frames = Some(vec!["189#0000".to_owned(), "289#00000000000000".to_owned()]);
    bench.cycle();
    let before = bench.bus.counters().unexpected;
    let (cycles, fault) = bench.until_fault();
    assert_eq!((cycles, fault), (3, WrenchFault::Garbage { readings: 3 }));
    assert_eq!(bench.bus.counters().unexpected - before, 3);
}

#[test]
fn saturation_is_a_fault_and_its_reset_holds_once_the_sensor_is_unloaded() {
    for (channel, axis) in WrenchAxis::ALL.into_iter().enumerate() {
        for counts in [20_000, -20_000, i16::MIN] {
            let mut bench = Bench::up();
            bench.run(3);
            bench.sender.load[channel] = counts;
            bench.cycle();
            let fault = WrenchFault::Saturated { axis, counts: counts.into() };
            let state = bench.cycle();
            assert_eq!((state.fault, state.wrench), (Some(fault), [0.0; 6]));
            bench.sender.load[channel] = 0;
            bench.run(2);
            bench.link.reset_fault();
            assert_eq!(bench.run(2).fault, None);
        }
    }
}

#[test]
fn an_error_bit_of_the_status_is_a_fault_as_long_as_it_is_set() {
    let mut bench = Bench::up();
    bench.run(3);
    bench.sender.status = 0xF3;
    assert_eq!(bench.run(3).fault, None);
    bench.sender.status = 0xFB;
    bench.cycle();
    assert_eq!(bench.cycle().fault, Some(WrenchFault::Status { status: 0x08 }));
    bench.link.reset_fault();
    assert_eq!(bench.cycle().fault, Some(WrenchFault::Status { status: 0x08 }));
    bench.sender.status = 0;
    bench.run(2);
    bench.link.reset_fault();
    assert_eq!(bench.cycle().fault, None);
}

#[test]
fn every_sample_of_a_cycle_is_judged() {
    // Two samples per cycle; the second is in order.
    let forces = |counter: u8, fx: &str, status: u8| format!("189#{fx}00000000{counter:02X}{status:02X}");
    let torques = |counter: u8| format!("289#000000000000{counter:02X}");
    for (fx, status, fault) in [
        ("0000", 0x08, WrenchFault::Status { status: 8 }),
        ("204E", 0x00, WrenchFault::Saturated { axis: WrenchAxis::Fx, counts: 20_000 }),
    ] {
        let mut bench = Bench::up_with(&timed(1));
        assert_eq!(bench.run(10).fault, None);
        bench.mute();
        bench.cycle();
        let samples = [forces(50, fx, status), torques(50), forces(51, "0000", 0), torques(51)];
        let state = bench.cycle_with(&samples.each_ref().map(String::as_str));
        assert_eq!(state.fault, Some(fault));
    }
}

#[test]
fn a_sensor_that_changes_its_rate_in_operation_is_of_another_rate() {
    let other = |declared, found| WrenchFault::OfAnotherRate { declared, found };
    let millis = Duration::from_millis;
    // Samples at every SYNC in place of every second one; every third in place of every second one.
    for every in [1, 3] {
        let mut bench = Bench::down(&WrenchNodeConfig { trigger: Trigger::Sync { every: 2 }, ..sensor_config() });
        bench.sender.every = 2;
        assert_eq!(bench.bring_up(), Ok(()));
        assert_eq!(bench.run(300).fault, None);
        bench.sender.every = every;
        let (_, WrenchFault::OfAnotherRate { declared, found }) = bench.until_fault() else { panic!("{every}") };
        // Part of the comparison may be at the rate before.
        assert!(declared == 2 * PERIOD && found.abs_diff(declared) > declared / 4, "{every}: {found:?}");
        bench.link.reset_fault();
        bench.cycle();
        assert!(matches!(bench.until_fault(), (_, WrenchFault::OfAnotherRate { .. })));
    }
    let mut bench = Bench::up_with(&timed(4));
    assert_eq!(bench.run(300).fault, None);
    bench.sender.timer = Some(millis(2));
    bench.run(5);
    bench.link.reset_fault();
    bench.until_fault();
    bench.link.reset_fault();
    assert_eq!(bench.until_fault().1, other(millis(4), millis(2)));
}

#[test]
fn a_node_that_leaves_operational_state_is_a_fault() {
    for heartbeat in ["709#00", "709#04", "709#7F"] {
        let mut bench = Bench::up();
        assert_eq!(bench.cycle_with(&["709#05"]).fault, None);
        assert_eq!(bench.cycle_with(&[heartbeat]).fault, Some(WrenchFault::LeftOperational), "{heartbeat}");
        // The next heartbeat does not undo what the boot lost.
        bench.link.reset_fault();
        assert_eq!(bench.cycle_with(&["709#05"]).fault, Some(WrenchFault::LeftOperational));
    }
}

#[test]
fn a_lost_heartbeat_is_a_fault() {
    let mut bench = Bench::up();
    // Three periods of 2 s, in cycles of 2 ms. The drive speaks meanwhile.
    let fault = (0..3_100).find_map(|cycle| bench.cycle_with(&["702#05"]).fault.map(|fault| (cycle, fault)));
    let Some((cycle, WrenchFault::HeartbeatLost { waited })) = fault else { panic!("{fault:?}") };
    assert_eq!((cycle, waited), (3_001, Duration::from_millis(6_002)));
}

#[test]
fn a_fault_of_the_bus_is_a_fault_of_the_sensor() {
    let sign = Sign::Setpoint { node: SENSOR };
    let mut bench = Bench::up();
    assert_eq!(bench.cycle_with(&["209#00"]).fault, Some(WrenchFault::OtherController { sign }));
    assert_eq!(bench.states[0].fault, Some(Fault::OtherController { sign }));
    let mut bench = Bench::up();
    bench.run(3);
    bench.end.0.lock().unwrap().state = ControllerState::BusOff;
    assert_eq!(bench.cycle().fault, Some(WrenchFault::BusOff));
    let mut bench = Bench::up();
    bench.run(3);
    bench.end.0.lock().unwrap().error = Some(PortError::Down);
    assert_eq!(bench.cycle().fault, Some(WrenchFault::Port(PortError::Down)));
}

#[test]
fn an_emcy_of_the_sensor_is_a_warning() {
    let mut bench = Bench::up();
    assert_eq!(bench.cycle_with(&["089#1050010000000000"]).fault, None);
    let warning = *bench.bus.warnings().iter().next().unwrap();
    assert_eq!(
        (warning.node, warning.cause.emergency().map(|(code, _)| code), warning.count),
        (SENSOR, Some(0x5010), 1)
    );
}
