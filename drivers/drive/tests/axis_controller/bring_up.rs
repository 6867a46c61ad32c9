//! Identification of the device on the line, and refusals before operation.

use super::*;

#[test]
fn a_drive_is_brought_up_in_manual_mode_with_its_limits_set() {
    for protocol in BOTH {
        let mut rig =
            Rig::of(Drive { mode: Mode::Pwm, setpoint: 500, status: Status::OVERCURRENT, ..Drive::new(protocol, 8) });
        rig.drive().outbox.extend(b"left over from before");
        assert_eq!(rig.bring_up(), Ok(()), "{protocol:?}");
        {
            let drive = rig.drive();
            assert_eq!((drive.mode, drive.setpoint, drive.max_current, drive.status), (Mode::Manual, 0, 15_000, 0));
        }
        let state = rig.run(2, AxisCommand::Off);
        assert_eq!((state.age, state.power, state.fault), (0, Power::Off, None));
        assert_eq!((state.increments.0, state.homing), (1_000, Homing::NotHomed));
    }
}

#[test]
fn a_question_that_gets_no_answer_is_asked_thrice() {
    for protocol in BOTH {
        for (mute, right) in [(2, true), (3, false)] {
            let mut rig = Rig::of(Drive { mute, ..Drive::new(protocol, 8) });
            let result = rig.bring_up();
            assert_eq!(result.is_ok(), right, "{protocol:?} {mute}: {result:?}");
        }
    }
}

#[test]
fn a_late_answer_to_a_repeated_question_is_not_that_to_the_next() {
    for protocol in BOTH {
        let mut rig = Rig::of(Drive::new(protocol, 8));
        let (mut answers, mut delivered) = (Vec::new(), 0);
        let result = (0..1_000).find_map(|_| {
            rig.now += PERIOD;
            let answer: Vec<u8> = rig.drive().outbox.drain(..).collect();
            answers.extend((!answer.is_empty()).then_some(answer));
            // The first answer is held back until the request is repeated, and so are the following answers.
            if answers.len() >= 2 && delivered < answers.len() {
                rig.drive().outbox.extend(&answers[delivered]);
                delivered += 1;
            }
            let heard = rig.drive().heard.len();
            let result = rig.group.bring_up(rig.now);
            if rig.drive().heard.len() > heard && heard >= 2 {
                assert_eq!(delivered, answers.len(), "{protocol:?}");
            }
            result.is_ready().then_some(result)
        });
        assert_eq!(result, Some(Poll::Ready(Ok(()))), "{protocol:?}");
    }
}

#[test]
fn a_drive_that_a_dead_host_left_with_torque_is_off_by_the_first_telegram_that_can_say_so() {
    for (protocol, telegrams) in [(Protocol::Nfv2, 1), (Protocol::HiMoxa, 2)] {
        let mut rig = Rig::of(Drive { mode: Mode::Pwm, setpoint: 500, ..Drive::new(protocol, 8) });
        while rig.drive().heard.len() < telegrams {
            assert!(rig.group.bring_up(rig.now).is_pending());
            rig.now += PERIOD;
        }
        let drive = rig.drive();
        assert_eq!((drive.setpoint, drive.mode), (0, Mode::Manual));
    }
}

#[test]
fn a_line_whose_answers_take_longer_than_a_period_is_refused() {
    for protocol in BOTH {
        for (delay, right) in [(1, true), (2, false), (4, false)] {
            let mut rig = Rig::of(Drive::new(protocol, 8));
            let mut under_way = vec![Vec::new(); delay - 1];
            let result = (0..1_000).find_map(|_| {
                rig.now += PERIOD;
                let answer: Vec<u8> = rig.drive().outbox.drain(..).collect();
                under_way.push(answer);
                let arrived = under_way.remove(0);
                rig.drive().outbox.extend(arrived);
                match rig.group.bring_up(rig.now) {
                    Poll::Ready(result) => Some(result),
                    Poll::Pending => None,
                }
            });
            let late = matches!(
                result,
                Some(Err(BringUpError::AxisController { error: AxisControllerError::Late { .. }, .. }))
            );
            assert_eq!(result == Some(Ok(())), right, "{protocol:?} {delay}");
            assert_eq!(late, !right, "{protocol:?} {delay}: {result:?}");
        }
    }
}

#[test]
fn calls_of_a_host_that_catches_up_make_no_answer_late() {
    for protocol in BOTH {
        let mut rig = Rig::of(Drive::new(protocol, 8));
        let result = (0..1_000).find_map(|_| {
            rig.now += PERIOD;
            let result = rig.group.bring_up(rig.now);
            // The last request has no answer yet.
            let under_way: Vec<u8> = rig.drive().outbox.drain(..).collect();
            for call in 1..=3 {
                let now = rig.now + call * Duration::from_micros(10);
                assert!(result.is_ready() || rig.group.bring_up(now).is_pending());
            }
            rig.drive().outbox.extend(under_way);
            result.is_ready().then_some(result)
        });
        assert_eq!(result, Some(Poll::Ready(Ok(()))), "{protocol:?}");
    }
}

#[test]
fn bring_up_says_who_is_at_the_other_end() {
    let error = |rig: &mut Rig| match rig.bring_up() {
        Err(BringUpError::AxisController { line: 0, error }) => error,
        other => panic!("{other:?}"),
    };
    for expected in BOTH {
        let found = match expected {
            Protocol::Nfv2 => Protocol::HiMoxa,
            Protocol::HiMoxa => Protocol::Nfv2,
        };
        let alone = |drive| Rig::with(GroupConfig::new(expected), &[axis(expected)], vec![drive]);
        assert_eq!(error(&mut alone(Drive::new(found, 8))), AxisControllerError::OtherProtocol { expected, found });
        let mut silent = alone(Drive { deaf: true, ..Drive::new(expected, 8) });
        let silence = error(&mut silent);
        assert!(matches!(silence, AxisControllerError::Silent { .. }), "{silence:?}");
        let mut gone = alone(Drive { gone: true, ..Drive::new(expected, 8) });
        assert_eq!(error(&mut gone), AxisControllerError::Line(LineError::Gone));
        let mut dark = alone(Drive { status: Status::POWER_STAGE_FAULT, ..Drive::new(expected, 8) });
        assert_eq!(error(&mut dark), AxisControllerError::PowerStage);
        // After the drive is switched on, the same group comes up.
        dark.drive().status = 0;
        assert_eq!(dark.bring_up(), Ok(()));
    }
    for found in [0, 9, 15] {
        let mut swapped = Rig::of(Drive::new(Protocol::Nfv2, found));
        let other = AxisControllerError::OtherAddress { expected: 8, found };
        assert_eq!(error(&mut swapped), other);
    }
    let other = AxisControllerError::OtherAddress { expected: 8, found: 9 };
    // A device that answers regardless of the request.
    let mut shouting = Rig::of(Drive { deaf: true, ..Drive::new(Protocol::Nfv2, 8) });
    let frame =
        [0x23, 0x12, 0xED, 0x09, 0x1A, 0x04, 0x2E, 0xFB, 0xFF, 0xFF, 0x1B, 0x02, 0xFA, 0x00, 0x1F, 0x02, 0x10, 0x00];
    let crc = serial::nfv2::crc8(&frame[3..]);
    let result = (0..1_000).find_map(|_| {
        shouting.drive().outbox.extend(frame.into_iter().chain([crc]));
        shouting.now += PERIOD;
        match shouting.group.bring_up(shouting.now) {
            Poll::Ready(result) => Some(result),
            Poll::Pending => None,
        }
    });
    let error = BringUpError::AxisController { line: 0, error: other };
    assert_eq!(result, Some(Err(error)));
    let text = BringUpError::AxisController { line: 2, error: other };
    assert_eq!(text.to_string(), "line 2: answers as address 9, the cell says 8: check which line goes where");
    assert_eq!((text.line(), text.node()), (Some(2), None));
}

#[test]
fn noise_is_no_drive() {
    for protocol in BOTH {
        let mut rig = Rig::of(Drive { deaf: true, ..Drive::new(protocol, 8) });
        let result = (0..1_000).find_map(|n| {
            rig.drive().outbox.extend([0x55; 11]);
            rig.now += PERIOD;
            match rig.group.bring_up(rig.now) {
                Poll::Ready(result) => Some((n, result)),
                Poll::Pending => None,
            }
        });
        let Some((_, Err(BringUpError::AxisController { error, .. }))) = result else {
            panic!("{result:?}");
        };
        assert!(matches!(error, AxisControllerError::Garbled { .. }), "{error:?}");
    }
}

#[test]
fn a_drive_that_kept_its_reference_is_homed_at_once() {
    for protocol in BOTH {
        let mut rig = Rig::up(Drive { status: Status::SYNCHRONIZED, ..Drive::new(protocol, 8) });
        assert_eq!(rig.cycle(AxisCommand::Off).homing, Homing::Attained);
    }
}

#[test]
fn what_cannot_work_is_refused_before_a_byte_is_sent() {
    type Change = fn(&mut GroupConfig, &mut AxisConfig);
    let cases: [(Protocol, Change, &str); 9] = [
        (Protocol::Nfv2, |_, axis| axis.address = 0xFE, "address"),
        (Protocol::Nfv2, |_, axis| axis.max_current = 40.0, "greatest current"),
        (Protocol::Nfv2, |_, axis| axis.max_current = f64::NAN, "greatest current"),
        (Protocol::Nfv2, |_, axis| axis.torque_constant = 0.0, "torque constant"),
        (Protocol::Nfv2, |_, axis| axis.max_velocity = 0.0, "greatest velocity"),
        (Protocol::Nfv2, |_, axis| axis.max_acceleration = f64::INFINITY, "acceleration"),
        (Protocol::HiMoxa, |_, axis| axis.control = Control::Current, "takes protocol nfv2"),
        (Protocol::Nfv2, |group, _| group.period = Duration::from_micros(400), "too short"),
        (Protocol::Nfv2, |group, _| group.tolerated_missing = 0, "at least 1"),
    ];
    for (protocol, change, word) in cases {
        let (mut group, mut axis) = (GroupConfig::new(protocol), axis(protocol));
        change(&mut group, &mut axis);
        let line = Drive::new(protocol, 8).shared();
        match AxisControllerGroup::new(vec![line.clone()], group, &[axis]) {
            Ok(_) => panic!("{word} was accepted"),
            Err(error) => assert!(error.to_string().contains(word), "{error}"),
        }
        assert!(line.drive().heard.is_empty());
    }
    let none = AxisControllerGroup::<Shared>::new(vec![], GroupConfig::new(Protocol::Nfv2), &[]);
    assert_eq!(none.err(), Some(ConfigError::Axes(0)));
}
