//! EMCY without a fault, and bits of the statusword.

use std::time::Duration;

use canopen::cia402::FaultTable;

use super::bench::*;
use crate::{Warning, WarningCause, Warnings};

const STAND: &[AxisCommand] = &[AxisCommand::Stand];

fn enabled() -> Bench {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench
}

/// A cycle in which the drive stands enabled and additionally sends these EMCY.
fn reports(bench: &mut Bench, emergencies: &[&str]) {
    let mut answers = bench.answers(0x0737, 1_000);
    answers.extend(emergencies.iter().map(|text| (*text).to_owned()));
    bench.cycle(&answers, STAND);
}

fn warnings(bench: &Bench) -> Vec<Warning> {
    bench.group.warnings().iter().copied().collect()
}

#[test]
fn an_emcy_without_a_fault_is_a_warning_with_its_time_and_count() {
    let mut bench = enabled();
    let up = bench.now;
    reports(&mut bench, &["082#2081080000000000"]);
    reports(&mut bench, &["082#2081080000000000", "082#2081090000000000"]);
    // The end of an error, and an EMCY of another node.
    reports(&mut bench, &["082#0000000000000000", "083#2081080000000000"]);
    // Enabling took seven cycles, and the EMCY arrives half a period before its cycle.
    let first = bench.now.since(up) + 7 * PERIOD - 3 * PERIOD + PERIOD / 2;
    let table = FaultTable::Epos4;
    let warning = |register, count, after| {
        let cause = WarningCause::Emergency { code: 0x8120, table, register };
        Warning { after, node: 2, cause, count }
    };
    let expected = [warning(8, 2, first), warning(9, 1, first + PERIOD)];
    assert_eq!(warnings(&bench), expected);
    assert_eq!(bench.states[0].fault, None);
    let text = "node 2: EMCY 0x8120 (CAN in error passive mode), error register 0x08";
    assert_eq!(expected[0].to_string(), text);
}

#[test]
fn an_emcy_of_a_drive_that_is_on_is_a_fault_unless_it_concerns_the_bus_alone() {
    for (code, stops) in
        [(0x2310, true), (0x4210, true), (0x8130, true), (0xFF01, true), (0x8110, false), (0x8120, false)]
    {
        let [low, high] = u16::to_le_bytes(code);
        let emcy = format!("082#{low:02X}{high:02X}010000000000");
        let mut bench = enabled();
        reports(&mut bench, &[&emcy]);
        let fault = stops.then_some(Fault::Drive { node: 2, code });
        assert_eq!(bench.states[0].fault, fault, "{code:#06x}");
        assert_eq!(warnings(&bench).len(), usize::from(!stops));
        // The drive brakes by its quick stop, and a reset ends the fault.
        let frames = bench.cycle(&bench.answers(0x0737, 1_000), STAND);
        assert_eq!(frames[1].starts_with("202#0200"), stops, "{frames:?}");
        bench.cycle(&bench.answers(0x0740, 1_000), &[AxisCommand::ResetFault]);
        bench.cycle(&bench.answers(0x0740, 1_000), &[AxisCommand::ResetFault]);
        assert_eq!(bench.states[0].fault, None);
        // Of a drive that is off it is a warning.
        bench.cycle(&[answer(2, 0x0740, 1_000), emcy], &[AxisCommand::Off]);
        assert_eq!(bench.states[0].fault, None);
    }
}

#[test]
fn the_emcy_of_a_fault_is_no_warning_whichever_comes_first() {
    let (emcy, other) = ("082#1186800000000000", "082#1042080000000000");
    let statusword = answer(2, 0x020F, 1_000);
    let orders: [&[&[&str]]; 5] = [
        &[&[emcy, &statusword]],
        &[&[&statusword, emcy]],
        &[&[&statusword], &[&statusword, emcy]],
        &[&[emcy], &[&statusword]],
        &[&[emcy], &[&statusword], &[emcy, &statusword]],
    ];
    for cycles in orders {
        let mut bench = enabled();
        for answers in cycles {
            bench.cycle(answers, STAND);
        }
        let code = 0x8611;
        assert_eq!(bench.states[0].fault, Some(Fault::Drive { node: 2, code }));
        assert_eq!(warnings(&bench), [], "{cycles:?}");
        // Another error beside the fault is a warning.
        bench.cycle(&[other, &statusword], STAND);
        assert_eq!(warnings(&bench).len(), 1);
    }
}

#[test]
fn warnings_are_bounded_and_the_rest_is_counted() {
    // Of a drive that is off, so that none is a fault.
    let mut bench = Bench::up(&[2]);
    let report = |bench: &mut Bench, emcy: String| bench.cycle(&[answer(2, 0x0740, 1_000), emcy], &[AxisCommand::Off]);
    for code in 1..=40 {
        let emcy = format!("082#{code:02X}FF010000000000");
        report(&mut bench, emcy);
    }
    let found = warnings(&bench);
    assert_eq!(found.len(), Warnings::KEPT);
    assert_eq!([found[0], found[31]].map(|it| it.cause.emergency()), [Some((0xFF01, 1)), Some((0xFF20, 1))]);
    assert_eq!(bench.group.warnings().omitted(), 8);
    // The counts of known warnings continue.
    report(&mut bench, "082#01FF010000000000".to_owned());
    assert_eq!(warnings(&bench)[0].count, 2);
}

#[test]
fn warnings_are_those_of_the_operation_since_bring_up() {
    let mut bench = enabled();
    reports(&mut bench, &["082#2081080000000000"]);
    assert_eq!(bench.bring_up(), Ok(()));
    assert_eq!(warnings(&bench), []);
    let up = bench.now;
    reports(&mut bench, &["082#2081080000000000"]);
    let after = bench.now.since(up) - PERIOD / 2;
    assert_eq!(warnings(&bench)[0].after, after);
    assert!(after < Duration::from_secs(1));
}

#[test]
fn an_old_warning_does_not_name_a_later_fault() {
    let warning = "082#2081100000000000";
    // A code names a fault that the next four answers show.
    for (age, is_named) in [(0, true), (1, true), (3, true), (4, false), (10, false)] {
        // A fault whose EMCY was lost, and a loss of power.
        let mut bench = enabled();
        reports(&mut bench, &[warning]);
        (0..age).for_each(|_| reports(&mut bench, &[]));
        let frames = bench.cycle(&[answer(2, 0x0208, 1_000)], STAND);
        let asked = frames.get(2).map(String::as_str);
        let question = (!is_named).then_some("602#403F600000000000");
        assert_eq!(asked, question, "{age}");

        let mut bench = enabled();
        reports(&mut bench, &[warning]);
        (0..age).for_each(|_| reports(&mut bench, &[]));
        bench.cycle(&[answer(2, 0x0740, 1_000)], STAND);
        let (node, code, statusword) = (2, 0x8120, 0x0740);
        let fault = if is_named { Fault::Drive { node, code } } else { Fault::PowerLost { node, statusword } };
        assert_eq!(bench.states[0].fault, Some(fault), "{age}");
    }
}

#[test]
fn a_warning_and_an_internal_limit_in_the_statusword_are_warnings_once_per_axis() {
    for (bits, text) in [
        (0x0080, "node 2: the drive has a warning (statusword bit 7): read its error history, object 0x1003"),
        (
            0x0800,
            "node 2: an internal limit of the drive is in force (statusword bit 11): check its limits of position, \
             velocity and torque, and its limit switches",
        ),
    ] {
        let mut bench = enabled();
        let up = bench.now;
        for (bits, cycles) in [(0, 1), (bits, 3), (0, 1), (bits, 2)] {
            (0..cycles).for_each(|_| drop(bench.cycle(&bench.answers(0x0737 | bits, 1_000), STAND)));
        }
        let found = warnings(&bench);
        assert_eq!(found.iter().map(|it| (it.to_string(), it.count)).collect::<Vec<_>>(), [(text.to_owned(), 2)]);
        // Enabling took seven cycles.
        assert_eq!(found[0].after, bench.now.since(up) + 7 * PERIOD - 5 * PERIOD);
        assert_eq!(bench.states[0].fault, None);
    }
}

#[test]
fn an_internal_limit_of_a_drive_that_is_off_is_no_warning() {
    let mut bench = Bench::up(&[2]);
    for word in [0x0740, 0x0F40] {
        bench.cycle(&[answer(2, word, 1_000)], &[AxisCommand::Off]);
    }
    assert_eq!(warnings(&bench), []);
    bench.cycle(&[answer(2, 0x07C0, 1_000)], &[AxisCommand::Off]);
    assert_eq!(warnings(&bench).len(), 1);
}
