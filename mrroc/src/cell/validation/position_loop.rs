//! Checks of a position loop closed by the host.
//!
//! The bounds of the gains do not guarantee a good design; they exclude impossible sampled loops. No error is
//! corrected faster than in one period. One encoder count does not saturate the output. A position error of
//! `following_error` changes the output by at least a thousandth of its limit. With the dead time of the drives, the loop
//! is stable with twice its gain.

use std::time::Duration;

use servo::{LoopBounds, Output};

use super::{Checked, by_servo, refused, within};
use crate::cell::{Axis, Drive, DriveControl, Law, Path, Range};

/// Checks that the table of a drive at `path` has a loop where the host closes it, and checks the loop.
pub(super) fn check_drive(path: &Path, period: Duration, drive: &Drive, axis: &Axis) -> Checked {
    let why = match (drive.control, &drive.r#loop) {
        (DriveControl::Position, None) => return Ok(()),
        (DriveControl::Position, Some(_)) => {
            "is for control = \"velocity\" or \"torque\": by position the drive closes the loop"
        }
        (_, None) => "is missing: by velocity or torque the host closes the loop",
        (_, Some(_)) => return check(path, period, axis),
    };
    refused(path, "loop", why)
}

/// Checks the loop that the host closes, in the table of a drive or an axis controller at `path`.
pub(super) fn check(path: &Path, period: Duration, axis: &Axis) -> Checked {
    let Some((_, given, output)) = axis.host_loop() else {
        return Ok(());
    };
    let path = &path.then("loop");
    let proportional = |why| refused(&path.then("law"), "proportional", why);
    let is_proportional = matches!(given.law, Law::Proportional(_));
    // Greatest output of the loop with its unit, and greatest output per newton metre of weight.
    let (most, of, weight) = match (output, &axis.drive) {
        (Output::Velocity, _) => {
            if given.feed_forward.weight.is_some_and(|weight| weight > 0.0) {
                let why = "is a torque: by velocity the drive's own loop holds the weight";
                return refused(&path.then("feed_forward"), "weight", why);
            }
            // A loop at its limit must not look like a runaway loop.
            (axis.runaway_velocity(), "rad/s of the motor; runaway_velocity at the most", 0.0)
        }
        (_, Some(_)) if is_proportional => {
            return proportional("is for control = \"velocity\": by torque nothing would damp it, use cascade");
        }
        (_, None) if is_proportional => {
            return proportional(
                "is for a drive that closes the velocity loop, as no axis controller does: use cascade",
            );
        }
        (_, Some(drive)) => {
            // Object 0x6071 holds 16 bits of thousandths.
            (32.0 * drive.rated_torque, "N·m; 32 * rated_torque at the most", 10.0)
        }
        (Output::Torque, None) => {
            // A greater output is refused during motion, and the axis would stop by a fault where the torque is needed
            // most.
            let controller = axis.axis_controller();
            let most = controller.max_current * controller.torque_constant * (1.0 + 1e-9);
            (most, "N·m; max_current * torque_constant at the most", 10.0)
        }
        (Output::Duty, None) => (1.0, "of the full pulse width", 1000.0),
    };
    if let Some(runaway) = given.runaway_velocity {
        let range = Range::new(axis.max_velocity * (1.0 + 1e-9), 1e6, "rad/s of the motor; above max_velocity");
        within(path, "runaway_velocity", runaway, range)?;
    }
    let bounds = LoopBounds {
        period,
        counts_per_revolution: axis.counts_per_revolution(),
        max_velocity: axis.max_velocity,
        max_acceleration: axis.max_acceleration,
        following_error: axis.following_error,
        most,
        of,
        weight,
    };
    given.law.check(&bounds).map_err(|refusal| by_servo(&path.then("law"), refusal))?;
    let feed_forward = given.feed_forward.check(given.law.limit(), &bounds);
    feed_forward.map_err(|refusal| by_servo(&path.then("feed_forward"), refusal))?;
    axis.loop_plant(period)
        .map_or(Ok(()), |(plant, law, _)| plant.check(&law))
        .map_err(|refusal| by_servo(&path.then("law"), refusal))
}
