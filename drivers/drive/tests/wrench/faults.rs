//! Every fault of a sensor on a serial line, and its reset.

use super::*;

#[test]
fn silence_is_a_fault_after_the_tolerated_cycles() {
    for tolerated in [0, 3, 20] {
        let mut rig = Rig::up_with(config(|sensor| sensor.tolerated_missing = tolerated), Board::new());
        let last = rig.run(3);
        rig.line.board().deaf = true;
        // The answer to the last query still comes.
        assert_eq!(rig.cycle().age, 0);
        let (cycles, fault) = rig.until_fault();
        let age = tolerated + 1;
        assert_eq!((cycles, fault), (age as usize, WrenchFault::Silent { cycles: age }));
        let state = rig.link.read();
        assert_eq!((state.age, state.measured(), state.wrench), (age, None, last.wrench));
    }
}

#[test]
fn a_query_that_the_line_refuses_counts_as_missing() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().full = true;
    assert_eq!(rig.cycle().age, 0);
    let (cycles, fault) = rig.until_fault();
    assert_eq!((cycles, fault), (4, WrenchFault::Silent { cycles: 4 }));
    assert!(rig.sensor.counters().port.refused > 3);
}

#[test]
fn answers_of_another_length_are_garbage() {
    for surplus in [-13, -1, 1, 4] {
        let mut rig = Rig::up();
        rig.run(3);
        rig.line.board().surplus = surplus;
        assert_eq!(rig.cycle().age, 0);
        let (cycles, fault) = rig.until_fault();
        // Garbage, a quiet reading, garbage, a quiet reading.
        assert_eq!((cycles, fault), (4, WrenchFault::Garbage { readings: 2 }), "{surplus}");
        assert_eq!(rig.sensor.sensor_counters().garbage, 2);
    }
}

#[test]
fn a_sensor_that_restarts_sends_text_and_that_is_garbage() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().deaf = true;
    rig.cycle();
    let mut cycles = 0;
    let fault = loop {
        rig.line.board().outbox.extend(b"text of a board that starts");
        cycles += 1;
        if let Some(fault) = rig.cycle().fault {
            break fault;
        }
    };
    assert_eq!((cycles, fault), (4, WrenchFault::Garbage { readings: 4 }));
    // After the text the reset succeeds without a new bring-up.
    rig.line.board().deaf = false;
    rig.link.reset_fault();
    let state = rig.run(4);
    assert_eq!((state.fault, state.age), (None, 0));
}

#[test]
fn answers_that_are_always_a_cycle_late_are_another_rate() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().delay = 1;
    assert_eq!(rig.cycle().age, 0);
    let (cycles, fault) = rig.until_fault();
    assert_eq!((cycles, fault), (4, WrenchFault::OfAnotherRate { declared: PERIOD, found: 2 * PERIOD }));
    assert_eq!(rig.sensor.sensor_counters().late, 2);
}

#[test]
fn answers_of_another_query_are_withdrawn_before_they_exceed_the_tolerated_samples() {
    // Answers come more than two periods late: after a quiet reading.
    let tolerated = WrenchConfig::ATI.tolerated_missing as usize;
    let mut rig = Rig::up();
    let mut loads = Vec::new();
    let mut cycle = |rig: &mut Rig| {
        rig.line.board().load[0] = loads.len() as i16;
        loads.push(rig.now + PERIOD);
        let state = rig.cycle();
        let queried = loads.iter().rposition(|at| *at < state.sampled).unwrap_or(0);
        let wrong = state.age == 0 && ((state.wrench[0] / FORCE).round() as usize) != queried;
        (state, wrong)
    };
    assert!((0..5).all(|_| !cycle(&mut rig).1));
    rig.line.board().delay = 2;
    assert_eq!(cycle(&mut rig).0.age, 0);
    let states: Vec<_> = (0..=tolerated).map(|_| cycle(&mut rig)).collect();
    assert_eq!(states.iter().filter(|(_, wrong)| *wrong).count(), 1, "{states:?}");
    let late = WrenchFault::OfAnotherRate { declared: PERIOD, found: 2 * PERIOD };
    assert_eq!(states[tolerated].0.fault, Some(late), "{states:?}");
    // Once the answers are in time, the reset holds.
    rig.line.board().delay = 0;
    (0..4).for_each(|_| _ = cycle(&mut rig));
    rig.link.reset_fault();
    let states: Vec<_> = (0..70).map(|_| cycle(&mut rig)).collect();
    assert!(states[4..].iter().all(|(state, wrong)| state.fault.is_none() && state.age == 0 && !wrong), "{states:?}");
}

#[test]
fn more_than_a_fifth_of_missing_samples_is_a_fault_that_counts_them() {
    // One query in six is lost, which costs two samples of seven; or one in ten, which costs two of eleven.
    for (lost_of, fails) in [(6, true), (10, false)] {
        let mut rig = Rig::up();
        rig.run(3);
        let mut heard = 0;
        let fault = (0..1_000).find_map(|_| {
            let count = rig.line.board().heard.len();
            if count != heard {
                heard = count;
                rig.line.board().mute = u32::from(count.is_multiple_of(lost_of));
            }
            rig.cycle().fault
        });
        match fault {
            Some(WrenchFault::Missing { missing: 18..=20, of: 64 }) => assert!(fails, "{lost_of}: {fault:?}"),
            _ => assert!(!fails && fault.is_none(), "{lost_of}: {fault:?}"),
        }
    }
}

#[test]
fn counts_at_the_range_are_saturation_and_never_a_wrench() {
    for (channel, axis) in WrenchAxis::ALL.into_iter().enumerate() {
        let range = WrenchConfig::ATI.channels[channel].range as i16;
        for counts in [range, -range, i16::MIN, i16::MAX] {
            let mut rig = Rig::up();
            rig.line.board().load[channel] = range - 1;
            let last = rig.run(3);
            assert_eq!(last.fault, None);
            rig.line.board().load[channel] = counts;
            assert_eq!(rig.cycle().fault, None);
            // One saturated sample is tolerated.
            let first = rig.cycle();
            assert_eq!((first.fault, first.age, first.wrench), (None, 1, last.wrench));
            let second = rig.cycle();
            let fault = WrenchFault::Saturated { axis, counts: counts.into() };
            assert_eq!((second.fault, second.wrench), (Some(fault), last.wrench));
            assert_eq!(rig.sensor.sensor_counters().saturated, 2);
            // The reset holds once the tool is free.
            rig.link.reset_fault();
            rig.run(1);
            let still = WrenchFault::StillSaturated { axis, counts: counts.into() };
            assert_eq!(rig.run(2).fault, Some(still));
            rig.line.board().load[channel] = 0;
            rig.run(2);
            rig.link.reset_fault();
            let state = rig.run(3);
            assert_eq!((state.fault, state.wrench[channel]), (None, 0.0));
        }
    }
}

#[test]
fn a_flipped_bit_of_one_answer_costs_one_sample() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().load[0] = 1 << 13;
    rig.cycle();
    rig.line.board().load[0] = 0;
    let states: Vec<_> = (0..3).map(|_| rig.cycle()).collect();
    assert_eq!(states.iter().map(|state| state.age).collect::<Vec<_>>(), [1, 0, 0]);
    assert!(states.iter().all(|state| state.fault.is_none() && state.wrench[0] == 0.0));
}

#[test]
fn a_line_that_is_gone_is_a_fault_at_once_and_stays_one() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().gone = true;
    let state = rig.cycle();
    assert_eq!(state.fault, Some(WrenchFault::Line(LineError::Gone)));
    rig.link.reset_fault();
    rig.cycle();
    assert_eq!(rig.cycle().fault, Some(WrenchFault::Line(LineError::Gone)));
    rig.line.board().gone = false;
    rig.cycle();
    rig.link.reset_fault();
    assert_eq!(rig.run(4).fault, None);
}

#[test]
fn the_first_fault_stays_until_its_reset() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().deaf = true;
    rig.cycle();
    let (_, fault) = rig.until_fault();
    rig.line.board().gone = true;
    assert_eq!(rig.run(10).fault, Some(fault));
    rig.line.board().gone = false;
    rig.line.board().deaf = false;
    // Samples alone clear nothing.
    let state = rig.run(10);
    assert_eq!((state.fault, state.age, state.measured()), (Some(fault), 0, None));
    rig.link.reset_fault();
    assert_eq!(rig.cycle().fault, None);
}

#[test]
fn a_reset_makes_no_old_wrench_valid() {
    let mut rig = Rig::up();
    rig.run(3);
    rig.line.board().deaf = true;
    rig.cycle();
    rig.until_fault();
    let silent = rig.run(1_000);
    assert_eq!(silent.age, 1_004);
    rig.link.reset_fault();
    for waited in 1..=8 {
        let state = rig.cycle();
        assert_eq!((state.measured(), state.age), (None, silent.age + waited));
    }
    assert_eq!(rig.link.read().fault, Some(WrenchFault::Silent { cycles: silent.age + 4 }));
    rig.line.board().deaf = false;
    rig.link.reset_fault();
    let valid = (0..4).map(|_| rig.cycle()).find(|state| state.measured().is_some()).unwrap();
    assert_eq!(valid.age, 0);
    // A sensor that is still saturated shows no wrench either, although one saturated sample is tolerated.
    rig.line.board().load[0] = i16::MAX;
    rig.until_fault();
    assert!(matches!(rig.link.read().fault, Some(WrenchFault::Saturated { axis: WrenchAxis::Fx, .. })));
    rig.link.reset_fault();
    assert!((0..8).all(|_| rig.cycle().measured().is_none()));
    assert!(matches!(rig.link.read().fault, Some(WrenchFault::StillSaturated { axis: WrenchAxis::Fx, .. })));
}

#[test]
fn faults_say_what_to_check() {
    let table = [
        (WrenchFault::Silent { cycles: 4 }, "no sample for 4 cycles: check cable and supply of the sensor"),
        (
            WrenchFault::Missing { missing: 18, of: 64 },
            "18 of 64 samples missing: check cable, adapter and load of the connection",
        ),
        (
            WrenchFault::Saturated { axis: WrenchAxis::Tz, counts: -940 },
            "Tz went beyond its range to -940 counts: look for what the tool touches, then reset the fault",
        ),
        (
            WrenchFault::StillSaturated { axis: WrenchAxis::Fz, counts: 1_495 },
            "Fz is still beyond its range at 1495 counts: free the tool or take its load off, then reset again",
        ),
        (
            WrenchFault::OfAnotherRate { declared: PERIOD, found: 2 * PERIOD },
            "a sample every 4.0ms, declared was 2ms: check the rate of the sensor and of its connection",
        ),
    ];
    for (fault, text) in table {
        assert_eq!(fault.to_string(), text);
    }
}
