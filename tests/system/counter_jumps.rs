//! Counters that jump in motion and at rest: the jump is a fault, and the axis has no reference afterwards.

use std::time::Duration;

use drive::Fault;
use drive::axis_controller::AxisControllerFault;
use hil::{PlantFault, WorldFault};
use kit::cell::{Rig, Setup};
use kit::motion::Motion;
use servo::{Order, Phase, StopCause};

/// Cells of both families, and the protocol of their drives.
const CELLS: [&str; 6] = ["irb6", "irp6", "rnt", "polycrank", "irb6-serial", "irb6-hi-moxa"];

/// Time from a jump to its fault: three answers, and the delays of a serial line.
const FOUND: Duration = Duration::from_millis(20);

fn homed(cell: &str) -> Rig {
    let mut rig = Setup { axes: vec![0], ..Setup::of(cell) }.bring_up();
    rig.home();
    // Behind the time in which a drive may set its counter.
    for _ in 0..50 {
        rig.cycle();
    }
    rig
}

/// Lets the counter jump by `increments`, and runs until a fault. Returns its cause.
fn jump(rig: &mut Rig, increments: i32, mut motion: Option<Motion>) -> Option<StopCause> {
    let drive = rig.drives[0];
    let fault = WorldFault::Plant { drive, fault: PlantFault::EncoderJump(increments) };
    rig.world.begin_fault(&fault, rig.now);
    let end = rig.now + FOUND;
    while rig.servo.fault(0).is_none() && rig.now < end {
        motion.iter_mut().for_each(|motion| rig.feed(motion));
        rig.cycle();
    }
    rig.servo.fault(0).map(|fault| fault.cause)
}

fn is_jump(cause: Option<StopCause>) -> bool {
    matches!(
        cause,
        Some(StopCause::Drive(
            Fault::Implausible { .. } | Fault::AxisController { fault: AxisControllerFault::Jumped { .. }, .. }
        ))
    )
}

/// 600 increments are 0.15 turns of the motor. At 50 rad/s, 14 ms of delay explain 450 increments on CAN.
#[test]
fn a_jump_in_motion_and_at_rest_is_found_and_ends_the_reference() {
    for cell in CELLS {
        for increments in [600, -600, 1000, -1000] {
            for moving in [true, false] {
                let mut rig = homed(cell);
                let motion = moving.then(|| rig.in_motion());
                let cause = jump(&mut rig, increments, motion);
                // A motor at rest that seems to step and to stand is also taken for a counter that fails.
                let fails = matches!(cause, Some(StopCause::Frozen { .. })) && !moving;
                assert!(is_jump(cause) || fails, "{cell}, {increments}, moving {moving}: {cause:?}");
                rig.until(Duration::from_secs(5), "stopped", |rig| rig.phase() == Phase::Faulted);
                rig.order(Order::ResetFault);
                rig.until(Duration::from_secs(5), "reset", |rig| rig.phase() != Phase::Faulted);
                assert!(!rig.is_homed(), "{cell}, {increments}, moving {moving}");
            }
        }
    }
}
