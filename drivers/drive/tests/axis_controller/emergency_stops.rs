//! Faults that stop all axes of a cabinet through its emergency-stop circuit.

use super::*;

#[test]
fn missing_answers_are_ridden_through_and_then_stop_the_cabinet() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().mute = 2;
        let follow = AxisCommand::Follow(raw(protocol, 100));
        let ages: Vec<u32> = (0..5).map(|_| rig.cycle(follow).age).collect();
        // In the older protocol, a telegram is left out after the first missing answer.
        let expected = if protocol == Protocol::Nfv2 { [0, 1, 2, 0, 0] } else { [0, 1, 2, 3, 0] };
        assert_eq!((&ages[..], rig.fault()), (&expected[..], None));
        rig.drive().mute = 3;
        rig.run(6, follow);
        assert_eq!(rig.fault(), Some(AxisControllerFault::Silent { cycles: 3 }));
        // The drive may receive telegrams although its answers are lost.
        assert_eq!(rig.drive().mode, Mode::Error);
        rig.run(3, AxisCommand::Off);
        assert_eq!(rig.drive().mode, Mode::Error, "an emergency stop ends by a reset alone");
        rig.run(6, AxisCommand::ResetFault);
        assert_eq!((rig.drive().mode, rig.fault()), (Mode::Manual, None));
    }
}

#[test]
fn an_emergency_stop_of_one_axis_tells_every_drive_to_open_the_cabinet() {
    type Break = fn(&mut Drive);
    let breaks: [(&str, Break); 4] = [
        ("silent", |drive| drive.mute = u32::MAX),
        ("full", |drive| drive.full = true),
        ("gone", |drive| drive.gone = true),
        ("jumped", |drive| drive.position = 90_000),
    ];
    for (protocol, (name, fail)) in BOTH.into_iter().flat_map(|p| breaks.map(|b| (p, b))) {
        for failing in [0, 1] {
            let others = || [0, 1, 2].into_iter().filter(move |line| *line != failing);
            let drives = (0..3).map(|_| Drive::new(protocol, 8)).collect();
            let config = GroupConfig::new(protocol);
            let mut rig = Rig::with(config, &[axis(protocol); 3], drives);
            rig.bring_up().unwrap();
            rig.run(6, AxisCommand::Stand);
            fail(&mut rig.lines[failing].drive());
            let follow = AxisCommand::Follow(raw(protocol, 100));
            for _ in 0..6 {
                rig.cycle(follow);
                if rig.states[failing].fault.is_some() {
                    break;
                }
            }
            assert!(rig.states[failing].fault.is_some(), "{protocol:?} {name}");
            for line in others() {
                assert_eq!(rig.states[line].fault, None, "whoever failed is named first");
                let mode = rig.lines[line].drive().mode;
                assert_eq!(mode, Mode::Error, "{protocol:?} {name}: in the same cycle");
            }
            // For every command, and when the group is dropped.
            rig.run(10, AxisCommand::Off);
            let with = AxisControllerFault::Cabinet { line: failing as u8 };
            for line in others() {
                let fault = Fault::AxisController { line: line as u8, fault: with };
                assert_eq!(rig.states[line].fault, Some(fault), "{protocol:?} {name}");
                assert_eq!(rig.states[line].power, Power::Off);
                assert_eq!(rig.lines[line].drive().mode, Mode::Error);
            }
            // A reset of one axis does not close the circuit while another axis is unknown.
            let mut commands = [AxisCommand::Off; 3];
            let one = others().next_back().unwrap();
            commands[one] = AxisCommand::ResetFault;
            rig.cycle_all(&commands);
            commands[one] = AxisCommand::Off;
            rig.cycle_all(&commands);
            assert_eq!(rig.lines[one].drive().mode, Mode::Error, "{protocol:?} {name}");
            let lines = rig.lines.clone();
            drop(rig.group);
            for line in others() {
                assert_eq!(lines[line].drive().mode, Mode::Error, "{protocol:?} {name}");
            }
        }
    }
}

#[test]
fn a_reset_ends_an_emergency_stop_of_the_group() {
    for protocol in BOTH {
        let drives = (0..2).map(|_| Drive::new(protocol, 8)).collect();
        let mut rig = Rig::with(GroupConfig::new(protocol), &[axis(protocol); 2], drives);
        rig.bring_up().unwrap();
        rig.lines[1].drive().mute = 3;
        rig.run(6, AxisCommand::Off);
        assert!(rig.states.iter().all(|state| state.fault.is_some()));
        rig.run(6, AxisCommand::ResetFault);
        rig.run(6, AxisCommand::Stand);
        for (line, state) in rig.lines.iter().zip(&rig.states) {
            assert_eq!((state.fault, state.power), (None, Power::On), "{protocol:?}");
            assert!(matches!(line.drive().mode, Mode::Pwm | Mode::Current));
        }
    }
}

#[test]
fn a_set_point_that_the_line_does_not_take_is_counted_and_then_a_fault() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().full = true;
        rig.run(4, AxisCommand::Stand);
        assert_eq!(rig.fault(), Some(AxisControllerFault::NotSent { cycles: 3 }));
        let counters = rig.group.counters();
        assert_eq!((counters.dropped_setpoints, counters.missed_answers), (4, 0));
    }
}

#[test]
fn a_counter_that_jumps_stops_the_cabinet_and_is_never_followed() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().position = 90_000;
        let mut positions = Vec::new();
        for _ in 0..3 {
            positions.push(rig.cycle(AxisCommand::Stand).increments.0);
            assert_eq!(rig.fault(), None);
        }
        rig.run(3, AxisCommand::Stand);
        assert_eq!(positions, [1_000; 3]);
        let (from, to) = (1_000, 90_000);
        assert_eq!(rig.fault(), Some(AxisControllerFault::Jumped { from, to }));
        assert_eq!(rig.drive().mode, Mode::Error);
    }
}

/// The acceleration covers 25.5 increments per period, an answer may be (`tolerated_missing` + 2) periods late, and two
/// displacements are rounded by two increments each.
#[test]
fn a_counter_that_steps_is_found_from_the_stated_step_on_at_rest_and_in_motion() {
    for protocol in BOTH {
        for velocity in [0, 40, -40] {
            let tolerated = GroupConfig::new(protocol).tolerated_missing as i32;
            let least = 30 + (tolerated + 2) * 40 * i32::from(velocity != 0);
            // The reach of a period, and of two, are 160 and 287 increments from a standstill.
            let found = [least, least + 4, 3 * least / 2, 2 * least, least + 60, 160, 200, 290, 10 * least];
            let found = found.into_iter().filter(|step| *step >= least).map(|step| (step, true));
            for (step, is_found) in found.chain([(least / 2, false)]) {
                for step in [step, -step] {
                    let mut rig = Rig::on(Drive { velocity, ..Drive::new(protocol, 8) });
                    rig.run(10, AxisCommand::Stand);
                    rig.drive().position += step;
                    rig.run(6, AxisCommand::Stand);
                    let jumped = matches!(rig.fault(), Some(AxisControllerFault::Jumped { .. }));
                    let fault = rig.fault();
                    assert_eq!(jumped, is_found, "{protocol:?} at {velocity}: {step}, of {least}: {fault:?}");
                    assert!(is_found || fault.is_none(), "{protocol:?} at {velocity}: {step}: {fault:?}");
                }
            }
        }
    }
}

#[test]
fn a_counter_that_jumped_is_no_reference_for_whoever_comes_after() {
    for protocol in BOTH {
        for cycles in [0, 4] {
            let mut rig = Rig::on(Drive { status: Status::SYNCHRONIZED, ..Drive::new(protocol, 8) });
            rig.drive().position = 90_000;
            // Until the fault, and no cycle later.
            while rig.fault().is_none() {
                rig.cycle(AxisCommand::Stand);
            }
            rig.run(cycles, AxisCommand::Off);
            let line = rig.lines[0].clone();
            drop(rig.group);
            let drive = line.drive();
            assert_eq!(drive.mode, Mode::Error, "{protocol:?}");
            let synchronized = drive.status & Status::SYNCHRONIZED != 0;
            assert!(!synchronized, "{protocol:?} after {cycles} cycles");
        }
    }
}

#[test]
fn answers_that_never_change_while_set_points_do_stop_the_cabinet() {
    for protocol in BOTH {
        let follow = |value| AxisCommand::Follow(raw(protocol, value));
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.run(2, follow(500));
        rig.drive().current = 500;
        rig.run(200, follow(500));
        assert_eq!(rig.fault(), None, "a stalled motor may say the same for ever");
        rig.run(60, follow(900));
        rig.run(60, follow(100));
        assert!(matches!(rig.fault(), Some(AxisControllerFault::Frozen { .. })), "{protocol:?} {:?}", rig.fault());
    }
}

#[test]
fn a_line_that_is_gone_is_said_at_once() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().gone = true;
        rig.cycle(AxisCommand::Stand);
        assert_eq!(rig.fault(), Some(AxisControllerFault::Line(LineError::Gone)));
    }
}

#[test]
fn a_counter_that_is_set_anew_without_being_asked_to_stops_the_cabinet() {
    for protocol in BOTH {
        // A jump to zero with a reference, while following; and a jump to another position while seeking.
        for (position, seeks) in [(0, false), (50_000, true)] {
            let mut rig = Rig::on(Drive::new(protocol, 8));
            let setpoint = raw(protocol, 1);
            let command = match seeks {
                true => AxisCommand::Seek(setpoint),
                false => AxisCommand::Follow(setpoint),
            };
            rig.run(5, command);
            (rig.drive().position, rig.drive().status) = (position, Status::SYNCHRONIZED);
            rig.run(6, command);
            let fault = rig.fault();
            let jumped = matches!(fault, Some(AxisControllerFault::Jumped { .. }));
            assert!(jumped, "{protocol:?} {position}: {fault:?}");
            assert_eq!(rig.counters().indexed, 0);
        }
    }
}

#[test]
fn a_counter_that_jumped_during_a_search_never_counts_as_referenced() {
    for protocol in BOTH {
        for keeps_reference in [false, true] {
            let mut rig = Rig::on(Drive { keeps_reference, ..Drive::new(protocol, 8) });
            let seek = AxisCommand::Seek(raw(protocol, 1));
            rig.run(5, seek);
            (rig.drive().position, rig.drive().status) = (50_000, Status::SYNCHRONIZED);
            for (cycles, command) in
                [(6, seek), (4, AxisCommand::Off), (6, AxisCommand::ResetFault), (10, AxisCommand::Off)]
            {
                for _ in 0..cycles {
                    let state = rig.cycle(command);
                    let what = format!("{protocol:?} {keeps_reference} {command:?}");
                    assert_ne!(state.homing, Homing::Attained, "{what}");
                }
            }
            assert_eq!(rig.fault(), None, "{protocol:?} {keeps_reference}");
        }
    }
}

#[test]
fn the_line_of_an_axis_with_a_fault_refuses_no_set_point_of_the_others() {
    type Break = fn(&mut Drive);
    let breaks: [(&str, Break, u32); 2] = [
        ("gone", |drive| drive.gone = true, 0),
        // A full line is no fault during the first cycles, and its set-points are repeated.
        ("full", |drive| drive.full = true, 3),
    ];
    for (protocol, (name, fail, refused)) in BOTH.into_iter().flat_map(|p| breaks.map(|b| (p, b))) {
        let drives = (0..3).map(|_| Drive::new(protocol, 8)).collect();
        let mut rig = Rig::with(GroupConfig::new(protocol), &[axis(protocol); 3], drives);
        rig.bring_up().unwrap();
        rig.run(6, AxisCommand::Stand);
        fail(&mut rig.lines[1].drive());
        let mut due_again = 0;
        for _ in 0..20 {
            rig.now += PERIOD;
            rig.group.read(rig.now, &mut rig.states);
            rig.group.write(rig.now, &[AxisCommand::Stand; 3]);
            due_again += u32::from(!rig.group.send(rig.now));
        }
        assert_eq!(due_again, refused, "{protocol:?} {name}");
        assert_eq!(rig.group.counters().dropped_setpoints, 20);
    }
}
