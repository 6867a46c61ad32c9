//! Checks of a position loop closed by the host.
//!
//! The bounds of the gains do not guarantee a good design; they exclude impossible sampled loops. No error is
//! corrected faster than in one period. One encoder count does not saturate the output. A position error of
//! `following_error` changes the output by at least a thousandth of its limit.

use std::time::Duration;

use servo::LoopBounds;

use super::{Checked, by_servo, refused, within};
use crate::cell::{Axis, AxisController, Control, Drive, DriveControl, Law, Loop, Path, Range};

/// Greatest output of a loop, and greatest output per newton metre of weight.
struct Output {
    most: f64,
    of: &'static str,
    /// Greatest factor of the weight.
    weight: f64,
}

pub(super) fn check_controller(
    path: &Path,
    period: Duration,
    controller: &AxisController,
    axis: &Axis,
) -> Checked {
    let output = match controller.control {
        // A greater output is refused during motion, and the axis would stop by a fault where the torque is needed
        // most.
        Control::Current => Output {
            most: controller.max_current * controller.torque_constant * (1.0 + 1e-9),
            of: "N·m; max_current * torque_constant at the most",
            weight: 10.0,
        },
        Control::Pwm => Output {
            most: 1.0,
            of: "of the full pulse width",
            weight: 1000.0,
        },
    };
    let given = &controller.r#loop;
    if let Law::Proportional(_) = given.law {
        let why =
            "is for a drive that closes the velocity loop, as no axis controller does: use cascade";
        return refused(&path.then("law"), "proportional", why);
    }
    check(path, period, given, &output, axis)
}

/// Checks the loop of the drive at `drive_path`.
pub(super) fn check_drive(
    drive_path: &Path,
    period: Duration,
    drive: &Drive,
    axis: &Axis,
) -> Checked {
    let path = &drive_path.then("loop");
    let (given, output) = match (drive.control, &drive.r#loop) {
        (DriveControl::Position, None) => return Ok(()),
        (DriveControl::Position, Some(_)) => {
            let why = "is for control = \"velocity\" or \"torque\": by position the drive closes the loop";
            return refused(drive_path, "loop", why);
        }
        (_, None) => {
            let why = "is missing: by velocity or torque the host closes the loop";
            return refused(drive_path, "loop", why);
        }
        (DriveControl::Velocity, Some(given)) => {
            if given.feed_forward.weight.is_some_and(|weight| weight > 0.0) {
                let why = "is a torque: by velocity the drive's own loop holds the weight";
                return refused(&path.then("feed_forward"), "weight", why);
            }
            // A loop at its limit must not look like a runaway loop.
            let output = Output {
                most: axis.runaway_velocity(),
                of: "rad/s of the motor; runaway_velocity at the most",
                weight: 0.0,
            };
            (given, output)
        }
        (DriveControl::Torque, Some(given)) => {
            if let Law::Proportional(_) = given.law {
                let why =
                    "is for control = \"velocity\": by torque nothing would damp it, use cascade";
                return refused(&path.then("law"), "proportional", why);
            }
            // Object 0x6071 holds 16 bits of thousandths.
            let output = Output {
                most: 32.0 * drive.rated_torque,
                of: "N·m; 32 * rated_torque at the most",
                weight: 10.0,
            };
            (given, output)
        }
    };
    check(path, period, given, &output, axis)
}

fn check(path: &Path, period: Duration, given: &Loop, output: &Output, axis: &Axis) -> Checked {
    if let Some(runaway) = given.runaway_velocity {
        let of = "rad/s of the motor; above max_velocity";
        let range = Range::new(axis.max_velocity * (1.0 + 1e-9), 1e6, of);
        within(path, "runaway_velocity", runaway, range)?;
    }
    let bounds = LoopBounds {
        period,
        counts_per_revolution: axis.counts_per_revolution(),
        max_velocity: axis.max_velocity,
        max_acceleration: axis.max_acceleration,
        following_error: axis.following_error,
        most: output.most,
        of: output.of,
        weight: output.weight,
    };
    let law = given.law.check(&bounds);
    law.map_err(|refusal| by_servo(&path.then("law"), refusal))?;
    let feed_forward = given.feed_forward.check(given.law.limit(), &bounds);
    feed_forward.map_err(|refusal| by_servo(&path.then("feed_forward"), refusal))
}
