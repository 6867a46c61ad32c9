//! Bring-up: identity, absence, garbage and other matrices.

use super::*;

#[test]
fn a_matrix_of_the_declared_kind_comes_up() {
    let mut rig = Rig::with(config(), Script::new(3));
    assert_eq!(rig.link.read().fault, Some(UltrasonicFault::NotStarted));
    rig.line.script().outbox.extend(*b"booting\r\n");
    assert_eq!(rig.bring_up(), Ok(()));
    assert_eq!(rig.line.script().heard, [[1]]);
    let state = rig.link.read();
    assert_eq!((state.fault, state.measured()), (None, None));
}

#[test]
fn a_lost_question_is_repeated() {
    let script = Script { mute: 3, ..Script::new(3) };
    let rig = Rig::up_with(config(), script);
    assert_eq!(rig.line.script().heard.len(), 4);
}

#[test]
fn another_matrix_and_no_matrix_are_refused() {
    let cases: [(Script, UltrasonicError, &str); 5] = [
        (
            Script::new(12),
            UltrasonicError::OfAnotherSize { declared: 3, found: 12 },
            "the matrix has 12 × 12 elements, declared were 3 × 3",
        ),
        (
            Script { pitch: 150, ..Script::new(3) },
            UltrasonicError::OfAnotherPitch { declared: 200, found: 150 },
            "the elements are 150 × 0.1 mm apart, declared were 200 × 0.1 mm",
        ),
        (
            Script { slot: 5_000, ..Script::new(3) },
            UltrasonicError::OfAnotherSlot { declared: 3_500, found: 5_000 },
            "a firing slot takes 5000 µs, declared were 3500 µs",
        ),
        (
            Script { refusal: Some(1), ..Script::new(3) },
            UltrasonicError::Refused { reason: 1 },
            "the matrix refused its identity with reason 1: check its firmware",
        ),
        (Script { gone: true, ..Script::new(3) }, UltrasonicError::Line(LineError::Gone), &LineError::Gone.to_string()),
    ];
    for (script, error, text) in cases {
        assert_eq!(Rig::with(config(), script).bring_up(), Err(error));
        assert_eq!(error.to_string(), text);
    }
}

#[test]
fn silence_and_garbage_end_bring_up_at_its_time_limit() {
    let mut rig = Rig::with(config(), Script { mute: u32::MAX, ..Script::new(3) });
    let begun = rig.now;
    let Err(UltrasonicError::Absent { waited }) = rig.bring_up() else { panic!("the matrix is absent") };
    assert_eq!(waited, rig.now.since(begun));
    assert!((config().boot_timeout..config().boot_timeout + 2 * PERIOD).contains(&waited), "{waited:?}");
    let mut rig = Rig::with(config(), Script { broken: u32::MAX, ..Script::new(3) });
    assert!(matches!(rig.bring_up(), Err(UltrasonicError::Garbled { bytes: 9.. })));
}

#[test]
fn a_bring_up_after_a_fault_clears_it() {
    let mut rig = Rig::up();
    rig.line.script().gone = true;
    assert_eq!(rig.run(1).fault, Some(UltrasonicFault::Line(LineError::Gone)));
    rig.line.script().gone = false;
    assert_eq!(rig.bring_up(), Ok(()));
    assert_eq!(rig.until(|state| state.measured().is_some()).scan.number, 1);
}
