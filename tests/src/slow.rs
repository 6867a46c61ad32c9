//! Example cells for benches by the clock: longer periods and longer time limits.

use ::mrroc::cell::{Cell, Control, Law, Wait};

use crate::mrroc::{self, text};

/// A longer period and longer time limits.
pub fn shorten(cell: &mut Cell) {
    mrroc::shorten(cell);
    cell.period_us = 10_000;
    cell.macrostep = 4;
    cell.max_missed_in_row = 300;
    cell.flight_recorder_s = 120;
    // The emulators use the same, only processor.
    cell.realtime.wait = Wait::Plain;
    for bus in &mut cell.bus {
        bus.tolerated_missing = 150;
        bus.heartbeat_ms = 1000;
        bus.boot_timeout_ms = 10_000;
    }
    // Delays of the test machine must not be taken for motion of the arm.
    for axis in cell.robot.iter_mut().flat_map(|robot| &mut robot.axis) {
        axis.following_error = 100.0;
    }
}

/// Gains for loops of the host with a period `times` longer than 2 ms, by the rule of the shipped gains:
/// `loops/cascades.rs`.
pub fn slow_down(cell: &mut Cell, times: f64) {
    for axis in cell.robot.iter_mut().flat_map(|robot| &mut robot.axis) {
        let by_duty = axis.controller.as_ref().is_some_and(|controller| controller.control == Control::Pwm);
        let of_line = axis.controller.as_mut().map(|it| &mut it.r#loop);
        let of_drive = axis.drive.as_mut().and_then(|it| it.r#loop.as_mut());
        match of_line.or(of_drive).map(|it| &mut it.law) {
            None => {}
            Some(Law::Cascade(law)) => {
                law.position_gain /= times;
                law.velocity_gain /= times;
                // With pulse-width output, this parameter cancels the motor's pole and does not change.
                law.integral_rate /= if by_duty { 1.0 } else { times };
            }
            Some(Law::Proportional(law)) => law.position_gain /= times,
            Some(Law::Incremental(law)) => panic!("no rule for {law:?}"),
        }
    }
}

/// Example cell `name` with a longer period for the test machine, modified by `change`.
pub fn slower(name: &str, change: impl FnOnce(&mut Cell)) -> Cell {
    let mut cell = Cell::parse(&text(name)).unwrap();
    shorten(&mut cell);
    change(&mut cell);
    let times = f64::from(cell.period_us) / 2000.0;
    slow_down(&mut cell, times);
    cell
}

/// Mean gravity torque of the IRb-6's arm at its motors, N·m.
pub const WEIGHTS: [(&str, f64); 2] = [("upper-arm", -0.395), ("wrist-pitch", 0.037)];

/// The laboratory with a period that the test machine can keep. Both processes together use some 5 ms of its processor
/// in each cycle.
///
/// With a tenth of the gains, a loop of the IRb-6 has a hundredth of its stiffness. The weight alone would turn the
/// motor of the upper arm by 26 rad before the integral part holds it. This is most of the distance that a search may
/// take. The weight is therefore fed forward.
pub fn slower_laboratory(cell: &mut Cell) {
    cell.period_us = 20_000;
    cell.macrostep = 2;
    cell.serial[0].tolerated_missing = 10;
    cell.serial[0].answer_timeout_ms = 1000;
    for axis in &mut cell.robot[0].axis {
        let weight = WEIGHTS.iter().find(|(name, _)| *name == axis.name);
        if let (Some((_, weight)), Some(controller)) = (weight, &mut axis.controller) {
            controller.r#loop.feed_forward.constant = *weight;
        }
    }
}
