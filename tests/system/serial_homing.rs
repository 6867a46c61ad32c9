//! Homing by the host on serial lines finds the same reference from every start position.

use std::f64::consts::TAU;
use std::time::Duration;

use ::mrroc::cell::Cell;
use hil::plant::Switch;
use kit::cell::{Rig, Setup};
use kit::mrroc::SERIAL_CELLS;
use servo::{Order, Phase};

/// One increment of every encoder, rad of the motor.
const COUNT: f64 = TAU / 4000.0;

/// The cell with axes that start `start` rad above their home positions, and with bouncing switches.
fn rig(cell: &str, start: f64) -> Rig {
    let mut setup = Setup::of(cell);
    let homes = homes(&setup.cell);
    for (axis, home) in setup.cell.robot[0].axis.iter_mut().zip(&homes) {
        axis.emulator.start = Some(home + start);
        // Homing all axes at once gives the same result, and is faster.
        axis.homing.order = 0;
    }
    setup
        .with_plant(move |axis, plant| {
            plant.home_switch = Some(Switch { from: homes[axis] - 20.0, to: homes[axis] - 2.0, bounce: 5 });
        })
        .bring_up()
}

fn homes(cell: &Cell) -> Vec<f64> {
    let robot = cell.robot[0].arm().expect("parameters are sound");
    robot.robot().home().iter().copied().collect()
}

#[test]
fn every_axis_finds_its_reference_from_any_start() {
    for cell in SERIAL_CELLS {
        // Start positions above, at and below the switch, which is closed from 20 to 2 rad below the home position.
        for start in [20.0, 3.0, 0.0, -1.99, -2.01, -10.0, -19.9] {
            let mut rig = rig(cell, start);
            rig.home();
            for _ in 0..100 {
                rig.cycle();
            }
            for axis in 0..rig.scales.len() {
                let error = (rig.last.axis[axis].measured - rig.angle(axis)) / COUNT;
                assert!(error.abs() <= 1.0, "{cell}, axis {axis} from {start}: off by {error:.2} counts");
            }
        }
    }
}

/// An axis that starts below its switch meets the lower limit switch, at which its drive short-circuits the motor. The
/// axis reverses to find its reference, or reports a fault. It never continues into the limit.
#[test]
fn an_axis_that_runs_onto_its_limit_switch_goes_no_further() {
    for cell in SERIAL_CELLS {
        for axis in 0..5 {
            let mut setup = Setup::of(cell);
            setup.axes = vec![axis];
            let arm = setup.cell.robot[0].arm().expect("parameters are sound");
            let low = arm.robot().motor_limits()[axis].low;
            setup.cell.robot[0].axis[axis].emulator.start = Some(low + 5.0);
            let mut rig = setup.bring_up();
            rig.stand_by(Order::Enable);
            rig.order(Order::Home);
            rig.cycle();
            while rig.phase() == Phase::Homing {
                rig.cycle();
                let angle = rig.angle(0);
                assert!(angle > low - 1.0, "{cell}, axis {axis}: {:.2} rad", angle - low);
            }
            for _ in 0..100 {
                rig.cycle();
            }
            let error = (rig.last.axis[0].measured - rig.angle(0)) / COUNT;
            match rig.servo.fault(0) {
                None => assert!(error.abs() <= 1.0, "{cell}, axis {axis}: off by {error:.2} counts"),
                Some(fault) => {
                    println!("{cell}, axis {axis}: {}", fault.cause);
                    assert_eq!(fault.axis, Some(0), "{cell}, axis {axis}");
                }
            }
        }
    }
}

#[test]
fn no_answer_is_missed_on_lines_without_faults() {
    for cell in SERIAL_CELLS {
        let mut rig = rig(cell, 20.0);
        rig.home();
        rig.stand_by(Order::Home);
        let mut motion = rig.in_motion();
        rig.follow(&mut motion, |rig| rig.phase() == Phase::Standing);
        rig.order(Order::Disable);
        rig.until(Duration::from_secs(5), "off", |rig| rig.servo.is_off());
        assert_eq!(rig.missed_answers(), 0, "{cell}");
    }
}
