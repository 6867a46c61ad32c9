//! The telegrams of each command.

use super::*;

#[test]
fn a_sample_is_taken_before_the_set_point_that_came_with_its_request() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive { follows: true, ..Drive::new(protocol, 8) });
        let before = rig.states[0].increments.0;
        rig.cycle(AxisCommand::Follow(raw(protocol, 7)));
        let seen: Vec<i32> = (0..3).map(|_| rig.cycle(AxisCommand::Stand).increments.0 - before).collect();
        let first = 1 + seen.iter().position(|moved| *moved == 7).unwrap();
        assert_eq!((first, rig.group.delay()), (2, 2), "{protocol:?}: {seen:?}");
    }
}

#[test]
fn torque_comes_and_goes_with_a_zero_set_point_first() {
    for protocol in BOTH {
        let mut rig = Rig::up(Drive::new(protocol, 8));
        // A set-point left over from an earlier controller.
        rig.drive().setpoint = 700;
        let mut powers = Vec::new();
        for _ in 0..8 {
            let power = rig.cycle(AxisCommand::Stand).power;
            powers.push(power);
            let drive = rig.drive();
            assert_eq!(drive.setpoint, 0, "{protocol:?}");
            assert!(power != Power::On || drive.mode != Mode::Manual);
        }
        assert_eq!(powers.first(), Some(&Power::Off));
        assert!(powers.contains(&Power::Changing) && powers.ends_with(&[Power::On]));

        let state = rig.run(3, AxisCommand::Follow(raw(protocol, -321)));
        assert!(state.following && state.fault.is_none());
        assert_eq!(rig.drive().setpoint, -321);
        let mut modes = Vec::new();
        for _ in 0..4 {
            rig.cycle(AxisCommand::Off);
            let drive = rig.drive();
            modes.push(drive.mode);
            assert_eq!(drive.setpoint, 0);
        }
        assert!(modes[1..].iter().all(|mode| *mode == Mode::Manual), "{modes:?}");
        assert_eq!(rig.states[0].power, Power::Off);
    }
}

#[test]
fn the_last_thing_a_drive_hears_is_to_be_off() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.run(3, AxisCommand::Follow(raw(protocol, 500)));
        let line = rig.lines[0].clone();
        assert_eq!(line.drive().setpoint, 500);
        drop(rig.group);
        let drive = line.drive();
        assert_eq!((drive.setpoint, drive.mode), (0, Mode::Manual), "{protocol:?}");
    }
}

#[test]
fn no_old_set_point_goes_before_what_takes_torque_away() {
    for protocol in BOTH {
        // Switched off, by an emergency stop, and when the group is dropped.
        for (cycles, command) in [(2, Some(AxisCommand::Off)), (8, Some(AxisCommand::Stand)), (2, None)] {
            let mut rig = Rig::on(Drive::new(protocol, 8));
            let follow = AxisCommand::Follow(raw(protocol, 500));
            rig.run(2, follow);
            rig.drive().stalled = true;
            rig.run(2, follow);
            let line = rig.lines[0].clone();
            if let Some(command) = command {
                rig.run(cycles, command);
            } else {
                drop(rig.group);
            }
            let mut drive = line.drive();
            let held = std::mem::take(&mut drive.unsent);
            drive.hear(&held);
            let old = held.windows(2).any(|pair| pair == 500_i16.to_le_bytes());
            assert!(!old, "{protocol:?} {command:?}: {held:02X?}");
            match drive.mode {
                Mode::Manual => assert_eq!(drive.setpoint, 0),
                mode => assert_eq!(mode, Mode::Error),
            }
        }
    }
}

#[test]
fn what_cannot_be_followed_is_refused_and_never_clamped() {
    let torque = |value: f64| Setpoint::Torque(Finite::new(value).unwrap());
    let duty = |value: f64| Setpoint::Duty(Finite::new(value).unwrap());
    let position = Setpoint::Position(Finite::ZERO);
    let cases = [
        (Protocol::Nfv2, torque(1.5), None),
        (Protocol::Nfv2, torque(1.5002), Some(Refusal::OutOfRange)),
        (Protocol::Nfv2, torque(-1e300), Some(Refusal::OutOfRange)),
        (Protocol::Nfv2, duty(0.1), Some(Refusal::WrongKind)),
        (Protocol::Nfv2, position, Some(Refusal::WrongKind)),
        (Protocol::HiMoxa, duty(-1.0), None),
        (Protocol::HiMoxa, duty(1.001), Some(Refusal::OutOfRange)),
        (Protocol::HiMoxa, torque(0.1), Some(Refusal::WrongKind)),
    ];
    for (protocol, setpoint, refusal) in cases {
        for command in [AxisCommand::Follow(setpoint), AxisCommand::Seek(setpoint)] {
            let mut rig = Rig::on(Drive::new(protocol, 8));
            rig.run(2, command);
            let expected = refusal.map(AxisControllerFault::Refused);
            assert_eq!(rig.fault(), expected, "{protocol:?} {command:?}");
            if refusal.is_some() {
                assert_eq!(rig.drive().setpoint, 0);
            }
        }
    }
    let mut off = Rig::up(Drive::new(Protocol::Nfv2, 8));
    off.run(2, AxisCommand::Follow(torque(0.0)));
    assert_eq!(off.fault(), Some(AxisControllerFault::Refused(Refusal::NotOn)));
    let mut home = Rig::on(Drive::new(Protocol::Nfv2, 8));
    home.run(2, AxisCommand::Home);
    assert_eq!(home.fault(), Some(AxisControllerFault::Refused(Refusal::WrongKind)));
}

#[test]
fn a_refusal_holds_the_set_points_of_the_other_axes() {
    let axes = [axis(Protocol::Nfv2); 2];
    let drives = (0..2).map(|_| Drive::new(Protocol::Nfv2, 8)).collect();
    let mut rig = Rig::with(GroupConfig::new(Protocol::Nfv2), &axes, drives);
    rig.bring_up().unwrap();
    rig.run(6, AxisCommand::Stand);
    let follow = |value| AxisCommand::Follow(raw(Protocol::Nfv2, value));
    rig.cycle_all(&[follow(100), follow(100)]);
    rig.cycle_all(&[follow(200), follow(20_000)]);
    let setpoint = |line: usize| rig.lines[line].drive().setpoint;
    assert_eq!((setpoint(0), setpoint(1)), (100, 0));
}

#[test]
fn the_index_pulse_sets_the_counter_while_seeking() {
    for protocol in BOTH {
        for referenced_before in [false, true] {
            let status = if referenced_before { Status::SYNCHRONIZED } else { 0 };
            let mut rig = Rig::on(Drive { velocity: 20, status, ..Drive::new(protocol, 8) });
            let homing = rig.states[0].homing;
            assert_eq!(homing == Homing::Attained, referenced_before);
            let index = rig.drive().position + 213;
            rig.drive().index = Some(index);
            let seek = AxisCommand::Seek(raw(protocol, 3));
            let mut seen = Vec::new();
            for _ in 0..40 {
                let state = rig.cycle(seek);
                assert_eq!(state.fault, None, "{protocol:?} {seen:?}");
                let velocity = TAU * 20.0 / 4_000.0 / 0.002;
                assert!((state.velocity - velocity).abs() < 1e-6, "{}", state.velocity);
                if seen.last() != Some(&state.homing) {
                    seen.push(state.homing);
                }
            }
            let from = if referenced_before { seen.remove(0) } else { seen[0] };
            assert!(matches!(from, Homing::Attained | Homing::NotHomed));
            assert!(seen.ends_with(&[Homing::InProgress, Homing::Attained]), "{seen:?}");
            assert_eq!(rig.drive().index, None);
            assert_eq!(rig.drive().setpoint, 3);
            assert!(matches!(rig.drive().mode, Mode::Pwm | Mode::Current), "no second pulse");
            let far = rig.drive().position - 20 - rig.states[0].increments.0;
            assert!(far.abs() <= 20, "{far}");
            assert_eq!(rig.counters().indexed, 1);
            // Leaving the search returns to following and keeps the reference.
            let state = rig.run(4, AxisCommand::Follow(raw(protocol, 4)));
            assert_eq!((state.homing, state.fault), (Homing::Attained, None));
            assert!(matches!(rig.drive().mode, Mode::Pwm | Mode::Current));
        }
    }
}

#[test]
fn an_index_pulse_in_the_last_cycle_of_a_search_counts() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive { velocity: 20, ..Drive::new(protocol, 8) });
        rig.run(5, AxisCommand::Seek(raw(protocol, 3)));
        let index = rig.drive().position + 10;
        rig.drive().index = Some(index);
        rig.cycle(AxisCommand::Seek(raw(protocol, 3)));
        assert_eq!(rig.drive().index, None);
        let state = rig.run(4, AxisCommand::Stand);
        assert_eq!((state.homing, state.fault), (Homing::Attained, None), "{protocol:?}");
    }
}

#[test]
fn a_reference_that_no_index_pulse_has_set_is_none() {
    for protocol in BOTH {
        // The drive shows a reference, and its counter continues.
        let mut rig = Rig::on(Drive { velocity: 5, ..Drive::new(protocol, 8) });
        let seek = AxisCommand::Seek(raw(protocol, 3));
        rig.run(5, seek);
        rig.drive().status = Status::SYNCHRONIZED;
        for _ in 0..8 {
            assert_ne!(rig.cycle(seek).homing, Homing::Attained, "{protocol:?}");
        }
        let fault = rig.fault();
        assert!(
            matches!(fault, Some(AxisControllerFault::NotIndexed { position: 1_000.. })),
            "{protocol:?}: {fault:?}"
        );
        assert!(!fault.unwrap().opens_cabinet());
    }
}

#[test]
fn an_index_pulse_at_which_the_counter_hardly_changes_is_one() {
    for (protocol, index) in BOTH.into_iter().flat_map(|p| [-30, 0, 30].map(|index| (p, index))) {
        let mut rig = Rig::on(Drive { position: -600, velocity: 20, ..Drive::new(protocol, 8) });
        rig.run(5, AxisCommand::Seek(raw(protocol, 3)));
        rig.drive().index = Some(index);
        let state = rig.run(20, AxisCommand::Seek(raw(protocol, 3)));
        assert_eq!((state.homing, state.fault), (Homing::Attained, None), "{protocol:?}, {index}");
    }
}

#[test]
fn a_search_that_begins_again_after_an_index_pulse_is_no_restart() {
    for (protocol, pause) in BOTH.into_iter().flat_map(|p| [1, 2, 3].map(|n| (p, n))) {
        let mut rig = Rig::on(Drive { velocity: 20, ..Drive::new(protocol, 8) });
        let seek = AxisCommand::Seek(raw(protocol, 3));
        rig.run(5, seek);
        let index = rig.drive().position + 10;
        rig.drive().index = Some(index);
        // The pulse comes in the last cycle of the first search.
        rig.cycle(seek);
        assert_eq!(rig.drive().index, None);
        rig.run(pause, AxisCommand::Stand);
        rig.run(10, seek);
        assert_eq!(rig.fault(), None, "{protocol:?} after {pause} cycles");
    }
}

#[test]
fn a_status_bit_that_is_lost_in_one_answer_makes_no_reference_found() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive { status: Status::SYNCHRONIZED, ..Drive::new(protocol, 8) });
        let seek = AxisCommand::Seek(raw(protocol, 3));
        // The answer to the first cycle shows no reference, and the search begins with its reading.
        rig.drive().status = 0;
        rig.cycle(AxisCommand::Stand);
        rig.drive().status = Status::SYNCHRONIZED;
        for _ in 0..20 {
            let state = rig.cycle(seek);
            assert_eq!(state.fault, None, "{protocol:?}");
        }
        assert_eq!(rig.states[0].homing, Homing::InProgress, "{protocol:?}");
    }
}

#[test]
fn a_drive_that_is_mute_is_told_to_be_off_all_the_same() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.run(3, AxisCommand::Follow(raw(protocol, 100)));
        rig.drive().mute = u32::MAX;
        rig.run(2, AxisCommand::Off);
        let drive = rig.drive();
        assert_eq!((drive.mode, drive.setpoint), (Mode::Manual, 0), "{protocol:?}");
    }
}
