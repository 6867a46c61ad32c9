//! Answers that are old, reversed, garbled, or those of another drive: the fault of the line names them.

use super::*;

/// Increments per cycle, and a current of a motor in motion.
const VELOCITY: i32 = 40;
const CURRENT: i16 = 120;

fn moving(protocol: Protocol) -> Drive {
    Drive { velocity: VELOCITY, current: CURRENT, ..Drive::new(protocol, 8) }
}

/// A rig of the older protocol in motion whose drive has shown its velocity.
fn moxa() -> Rig {
    Rig::on(moving(Protocol::HiMoxa))
}

fn taken(rig: &mut Rig) -> Vec<u8> {
    rig.drive().outbox.drain(..).collect()
}

/// Cycles until a fault, at most `most`. `answer` changes the answer to the telegram of each cycle.
fn until_fault(rig: &mut Rig, most: usize, mut answer: impl FnMut(usize, Vec<u8>) -> Vec<u8>) -> usize {
    for cycle in 0..most {
        let answered = taken(rig);
        rig.drive().outbox.extend(answer(cycle, answered));
        rig.cycle(AxisCommand::Stand);
        // The current of a motor in motion is never the same twice.
        rig.drive().current += 1;
        if rig.fault().is_some() {
            return cycle;
        }
    }
    most
}

#[test]
fn an_answer_in_two_that_is_the_one_before_again_is_found_in_a_window_and_named() {
    let mut rig = moxa();
    let mut last = Vec::new();
    let cycles = until_fault(&mut rig, 200, |cycle, answer| {
        if cycle % 2 == 1 {
            return last.clone();
        }
        last.clone_from(&answer);
        answer
    });
    assert_eq!(rig.fault(), Some(AxisControllerFault::Old { answers: 51 }));
    assert!(cycles <= 110, "{cycles}");
}

#[test]
fn an_answer_that_stays_the_same_is_old_after_the_tolerated_cycles() {
    let mut rig = moxa();
    let mut last = Vec::new();
    let cycles = until_fault(&mut rig, 20, |cycle, answer| {
        if cycle == 0 {
            last.clone_from(&answer);
        }
        last.clone()
    });
    assert_eq!((rig.fault(), cycles), (Some(AxisControllerFault::Old { answers: 3 }), 3));
    assert_eq!(rig.drive().mode, Mode::Error, "the state of the drive is unknown");
}

#[test]
fn equal_answers_of_a_motor_that_stands_or_has_no_current_are_in_time() {
    for (velocity, current) in [(0, CURRENT), (3, CURRENT), (6, 0)] {
        let mut rig = Rig::on(Drive { velocity, current, ..Drive::new(Protocol::HiMoxa, 8) });
        let mut last = Vec::new();
        for cycle in 0..300 {
            let answer = taken(&mut rig);
            let again = cycle % 3 == 2;
            rig.drive().outbox.extend(if again { &last } else { &answer });
            last = answer;
            rig.cycle(AxisCommand::Stand);
        }
        assert_eq!(rig.fault(), None, "{velocity} {current}");
    }
}

#[test]
fn answers_that_change_places_are_named_in_motion_and_missing_at_rest() {
    for velocity in [VELOCITY, -VELOCITY, 0] {
        let mut rig = Rig::on(Drive { velocity, current: CURRENT, ..Drive::new(Protocol::HiMoxa, 8) });
        let mut held: Option<Vec<u8>> = None;
        let cycles = until_fault(&mut rig, 400, |_, answer| {
            if answer.is_empty() {
                return answer;
            }
            match held.take() {
                Some(before) => [answer, before].concat(),
                None => {
                    held = Some(answer);
                    Vec::new()
                }
            }
        });
        match (velocity, rig.fault()) {
            (0, Some(AxisControllerFault::Late { .. })) => {}
            (0, fault) => panic!("{fault:?}"),
            (_, fault) => {
                assert!(matches!(fault, Some(AxisControllerFault::Reversed { .. })), "{velocity}: {fault:?}");
                assert!(cycles <= 8, "{velocity}: {cycles}");
            }
        }
    }
}

#[test]
fn whole_answers_with_wrong_contents_are_garbled_and_not_an_overcurrent() {
    // Positions that contradict each other.
    let mut rig = moxa();
    until_fault(&mut rig, 20, |cycle, mut answer| {
        if let Some(byte) = answer.get_mut(6) {
            *byte ^= 1 << (cycle % 8);
        }
        answer
    });
    assert_eq!(rig.fault(), Some(AxisControllerFault::Garbled { answers: 2 }));
}

#[test]
fn a_flag_that_comes_and_goes_by_itself_twice_makes_a_third_one_garbled() {
    for protocol in BOTH {
        let mut rig = Rig::on(moving(protocol));
        // NFv2 asks for the status in two cycles of three.
        for shown in [0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1, 1] {
            rig.drive().status = shown * Status::ERROR;
            rig.cycle(AxisCommand::Stand);
        }
        assert!(matches!(rig.fault(), Some(AxisControllerFault::Garbled { .. })), "{protocol:?}: {:?}", rig.fault());
    }
}

#[test]
fn an_overcurrent_after_one_damaged_answer_is_an_overcurrent() {
    let mut rig = moxa();
    rig.drive().position += 1 << 20;
    rig.cycle(AxisCommand::Stand);
    rig.drive().position -= 1 << 20;
    rig.run(3, AxisCommand::Stand);
    rig.drive().status = Status::OVERCURRENT;
    rig.run(3, AxisCommand::Stand);
    assert_eq!(rig.fault(), Some(AxisControllerFault::Overcurrent));
}

/// Two axes of one group, which move from different places.
fn two(protocol: Protocol) -> Rig {
    two_at(protocol, [(1_000, VELOCITY), (30_000, -VELOCITY)])
}

/// Two axes of one group, with positions and velocities.
fn two_at(protocol: Protocol, [one, other]: [(i32, i32); 2]) -> Rig {
    let config = GroupConfig::new(protocol);
    let axes = [axis(protocol), AxisConfig { address: 9, ..axis(protocol) }];
    let drive =
        |(position, velocity), address| Drive { position, velocity, current: CURRENT, ..Drive::new(protocol, address) };
    let mut rig = Rig::with(config, &axes, vec![drive(one, 8), drive(other, 9)]);
    rig.bring_up().unwrap();
    rig.run(10, AxisCommand::Stand);
    rig
}

fn fault_of(rig: &Rig, axis: usize) -> Option<AxisControllerFault> {
    match rig.states[axis].fault {
        Some(Fault::AxisController { fault, .. }) => Some(fault),
        None => None,
        other => panic!("{other:?}"),
    }
}

#[test]
fn swapped_answers_of_two_axes_name_the_other_line_or_its_address() {
    for protocol in BOTH {
        let mut rig = two(protocol);
        for _ in 0..4 {
            swap(&rig);
            rig.cycle(AxisCommand::Stand);
        }
        let faults = [0, 1].map(|axis| fault_of(&rig, axis).unwrap());
        let expected = match protocol {
            Protocol::Nfv2 => [9, 8].map(|address| AxisControllerFault::OtherDrive { address }),
            Protocol::HiMoxa => [1, 0].map(|line| AxisControllerFault::Swapped { line }),
        };
        assert_eq!(faults, expected, "{protocol:?}");
    }
}

/// The answers of two axes, each on the line of the other.
fn swap(rig: &Rig) {
    let answers: Vec<Vec<u8>> = rig.lines.iter().map(|it| it.drive().outbox.drain(..).collect()).collect();
    for (line, answer) in rig.lines.iter().zip(answers.iter().rev()) {
        line.drive().outbox.extend(answer);
    }
}

#[test]
fn a_reported_fault_of_a_swapped_drive_names_its_line_where_the_counters_agree() {
    for swapped in [true, false] {
        let mut rig = two_at(Protocol::HiMoxa, [(20_000, 0); 2]);
        assert_eq!([0, 1].map(|axis| fault_of(&rig, axis)), [None, None]);
        rig.lines[1].drive().status = Status::OVERCURRENT;
        for _ in 0..5 {
            if swapped {
                swap(&rig);
            }
            rig.cycle(AxisCommand::Stand);
        }
        let faults = [0, 1].map(|axis| fault_of(&rig, axis));
        match swapped {
            true => assert_eq!(faults[0], Some(AxisControllerFault::Swapped { line: 1 })),
            false => assert_eq!(faults, [None, Some(AxisControllerFault::Overcurrent)]),
        }
        let left_out: Vec<u64> = rig.group.axis_counters().map(|counters| counters.left_out).collect();
        assert_eq!(left_out, if swapped { [1, 0] } else { [0, 1] }, "one telegram");
    }
}

#[test]
fn a_counter_that_jumps_to_the_place_of_another_axis_is_a_jump() {
    let mut rig = two(Protocol::HiMoxa);
    rig.drive().position = 30_000;
    rig.run(4, AxisCommand::Stand);
    assert!(matches!(fault_of(&rig, 0), Some(AxisControllerFault::Jumped { .. })), "{:?}", fault_of(&rig, 0));
}
