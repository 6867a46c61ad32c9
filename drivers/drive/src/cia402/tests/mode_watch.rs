//! A change of the mode of operation that the group did not command.

use can::Received;
use canopen::cia402::ModeOfOperation;

use super::bench::*;
use crate::{Homing, Power};

const STAND: &[AxisCommand] = &[AxisCommand::Stand];
const HOME: &[AxisCommand] = &[AxisCommand::Home];
const CSP: ModeOfOperation = ModeOfOperation::CyclicSynchronousPosition;

fn enabled() -> Bench {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench
}

/// A cycle in which the drive stands enabled, followed by these frames.
fn cycle(bench: &mut Bench, frames: &[&str], command: &[AxisCommand]) -> Vec<String> {
    let mut answers = bench.answers(0x0737, 1_000);
    answers.extend(frames.iter().map(|text| (*text).to_owned()));
    bench.cycle(&answers, command)
}

fn changed(found: ModeOfOperation, expected: ModeOfOperation) -> Option<Fault> {
    let node = 2;
    Some(Fault::ModeChanged { node, expected, found })
}

#[test]
fn a_foreign_change_of_mode_is_a_fault_that_names_both_modes() {
    let table = [
        ("282#03", ModeOfOperation::ProfileVelocity),
        ("282#06", ModeOfOperation::Homing),
        ("282#FF", ModeOfOperation::from_raw(-1)),
    ];
    for (text, found) in table {
        let mut bench = enabled();
        let unexpected = bench.group.counters().unexpected;
        cycle(&mut bench, &["282#08"], STAND);
        assert_eq!(bench.states[0].fault, None);
        let frames = cycle(&mut bench, &[text], STAND);
        assert_eq!(bench.states[0].fault, changed(found, CSP));
        assert!(!bench.states[0].following);
        // The drive gets a quick stop. Its mode is not changed during braking.
        assert_eq!(frames, ["080#", "202#0200E8030000"]);
        assert_eq!(bench.group.counters().unexpected, unexpected);
    }
    let text = changed(ModeOfOperation::ProfileVelocity, CSP).unwrap().to_string();
    let expected = "node 2: mode of operation is profile velocity, commanded was cyclic synchronous position";
    assert_eq!(text, expected);
}

#[test]
fn after_a_reset_the_drive_is_told_its_mode_again() {
    let mut bench = enabled();
    cycle(&mut bench, &["282#03"], STAND);
    let mut told = Vec::new();
    for _ in 0..6 {
        let sent = bench.cycle(&bench.answers(0x0740, 1_000), &[AxisCommand::ResetFault]);
        told.extend(sent.into_iter().filter(|frame| frame.starts_with("602")));
    }
    assert_eq!(bench.states[0].fault, None);
    assert_eq!(told, ["602#2F60600008000000", "602#4061600000000000"]);
    bench.enable();
    assert_eq!((bench.states[0].power, bench.states[0].fault), (Power::On, None));
}

/// CiA 402 leaves open what a drive does that changes its mode while it brakes.
#[test]
fn a_drive_that_is_braked_is_told_no_mode() {
    let mut bench = enabled();
    for _ in 0..5 {
        cycle(&mut bench, &[], HOME);
    }
    // Another controller's SYNC is a fault.
    let mut sent = cycle(&mut bench, &["080#"], HOME);
    assert!(bench.states[0].fault.is_some());
    assert_eq!(sent[1], "202#0200E8030000");
    for statusword in [0x0737, 0x0737, 0x0717, 0x0717, 0x0717] {
        sent.extend(bench.cycle(&bench.answers(statusword, 1_000), HOME));
    }
    let told = sent.iter().filter(|frame| frame.starts_with("602#2F60"));
    assert_eq!(told.count(), 0, "{sent:?}");
    // Without torque it is told the cyclic mode.
    let mut sent = Vec::new();
    for statusword in [0x0717, 0x0740, 0x0740, 0x0740] {
        sent.extend(bench.cycle(&bench.answers(statusword, 1_000), &[AxisCommand::Off]));
    }
    assert!(sent.contains(&"602#2F60600008000000".to_owned()), "{sent:?}");
}

#[test]
fn the_groups_own_changes_of_mode_are_none_whenever_they_show() {
    // Frames before the drive has reported the mode to a service request: old mode, new mode, both, or none.
    let homing: [&[&str]; 4] = [&["282#08"], &["282#06"], &["282#08", "282#06"], &[]];
    let back: [&[&str]; 4] = [&["282#06"], &["282#08"], &["282#06", "282#08"], &[]];
    for frames in homing {
        for frames_back in back {
            let mut bench = enabled();
            cycle(&mut bench, &[], HOME);
            cycle(&mut bench, frames, HOME);
            cycle(&mut bench, &[], HOME);
            cycle(&mut bench, &["282#06"], HOME);
            let done = |frames: &[&str]| -> Vec<String> {
                let own = [answer(2, 0x9637, 0)].into_iter();
                own.chain(frames.iter().map(|text| (*text).to_owned())).collect()
            };
            for _ in 0..6 {
                bench.cycle(&done(&["282#06"]), HOME);
            }
            assert_eq!(bench.states[0].homing, Homing::Attained);
            bench.cycle(&done(&[]), STAND);
            bench.cycle(&done(frames_back), STAND);
            bench.cycle(&done(&[]), STAND);
            bench.cycle(&done(&["282#08"]), STAND);
            bench.cycle(&done(&[]), STAND);
            let state = bench.states[0];
            assert_eq!((state.fault, state.following), (None, true), "{frames:?}");
        }
    }
}

/// The first frame with the new mode and the answer of the drive may be read in one cycle.
#[test]
fn a_change_right_behind_the_answer_that_showed_the_mode_is_a_fault() {
    let mut bench = enabled();
    cycle(&mut bench, &[], HOME);
    // The drive accepted the mode; the reported mode is read.
    let asked = cycle(&mut bench, &[], HOME);
    assert_eq!(asked[2], "602#4061600000000000");
    // The answer of the store precedes the frame in the inbox.
    cycle(&mut bench, &["282#03"], HOME);
    let found = ModeOfOperation::ProfileVelocity;
    let fault = changed(found, ModeOfOperation::Homing);
    assert_eq!(bench.states[0].fault, fault);
}

#[test]
fn modes_of_another_length_are_counted_and_not_believed() {
    let mut bench = enabled();
    let unexpected = bench.group.counters().unexpected;
    cycle(&mut bench, &["282#", "282#0300"], STAND);
    assert_eq!(bench.states[0].fault, None);
    assert_eq!(bench.group.counters().unexpected, unexpected + 2);
}

/// The mode that a drive reports on becoming operational arrives before the first cycle.
#[test]
fn a_change_between_bring_up_and_operation_is_a_fault_of_the_first_cycle() {
    for (text, fault) in [("282#08", None), ("282#03", changed(ModeOfOperation::ProfileVelocity, CSP))] {
        let mut bench = Bench::new(group_config(), &[axis_config(2), axis_config(3)]);
        bench.stores[1].starts = false;
        let mut started = false;
        while !started {
            assert!(bench.group.bring_up(bench.now).is_pending());
            bench.serve();
            bench.now += PERIOD;
            started = sent(&bench).iter().any(|frame| frame == "000#0102");
        }
        let at = bench.now;
        for text in [text, "703#05"] {
            let frame = frame(text);
            let received = Received { frame, at };
            bench.bus.0.lock().unwrap().inbox.push_back(received);
        }
        assert_eq!(bench.bring_up(), Ok(()));
        bench.cycle(NONE, &[AxisCommand::Off; 2]);
        assert_eq!(bench.states[0].fault, fault);
        assert_eq!(bench.states[1].fault, None);
        // Bring-up clears the fault.
        bench.stores[1].starts = true;
        assert_eq!(bench.bring_up(), Ok(()));
        bench.cycle(NONE, &[AxisCommand::Off; 2]);
        assert_eq!(bench.states[0].fault, None);
    }
}
