//! Answers of axis controllers on serial lines that are old, in the wrong order, garbled, or those of another axis.

use std::time::Duration;

use ::mrroc::cell::Protocol;
use ::mrroc::scenario::{FaultKind, FaultNumbers, FaultPlace};
use drive::Fault;
use drive::axis_controller::AxisControllerFault;
use kit::cell::Setup;
use kit::mrroc::SERIAL_CELLS;
use servo::StopCause;

/// Axis with the fault; its answers are swapped with those of the next axis.
const AXIS: usize = 2;

/// Longest time until an answer of each second cycle is a fault: a window of 200 cycles.
const FOUND: Duration = Duration::from_millis(420);

/// Lets a fault of answers strike at rest or in motion. Returns the protocol, and the cause of the first fault.
fn struck(cell: &str, kind: FaultKind, moving: bool) -> (Protocol, Option<StopCause>) {
    let mut rig = Setup::of(cell).bring_up();
    rig.home();
    let mut motion = moving.then(|| rig.in_motion());
    let place = FaultPlace::Line { drive: rig.drives[AXIS], next: Some(rig.drives[AXIS + 1]) };
    for fault in kind.faults(&place, &FaultNumbers::default()).unwrap() {
        rig.world.begin_fault(&fault, rig.now);
    }
    let end = rig.now + FOUND;
    while rig.servo.fault(0).is_none() && rig.now < end {
        motion.iter_mut().for_each(|motion| rig.feed(motion));
        rig.cycle();
    }
    (rig.cell.serial[0].protocol, rig.servo.fault(0).map(|fault| fault.cause))
}

#[test]
fn what_is_wrong_with_the_answers_of_a_line_is_the_cause_of_the_stop() {
    use AxisControllerFault as F;
    use FaultKind::{AnswersGarbled, AnswersOld, AnswersReversed, AnswersSwapped};
    use Protocol::{HiMoxa, Nfv2};
    for cell in SERIAL_CELLS {
        for kind in [AnswersOld, AnswersReversed, AnswersGarbled, AnswersSwapped] {
            for moving in [true, false] {
                let (protocol, cause) = struck(cell, kind, moving);
                let what = format!("{cell}, {kind:?}, moving {moving}: {cause:?}");
                println!("{what}");
                let fault = match cause {
                    None => None,
                    Some(StopCause::Drive(Fault::AxisController { fault, .. })) => Some(fault),
                    Some(_) => panic!("{what}"),
                };
                let expected = match (protocol, kind, moving) {
                    // An old answer names its request, and every second answer is in time.
                    (Nfv2, AnswersOld, _) => fault.is_none(),
                    // Old answers of a motor at rest are those in time, as far as anybody can see.
                    (HiMoxa, AnswersOld, false) => matches!(fault, None | Some(F::Old { .. })),
                    (HiMoxa, AnswersOld, true) => matches!(fault, Some(F::Old { .. })),
                    (Nfv2, AnswersReversed, _) | (HiMoxa, AnswersReversed, false) => {
                        matches!(fault, Some(F::Late { .. } | F::Reversed { .. }))
                    }
                    (HiMoxa, AnswersReversed, true) => matches!(fault, Some(F::Reversed { .. })),
                    (_, AnswersGarbled, _) => matches!(fault, Some(F::Garbled { .. })),
                    (Nfv2, AnswersSwapped, _) => matches!(fault, Some(F::OtherDrive { .. })),
                    (HiMoxa, AnswersSwapped, true) => matches!(fault, Some(F::Swapped { .. })),
                    // Two axes at rest whose counters agree.
                    (HiMoxa, AnswersSwapped, false) => matches!(fault, None | Some(F::Swapped { .. })),
                    (_, other, _) => panic!("{other:?}"),
                };
                assert!(expected, "{what}");
            }
        }
    }
}
