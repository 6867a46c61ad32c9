//! Power that returns after a fault moves no motor: on CAN in every cyclic mode, and on both serial protocols.

use std::time::Duration;

use ::mrroc::cell::DriveControl;
use hil::plant::Irp6Axis;
use hil::{LineFaults, Stuck, WireFaults};
use kit::cell::{Rig, Setup};
use kit::motion::Motion;
use kit::mrroc::SERIAL_CELLS;
use servo::{Order, Phase};

use crate::host_closed::closed_by_host;

/// Greatest motion of a motor while its loop takes up the load, rad.
const LOAD: f64 = 0.15;

/// The time without answers of the drive of axis 2.
const SILENCE: Duration = Duration::from_millis(20);

fn silence(rig: &mut Rig, on: bool) {
    if rig.cell.bus.is_empty() {
        let stuck = Some(Stuck::Silent).filter(|_| on);
        let to_host = WireFaults { stuck, ..WireFaults::default() };
        rig.set_line_faults(2, &LineFaults { seed: 1, to_host, ..LineFaults::default() });
    } else {
        rig.unplug(2, on);
    }
}

/// Stops the robot in motion by a silent drive, resets the fault, and enables again. Asserts that no motor moves by
/// [`LOAD`] or more.
fn stop_and_enable_again(name: &str, setup: Setup) {
    let mut rig = setup.bring_up();
    rig.home();
    // In these cycles, each loop settles and stores the output that holds the arm.
    (0..100).for_each(|_| rig.cycle());
    for round in 0..2 {
        let mut motion = rig.in_motion();
        silence(&mut rig, true);
        let end = rig.now + SILENCE;
        while rig.now < end {
            rig.feed(&mut motion);
            rig.cycle();
        }
        silence(&mut rig, false);
        assert!(rig.servo.fault(0).is_some(), "{name}");
        rig.until(Motion::LONGEST, "stopped", |rig| rig.phase() == Phase::Faulted);
        // The motors come to rest, where the set-points of the stop were not.
        for _ in 0..500 {
            rig.cycle();
        }
        rig.order(Order::ResetFault);
        rig.cycle();
        rig.until(Motion::LONGEST, "reset", |rig| rig.phase() == Phase::Off && rig.servo.fault(0).is_none());
        let before = rig.angles();
        let mut farthest: f64 = 0.0;
        rig.order(Order::Enable);
        for _ in 0..1_000 {
            rig.cycle();
            let moved = before.iter().zip(rig.angles()).map(|(before, now)| (now - before).abs());
            farthest = moved.fold(farthest, f64::max);
        }
        assert_eq!((rig.phase(), rig.servo.fault(0)), (Phase::Standing, None), "{name}, round {round}");
        println!("{name}, round {round}: {farthest:.3} rad");
        assert!(farthest < LOAD, "{name}, round {round}: a motor moved by {farthest:.3} rad");
    }
}

#[test]
fn a_robot_on_can_that_is_enabled_again_after_a_fault_does_not_move() {
    for control in [DriveControl::Position, DriveControl::Velocity, DriveControl::Torque] {
        let mut setup = Setup::of("irb6");
        for (axis, kind) in setup.cell.robot[0].axis.iter_mut().zip(Irp6Axis::ALL) {
            closed_by_host(axis, kind, control);
        }
        stop_and_enable_again(&format!("{control:?}"), setup);
    }
}

#[test]
fn a_robot_on_serial_lines_that_is_enabled_again_after_a_fault_does_not_move() {
    for cell in SERIAL_CELLS {
        stop_and_enable_again(cell, Setup::of(cell));
    }
}
