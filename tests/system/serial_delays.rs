//! Answers of serial lines that begin to come late in motion.

use std::time::Duration;

use drive::Fault;
use drive::axis_controller::AxisControllerFault;
use hil::LineFaults;
use kit::cell::{Rig, Setup};
use kit::motion::Motion;
use kit::mrroc::SERIAL_CELLS;
use servo::{Phase, StopCause};

/// Time from the first late answer to the fault: the tolerated cycles, and those of the telegrams that are left out. A delay
/// of three periods on hi-moxa takes a second telegram.
fn found(late: Duration) -> Duration {
    let three_periods = Duration::from_micros(5_400)..Duration::from_micros(8_000);
    Duration::from_millis(if three_periods.contains(&late) { 26 } else { 18 })
}

/// Lets the answers of the third axis come later by `late`, in motion. Returns the fault of the axis.
fn delayed(rig: &mut Rig, late: Duration) -> Option<AxisControllerFault> {
    rig.home();
    let mut motion = rig.in_motion();
    rig.set_line_faults(2, &LineFaults { late, ..LineFaults::default() });
    let end = rig.now + found(late);
    while rig.servo.fault(0).is_none() && rig.now < end {
        rig.feed(&mut motion);
        rig.cycle();
    }
    let Some(fault) = rig.servo.fault(0) else {
        assert!(late < Duration::from_micros(1_500), "no fault");
        rig.follow(&mut motion, |rig| rig.phase() == Phase::Standing);
        return None;
    };
    assert_eq!(fault.axis, Some(2));
    let latched = rig.angles();
    rig.until(Motion::LONGEST, "stopped", |rig| rig.phase() == Phase::Faulted);
    // A motor without power runs on until friction stops it.
    rig.at_rest(&latched, 12.0);
    match fault.cause {
        StopCause::Drive(Fault::AxisController { line: 2, fault }) => Some(fault),
        other => panic!("{other}"),
    }
}

#[test]
fn answers_that_become_late_in_motion_stop_the_robot_by_their_name() {
    for cell in SERIAL_CELLS {
        for late in [1_000, 1_800, 3_000, 4_000, 5_000, 7_600, 40_000].map(Duration::from_micros) {
            let mut rig = Setup::of(cell).bring_up();
            let fault = delayed(&mut rig, late);
            let expected = match late.as_micros() {
                // The answer still comes within its period.
                0..1_500 => fault.is_none(),
                1_500..3_400 => matches!(fault, Some(AxisControllerFault::Delayed { periods: 1, .. })),
                3_400..5_400 => matches!(fault, Some(AxisControllerFault::Delayed { periods: 2, .. })),
                _ => matches!(
                    fault,
                    Some(AxisControllerFault::Silent { .. } | AxisControllerFault::Delayed { periods: 3, .. })
                ),
            };
            assert!(expected, "{cell}, {late:?}: {fault:?}");
        }
    }
}
