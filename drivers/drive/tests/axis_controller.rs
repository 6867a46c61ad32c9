//! What serial axis controllers are told, believed and blamed for, in both protocols.
#![allow(clippy::unwrap_used, reason = "a test")]

mod scripted;

use std::f64::consts::TAU;
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use mrroc_drive::axis_controller::{
    AxisConfig, AxisControllerError, AxisControllerFault, AxisControllerGroup, AxisCounters,
    ConfigError, Control, CurrentGains, GroupConfig, Protocol,
};
use mrroc_drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, Fault, Finite, Homing, Power, Refusal, Scale,
    Setpoint,
};
use scripted::{Drive, Shared};
use serial::LineError;
use serial::nfv2::{Mode, Status};

const PERIOD: Duration = Duration::from_millis(2);
const BOTH: [Protocol; 2] = [Protocol::Nfv2, Protocol::HiMoxa];

/// 4000 increments a turn; 100 rad/s are 127 increments a cycle.
fn axis(protocol: Protocol) -> AxisConfig {
    AxisConfig {
        address: 8,
        scale: Scale::new(4_000, 0.0).unwrap(),
        torque_constant: 0.1,
        control: match protocol {
            Protocol::Nfv2 => Control::Current,
            Protocol::HiMoxa => Control::Pwm,
        },
        max_current: 15.0,
        max_velocity: 100.0,
        max_acceleration: 10_000.0,
        current_gains: None,
    }
}

/// A set-point of so many mA or thousandths, whichever the protocol's axis takes.
fn raw(protocol: Protocol, value: i16) -> Setpoint {
    let value = f64::from(value) / 1_000.0;
    match protocol {
        Protocol::Nfv2 => Setpoint::Torque(Finite::new(value * 0.1).unwrap()),
        Protocol::HiMoxa => Setpoint::Duty(Finite::new(value).unwrap()),
    }
}

struct Rig {
    group: AxisControllerGroup<Shared>,
    lines: Vec<Shared>,
    states: Vec<AxisState>,
    now: Instant,
}

impl Rig {
    fn with(config: GroupConfig, axes: &[AxisConfig], drives: Vec<Drive>) -> Self {
        let lines: Vec<Shared> = drives.into_iter().map(Drive::shared).collect();
        Self {
            group: AxisControllerGroup::new(lines.clone(), config, axes).unwrap(),
            states: vec![AxisState::default(); axes.len()],
            lines,
            now: Instant::from_nanos(1_000_000_000),
        }
    }

    fn of(drive: Drive) -> Self {
        let protocol = drive.protocol;
        Self::with(GroupConfig::new(protocol), &[axis(protocol)], vec![drive])
    }

    fn bring_up(&mut self) -> Result<(), BringUpError> {
        for _ in 0..1_000 {
            if let Poll::Ready(result) = self.group.bring_up(self.now) {
                return result;
            }
            self.now += PERIOD;
        }
        panic!("bring-up does not end");
    }

    fn up(drive: Drive) -> Self {
        let mut rig = Self::of(drive);
        rig.bring_up().unwrap();
        rig
    }

    /// With torque.
    fn on(drive: Drive) -> Self {
        let mut rig = Self::up(drive);
        rig.run(6, AxisCommand::Stand);
        assert_eq!(rig.states[0].power, Power::On);
        rig
    }

    fn cycle(&mut self, command: AxisCommand) -> AxisState {
        let commands = vec![command; self.states.len()];
        self.cycle_all(&commands);
        self.states[0]
    }

    fn cycle_all(&mut self, commands: &[AxisCommand]) {
        self.now += PERIOD;
        self.group.read(self.now, &mut self.states);
        self.group.write(self.now, commands);
        self.group.send(self.now);
    }

    fn run(&mut self, cycles: usize, command: AxisCommand) -> AxisState {
        for _ in 0..cycles {
            self.cycle(command);
        }
        self.states[0]
    }

    fn drive(&self) -> std::sync::MutexGuard<'_, Drive> {
        self.lines[0].drive()
    }

    fn counters(&self) -> AxisCounters {
        self.group.axis_counters().next().unwrap()
    }

    fn fault(&self) -> Option<AxisControllerFault> {
        match self.states[0].fault {
            Some(Fault::AxisController { line: 0, fault }) => Some(fault),
            None => None,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_drive_is_brought_up_in_manual_mode_with_its_limits_set() {
    for protocol in BOTH {
        let mut rig = Rig::of(Drive {
            mode: Mode::Pwm,
            setpoint: 500,
            status: Status::OVERCURRENT,
            ..Drive::new(protocol, 8)
        });
        rig.drive().outbox.extend(b"left over from before");
        assert_eq!(rig.bring_up(), Ok(()), "{protocol:?}");
        {
            let drive = rig.drive();
            assert_eq!(
                (drive.mode, drive.setpoint, drive.max_current, drive.status),
                (Mode::Manual, 0, 15_000, 0)
            );
        }
        let state = rig.run(2, AxisCommand::Off);
        assert_eq!((state.age, state.power, state.fault), (0, Power::Off, None));
        assert_eq!(
            (state.increments.0, state.homing),
            (1_000, Homing::NotHomed)
        );
    }
}

#[test]
fn a_question_that_gets_no_answer_is_asked_thrice() {
    for protocol in BOTH {
        for (mute, right) in [(2, true), (3, false)] {
            let mut rig = Rig::of(Drive {
                mute,
                ..Drive::new(protocol, 8)
            });
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
            // The first answer waits for the repetition, and the others behind it.
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
        let mut rig = Rig::of(Drive {
            mode: Mode::Pwm,
            setpoint: 500,
            ..Drive::new(protocol, 8)
        });
        while rig.drive().heard.len() < telegrams {
            assert!(rig.group.bring_up(rig.now).is_pending());
            rig.now += PERIOD;
        }
        let drive = rig.drive();
        assert_eq!((drive.setpoint, drive.mode), (0, Mode::Manual));
    }
}

#[test]
fn a_fault_while_switching_on_leaves_power_unknown() {
    for protocol in BOTH {
        let mut rig = Rig::up(Drive::new(protocol, 8));
        rig.cycle(AxisCommand::Stand);
        // Refused, as there is no torque yet.
        rig.cycle(AxisCommand::Follow(raw(protocol, 100)));
        let state = rig.run(8, AxisCommand::Stand);
        assert_eq!(state.power, Power::Changing, "{protocol:?}");
        assert_eq!(rig.run(4, AxisCommand::Off).power, Power::Off);
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
                Some(Err(BringUpError::AxisController {
                    error: AxisControllerError::Late { .. },
                    ..
                }))
            );
            assert_eq!(result == Some(Ok(())), right, "{protocol:?} {delay}");
            assert_eq!(late, !right, "{protocol:?} {delay}: {result:?}");
        }
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
        assert_eq!(
            error(&mut alone(Drive::new(found, 8))),
            AxisControllerError::OtherProtocol { expected, found }
        );
        let mut silent = alone(Drive {
            deaf: true,
            ..Drive::new(expected, 8)
        });
        let silence = error(&mut silent);
        assert!(
            matches!(silence, AxisControllerError::Silent { .. }),
            "{silence:?}"
        );
        let mut gone = alone(Drive {
            gone: true,
            ..Drive::new(expected, 8)
        });
        assert_eq!(error(&mut gone), AxisControllerError::Line(LineError::Gone));
        let mut dark = alone(Drive {
            status: Status::POWER_STAGE_FAULT,
            ..Drive::new(expected, 8)
        });
        assert_eq!(error(&mut dark), AxisControllerError::PowerStage);
        // Switched on, the same group comes up.
        dark.drive().status = 0;
        assert_eq!(dark.bring_up(), Ok(()));
    }
    for found in [0, 9, 15] {
        let mut swapped = Rig::of(Drive::new(Protocol::Nfv2, found));
        let other = AxisControllerError::OtherAddress { expected: 8, found };
        assert_eq!(error(&mut swapped), other);
    }
    let other = AxisControllerError::OtherAddress {
        expected: 8,
        found: 9,
    };
    // Such as answers whatever it is asked.
    let mut shouting = Rig::of(Drive {
        deaf: true,
        ..Drive::new(Protocol::Nfv2, 8)
    });
    let frame = [
        0x23, 0x12, 0xED, 0x09, 0x1A, 0x04, 0x2E, 0xFB, 0xFF, 0xFF, 0x1B, 0x02, 0xFA, 0x00, 0x1F,
        0x02, 0x10, 0x00,
    ];
    let crc = serial::nfv2::crc8(&frame[3..]);
    let result = (0..1_000).find_map(|_| {
        shouting
            .drive()
            .outbox
            .extend(frame.into_iter().chain([crc]));
        shouting.now += PERIOD;
        match shouting.group.bring_up(shouting.now) {
            Poll::Ready(result) => Some(result),
            Poll::Pending => None,
        }
    });
    let error = BringUpError::AxisController {
        line: 0,
        error: other,
    };
    assert_eq!(result, Some(Err(error)));
    let text = BringUpError::AxisController {
        line: 2,
        error: other,
    };
    assert_eq!(
        text.to_string(),
        "line 2: answers as address 9, the cell says 8: check which line goes where"
    );
    assert_eq!((text.line(), text.node()), (Some(2), None));
}

#[test]
fn noise_is_no_drive() {
    for protocol in BOTH {
        let mut rig = Rig::of(Drive {
            deaf: true,
            ..Drive::new(protocol, 8)
        });
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
        assert!(
            matches!(error, AxisControllerError::Garbled { .. }),
            "{error:?}"
        );
    }
}

#[test]
fn a_sample_is_taken_before_the_set_point_that_came_with_its_request() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive {
            follows: true,
            ..Drive::new(protocol, 8)
        });
        let before = rig.states[0].increments.0;
        rig.cycle(AxisCommand::Follow(raw(protocol, 7)));
        let seen: Vec<i32> = (0..3)
            .map(|_| rig.cycle(AxisCommand::Stand).increments.0 - before)
            .collect();
        let first = 1 + seen.iter().position(|moved| *moved == 7).unwrap();
        assert_eq!((first, rig.group.delay()), (2, 2), "{protocol:?}: {seen:?}");
    }
}

#[test]
fn torque_comes_and_goes_with_a_zero_set_point_first() {
    for protocol in BOTH {
        let mut rig = Rig::up(Drive::new(protocol, 8));
        // A set-point that somebody left there.
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
        assert!(
            modes[1..].iter().all(|mode| *mode == Mode::Manual),
            "{modes:?}"
        );
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
        assert_eq!(
            (drive.setpoint, drive.mode),
            (0, Mode::Manual),
            "{protocol:?}"
        );
    }
}

#[test]
fn no_old_set_point_goes_before_what_takes_torque_away() {
    for protocol in BOTH {
        // Switched off, by a panic, and at the end of the group.
        for (cycles, command) in [
            (2, Some(AxisCommand::Off)),
            (8, Some(AxisCommand::Stand)),
            (2, None),
        ] {
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
    assert_eq!(
        off.fault(),
        Some(AxisControllerFault::Refused(Refusal::NotOn))
    );
    let mut home = Rig::on(Drive::new(Protocol::Nfv2, 8));
    home.run(2, AxisCommand::Home);
    assert_eq!(
        home.fault(),
        Some(AxisControllerFault::Refused(Refusal::WrongKind))
    );
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
            let status = if referenced_before {
                Status::SYNCHRONIZED
            } else {
                0
            };
            let mut rig = Rig::on(Drive {
                velocity: 20,
                status,
                ..Drive::new(protocol, 8)
            });
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
                assert!(
                    (state.velocity - velocity).abs() < 1e-6,
                    "{}",
                    state.velocity
                );
                if seen.last() != Some(&state.homing) {
                    seen.push(state.homing);
                }
            }
            let from = if referenced_before {
                seen.remove(0)
            } else {
                seen[0]
            };
            assert!(matches!(from, Homing::Attained | Homing::NotHomed));
            assert!(
                seen.ends_with(&[Homing::InProgress, Homing::Attained]),
                "{seen:?}"
            );
            assert_eq!(rig.drive().index, None);
            assert_eq!(rig.drive().setpoint, 3);
            assert!(
                matches!(rig.drive().mode, Mode::Pwm | Mode::Current),
                "no second pulse"
            );
            let far = rig.drive().position - 20 - rig.states[0].increments.0;
            assert!(far.abs() <= 20, "{far}");
            assert_eq!(rig.counters().indexed, 1);
            // Leaving the search goes back, and keeps the reference.
            let state = rig.run(4, AxisCommand::Follow(raw(protocol, 4)));
            assert_eq!((state.homing, state.fault), (Homing::Attained, None));
            assert!(matches!(rig.drive().mode, Mode::Pwm | Mode::Current));
        }
    }
}

#[test]
fn an_index_pulse_in_the_last_cycle_of_a_search_counts() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive {
            velocity: 20,
            ..Drive::new(protocol, 8)
        });
        rig.run(5, AxisCommand::Seek(raw(protocol, 3)));
        let index = rig.drive().position + 10;
        rig.drive().index = Some(index);
        rig.cycle(AxisCommand::Seek(raw(protocol, 3)));
        assert_eq!(rig.drive().index, None);
        let state = rig.run(4, AxisCommand::Stand);
        assert_eq!(
            (state.homing, state.fault),
            (Homing::Attained, None),
            "{protocol:?}"
        );
    }
}

#[test]
fn what_nobody_asked_for_is_no_answer() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().full = true;
        rig.cycle(AxisCommand::Stand);
        let stale = rig.drive().last_answer.clone();
        rig.drive().outbox.extend(stale);
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 1, "{protocol:?}");
        assert_eq!(rig.counters().surplus, 1);
    }
}

#[test]
fn a_drive_that_kept_its_reference_is_homed_at_once() {
    for protocol in BOTH {
        let mut rig = Rig::up(Drive {
            status: Status::SYNCHRONIZED,
            ..Drive::new(protocol, 8)
        });
        assert_eq!(rig.cycle(AxisCommand::Off).homing, Homing::Attained);
    }
}

#[test]
fn missing_answers_are_ridden_through_and_then_are_a_panic() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().mute = 2;
        let follow = AxisCommand::Follow(raw(protocol, 100));
        let ages: Vec<u32> = (0..5).map(|_| rig.cycle(follow).age).collect();
        assert_eq!((ages, rig.fault()), (vec![0, 1, 2, 0, 0], None));
        rig.drive().mute = 3;
        rig.run(6, follow);
        assert_eq!(rig.fault(), Some(AxisControllerFault::Silent { cycles: 3 }));
        // It may hear what we do not.
        assert_eq!(rig.drive().mode, Mode::Error);
        rig.run(3, AxisCommand::Off);
        assert_eq!(
            rig.drive().mode,
            Mode::Error,
            "a panic ends by a reset alone"
        );
        rig.run(6, AxisCommand::ResetFault);
        assert_eq!((rig.drive().mode, rig.fault()), (Mode::Manual, None));
    }
}

#[test]
fn answers_that_come_in_heaps_are_a_fault_and_rare_gaps_are_none() {
    for protocol in BOTH {
        // One missing of so many.
        for (every, right) in [(3, false), (5, true)] {
            let mut rig = Rig::on(Drive::new(protocol, 8));
            for cycle in 0..1_000 {
                let held: Vec<u8> = match cycle % every {
                    0 => rig.drive().outbox.drain(..).collect(),
                    _ => Vec::new(),
                };
                rig.cycle(AxisCommand::Stand);
                // It comes with the next one.
                let newer: Vec<u8> = rig.drive().outbox.drain(..).collect();
                rig.drive().outbox.extend(held.into_iter().chain(newer));
            }
            let late = matches!(rig.fault(), Some(AxisControllerFault::Late { .. }));
            assert_eq!(
                (late, rig.fault().is_none()),
                (!right, right),
                "{protocol:?} {every}"
            );
        }
    }
}

#[test]
fn a_panic_of_one_axis_tells_every_drive_to_open_the_cabinet() {
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
                assert_eq!(
                    rig.states[line].fault, None,
                    "whoever failed is named first"
                );
                let mode = rig.lines[line].drive().mode;
                assert_eq!(mode, Mode::Error, "{protocol:?} {name}: in the same cycle");
            }
            // Whatever they are commanded, and when the group ends.
            rig.run(10, AxisCommand::Off);
            let with = AxisControllerFault::Cabinet {
                line: failing as u8,
            };
            for line in others() {
                let fault = Fault::AxisController {
                    line: line as u8,
                    fault: with,
                };
                assert_eq!(rig.states[line].fault, Some(fault), "{protocol:?} {name}");
                assert_eq!(rig.states[line].power, Power::Off);
                assert_eq!(rig.lines[line].drive().mode, Mode::Error);
            }
            // A reset of one alone does not bring the circuit back while another is unknown.
            let mut commands = [AxisCommand::Off; 3];
            let one = others().next_back().unwrap();
            commands[one] = AxisCommand::ResetFault;
            rig.cycle_all(&commands);
            commands[one] = AxisCommand::Off;
            rig.cycle_all(&commands);
            assert_eq!(
                rig.lines[one].drive().mode,
                Mode::Error,
                "{protocol:?} {name}"
            );
            let lines = rig.lines.clone();
            drop(rig.group);
            for line in others() {
                assert_eq!(lines[line].drive().mode, Mode::Error, "{protocol:?} {name}");
            }
        }
    }
}

#[test]
fn a_reset_ends_a_panic_of_the_group() {
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
            assert_eq!(
                (state.fault, state.power),
                (None, Power::On),
                "{protocol:?}"
            );
            assert!(matches!(line.drive().mode, Mode::Pwm | Mode::Current));
        }
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
        assert_eq!(
            (drive.mode, drive.setpoint),
            (Mode::Manual, 0),
            "{protocol:?}"
        );
    }
}

#[test]
fn a_set_point_that_the_line_does_not_take_is_counted_and_then_a_fault() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().full = true;
        rig.run(4, AxisCommand::Stand);
        assert_eq!(
            rig.fault(),
            Some(AxisControllerFault::NotSent { cycles: 3 })
        );
        let counters = rig.group.counters();
        assert_eq!(
            (counters.dropped_setpoints, counters.missed_answers),
            (4, 0)
        );
    }
}

#[test]
fn what_a_drive_reports_counts_when_two_answers_show_it() {
    let cases = [
        (Status::POWER_STAGE_FAULT, AxisControllerFault::PowerStage),
        (Status::OVERCURRENT, AxisControllerFault::Overcurrent),
        (Status::ERROR, AxisControllerFault::Error),
    ];
    for (protocol, (bit, fault)) in BOTH.into_iter().flat_map(|p| cases.map(|case| (p, case))) {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().status = bit;
        rig.cycle(AxisCommand::Stand);
        rig.drive().status = 0;
        rig.run(3, AxisCommand::Stand);
        assert_eq!(rig.fault(), None, "{protocol:?}: one answer is no fault");
        rig.drive().status = bit;
        rig.run(4, AxisCommand::Follow(raw(protocol, 100)));
        assert_eq!(rig.fault(), Some(fault), "{protocol:?}");
        assert_eq!(rig.drive().setpoint, 0);
        // Off keeps the fault although manual mode cleared it in the drive.
        rig.drive().status = 0;
        rig.run(4, AxisCommand::Off);
        assert_eq!(rig.fault(), Some(fault));
        rig.run(2, AxisCommand::ResetFault);
        assert_eq!(rig.fault(), None);
    }
}

#[test]
fn switches_are_said_and_are_no_fault() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().status = Status::UPPER_LIMIT | Status::HOME_SWITCH;
        let switches = rig.run(3, AxisCommand::Stand).switches;
        assert!(switches.upper_limit && switches.home && !switches.lower_limit);
        rig.drive().status = Status::LOWER_LIMIT;
        let switches = rig.run(3, AxisCommand::Stand).switches;
        assert!(!switches.upper_limit && !switches.home && switches.lower_limit);
        assert_eq!(rig.fault(), None);
    }
}

#[test]
fn a_restarted_drive_is_a_fault_and_stays_off() {
    for protocol in BOTH {
        for position in [1_000, 0] {
            let mut rig = Rig::on(Drive {
                position,
                status: Status::SYNCHRONIZED,
                ..Drive::new(protocol, 8)
            });
            rig.drive().restart();
            let state = rig.run(5, AxisCommand::Stand);
            assert_eq!(
                rig.fault(),
                Some(AxisControllerFault::Restarted),
                "{protocol:?}"
            );
            assert_eq!(state.homing, Homing::NotHomed);
            assert_eq!(
                rig.drive().mode,
                Mode::Manual,
                "nobody gave it torque again"
            );
        }
    }
}

#[test]
fn no_set_point_follows_what_may_be_a_restart() {
    let follow = AxisCommand::Follow(raw(Protocol::HiMoxa, 300));
    for position in [1_000, 0] {
        let mut rig = Rig::on(Drive {
            position,
            status: Status::SYNCHRONIZED,
            ..Drive::new(Protocol::HiMoxa, 8)
        });
        rig.run(3, follow);
        rig.drive().restart();
        // Asks for the first answer after it.
        rig.cycle(follow);
        for _ in 0..6 {
            rig.cycle(follow);
            assert_eq!(rig.drive().setpoint, 0, "from {position}");
        }
        assert_eq!(rig.fault(), Some(AxisControllerFault::Restarted));
    }
    // A damaged position costs one set-point.
    let mut rig = Rig::on(Drive::new(Protocol::HiMoxa, 8));
    rig.drive().position = 90_000;
    rig.cycle(follow);
    rig.drive().position = 1_000;
    let setpoints = [(); 3].map(|()| {
        rig.cycle(follow);
        rig.drive().setpoint
    });
    assert_eq!((setpoints, rig.fault()), ([0, 300, 300], None));
}

#[test]
fn a_reference_that_a_drive_keeps_is_a_fault_and_costs_every_other_set_point_at_most() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive {
            status: Status::SYNCHRONIZED,
            keeps_reference: true,
            velocity: 5,
            ..Drive::new(protocol, 8)
        });
        let mut since_setpoint = 0;
        for cycle in 0.. {
            assert!(cycle < 40, "{protocol:?}");
            rig.drive().setpoint = 0;
            rig.cycle(AxisCommand::Seek(raw(protocol, 200)));
            if rig.fault().is_some() {
                break;
            }
            let taken = rig.drive().setpoint == 200;
            since_setpoint = if taken { 0 } else { since_setpoint + 1 };
            assert!(cycle >= 25 || since_setpoint <= 1, "{protocol:?} {cycle}");
        }
        let kept = AxisControllerFault::KeepsReference { cycles: 25 };
        assert_eq!(rig.fault(), Some(kept), "{protocol:?}");
        assert_eq!(rig.drive().setpoint, 0);
    }
}

#[test]
fn a_counter_that_jumps_is_a_panic_and_never_followed() {
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

#[test]
fn a_counter_that_jumped_is_no_reference_for_whoever_comes_after() {
    for protocol in BOTH {
        for cycles in [0, 4] {
            let mut rig = Rig::on(Drive {
                status: Status::SYNCHRONIZED,
                ..Drive::new(protocol, 8)
            });
            rig.drive().position = 90_000;
            // Until the fault, and then not a cycle or some.
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
fn an_implausible_answer_counts_as_missing() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().current = 22_501;
        rig.cycle(AxisCommand::Stand);
        rig.drive().current = 22_500;
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.age, rig.counters().implausible), (1, 1));
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.age, rig.counters().implausible), (0, 1));
        assert!((state.torque - 2.25).abs() < 1e-9);
        // A leap within what the motor's velocity allows, and not its acceleration.
        rig.drive().position += 110;
        rig.cycle(AxisCommand::Stand);
        rig.drive().position -= 110;
        assert_eq!(rig.cycle(AxisCommand::Stand).increments.0, 1_000);
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.increments.0, state.age), (1_000, 0));
    }
}

#[test]
fn answers_that_never_change_while_set_points_do_are_a_panic() {
    for protocol in BOTH {
        let follow = |value| AxisCommand::Follow(raw(protocol, value));
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.run(2, follow(500));
        rig.drive().current = 500;
        rig.run(200, follow(500));
        assert_eq!(
            rig.fault(),
            None,
            "a stalled motor may say the same for ever"
        );
        rig.run(60, follow(900));
        rig.run(60, follow(100));
        assert!(
            matches!(rig.fault(), Some(AxisControllerFault::Frozen { .. })),
            "{protocol:?} {:?}",
            rig.fault()
        );
    }
}

#[test]
fn a_line_that_is_gone_is_said_at_once() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().gone = true;
        rig.cycle(AxisCommand::Stand);
        assert_eq!(
            rig.fault(),
            Some(AxisControllerFault::Line(LineError::Gone))
        );
    }
}

/// Whatever is cut off or put in, the answer after the next is believed.
#[test]
fn torn_and_surplus_bytes_cost_two_answers_at_most() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        let length = rig.drive().last_answer.len();
        for keep in 0..length {
            rig.cycle(AxisCommand::Stand);
            rig.drive().outbox.truncate(keep);
            let ages: Vec<u32> = (0..3).map(|_| rig.cycle(AxisCommand::Stand).age).collect();
            assert_eq!(ages[0], 1, "{protocol:?} {keep}");
            assert_eq!(ages[2], 0, "{protocol:?} {keep}: {ages:?}");
        }
        for surplus in 1..2 * length {
            rig.cycle(AxisCommand::Stand);
            rig.drive()
                .outbox
                .extend((0..surplus).map(|n| [0x23, 0x12, 0xED, 8][n % 4]));
            let ages: Vec<u32> = (0..3).map(|_| rig.cycle(AxisCommand::Stand).age).collect();
            assert_eq!(ages[2], 0, "{protocol:?} {surplus}: {ages:?}");
            // What looks like a header hides no answer behind it.
            assert!(
                protocol == Protocol::HiMoxa || ages == [0; 3],
                "{surplus}: {ages:?}"
            );
            assert_eq!(rig.states[0].increments.0, 1_000);
        }
        assert_eq!(rig.fault(), None);
    }
}

#[test]
fn an_answer_that_is_not_its_own_is_refused() {
    let mut nfv2 = Rig::on(Drive::new(Protocol::Nfv2, 8));
    let mut other = Drive::new(Protocol::Nfv2, 9).shared();
    for _ in 0..2 {
        let request = nfv2.drive().heard.last().unwrap().clone();
        let mut request = request;
        request[3] = 9;
        let last = request.len() - 1;
        request[last] = serial::nfv2::crc8(&request[3..last]);
        serial::Line::write(&mut other, Instant::ZERO, &request).unwrap();
        let foreign: Vec<u8> = other.drive().outbox.drain(..).collect();
        nfv2.drive().outbox = foreign.into();
        nfv2.cycle(AxisCommand::Stand);
    }
    assert_eq!((nfv2.states[0].age, nfv2.counters().foreign), (2, 2));

    let mut moxa = Rig::on(Drive::new(Protocol::HiMoxa, 8));
    moxa.drive().start = 0x2B;
    moxa.run(2, AxisCommand::Stand);
    assert_eq!((moxa.states[0].age, moxa.counters().damaged), (1, 1));

    // Unless its start byte was never the same.
    let mut restless = Rig::of(Drive::new(Protocol::HiMoxa, 8));
    while restless.group.bring_up(restless.now).is_pending() {
        restless.now += PERIOD;
        restless.drive().start += 1;
    }
    restless.drive().start += 1;
    assert_eq!(restless.run(3, AxisCommand::Off).age, 0);
}

#[test]
fn a_whole_answer_after_a_torn_one_is_believed() {
    let mut rig = Rig::on(Drive::new(Protocol::HiMoxa, 8));
    rig.drive().outbox.truncate(5);
    let ages: Vec<u32> = (0..2).map(|_| rig.cycle(AxisCommand::Stand).age).collect();
    assert_eq!(ages, [1, 0]);
}

#[test]
fn an_answer_that_was_read_in_two_parts_is_put_together() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        let rest: Vec<u8> = rig.drive().outbox.drain(5..).collect();
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 1);
        let next: Vec<u8> = rig.drive().outbox.drain(..).collect();
        rig.drive().outbox.extend(rest.into_iter().chain(next));
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 0, "{protocol:?}");
    }
}

#[test]
fn a_counter_that_is_set_anew_without_being_asked_to_is_a_panic() {
    for protocol in BOTH {
        // A jump to zero with a reference, while following; and one to elsewhere while seeking.
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
fn a_fault_stays_for_as_long_as_the_drive_reports_it() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().status = Status::POWER_STAGE_FAULT;
        rig.run(4, AxisCommand::Stand);
        for _ in 0..10 {
            assert!(rig.cycle(AxisCommand::ResetFault).fault.is_some());
        }
        rig.drive().status = 0;
        assert_eq!(rig.run(4, AxisCommand::ResetFault).fault, None);
    }
}

#[test]
fn an_answer_that_comes_a_cycle_late_is_passed_over_for_the_one_behind_it() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive {
            velocity: 40,
            ..Drive::new(protocol, 8)
        });
        rig.run(3, AxisCommand::Stand);
        let held: Vec<u8> = rig.drive().outbox.drain(..).collect();
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 1);
        let newer: Vec<u8> = rig.drive().outbox.drain(..).collect();
        let position = rig.drive().position - 40;
        rig.drive().outbox.extend(held.into_iter().chain(newer));
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!(
            (state.age, state.increments.0),
            (0, position),
            "{protocol:?}"
        );
        assert_eq!((rig.counters().late, rig.counters().surplus), (1, 0));
    }
}

#[test]
fn what_cannot_work_is_refused_before_a_byte_is_sent() {
    type Change = fn(&mut GroupConfig, &mut AxisConfig);
    let cases: [(Protocol, Change, &str); 12] = [
        (Protocol::Nfv2, |_, axis| axis.address = 0xFE, "address"),
        (
            Protocol::Nfv2,
            |_, axis| axis.max_current = 40.0,
            "greatest current",
        ),
        (
            Protocol::Nfv2,
            |_, axis| axis.max_current = f64::NAN,
            "greatest current",
        ),
        (
            Protocol::Nfv2,
            |_, axis| axis.torque_constant = 0.0,
            "torque constant",
        ),
        (
            Protocol::Nfv2,
            |_, axis| axis.max_velocity = 0.0,
            "greatest velocity",
        ),
        (
            Protocol::Nfv2,
            |_, axis| axis.max_acceleration = f64::INFINITY,
            "acceleration",
        ),
        (
            Protocol::Nfv2,
            |_, axis| {
                axis.current_gains = Some(CurrentGains {
                    p: 2.0,
                    i: 0.0,
                    d: 0.0,
                });
            },
            "current gain",
        ),
        (
            Protocol::HiMoxa,
            |_, axis| axis.control = Control::Current,
            "takes protocol nfv2",
        ),
        (
            Protocol::Nfv2,
            |group, _| group.period = Duration::from_micros(400),
            "too short",
        ),
        (
            Protocol::Nfv2,
            |group, _| group.tolerated_missing = 0,
            "at least 1",
        ),
        (Protocol::Nfv2, |group, _| group.attempts = 0, "at least 1"),
        (
            Protocol::HiMoxa,
            |_, axis| {
                axis.current_gains = Some(CurrentGains {
                    p: 0.1,
                    i: 0.0,
                    d: 0.0,
                });
            },
            "takes protocol nfv2",
        ),
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
