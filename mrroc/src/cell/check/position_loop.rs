//! Checks of a position loop closed by the host.
//!
//! The bounds of the gains do not guarantee a good design; they exclude impossible sampled loops. No error is
//! corrected faster than in one period. One encoder count does not saturate the output. A position error of
//! `following_error` changes the output by at least a thousandth of its limit.

use std::f64::consts::TAU;
use std::time::Duration;

use super::{Checked, no_effect, refused, within};
use crate::cell::text::Range;
use crate::cell::{
    Axis, AxisController, Control, Drive, DriveControl, FeedForward, Law, Loop, Path,
};

/// Least limit of the output, as a fraction of the greatest output.
const LEAST_LIMIT: f64 = 1e-3;

/// Least output for a position error of `following_error`, as a fraction of the limit.
const LEAST_OUTPUT: f64 = 1e-3;

/// Least position gain, 1/s, with which an error decays in some minutes.
const LEAST_GAIN: f64 = 0.01;

/// Greatest rate of integration per period. An integral that cancels the pole of a motor may be as fast as the motor.
const INTEGRATED: f64 = 100.0;

/// Greatest coefficient of the incremental law.
const GREATEST: f64 = 1e6;

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
        return refused(path.then("law").then("proportional"), why);
    }
    check(path, period, given, &output, axis)
}

pub(super) fn check_drive(path: &Path, period: Duration, drive: &Drive, axis: &Axis) -> Checked {
    let (given, output) = match (drive.control, &drive.r#loop) {
        (DriveControl::Position, None) => return Ok(()),
        (DriveControl::Position, Some(_)) => {
            let why = "is for control = \"velocity\" or \"torque\": by position the drive closes the loop";
            return refused(path.clone(), why);
        }
        (_, None) => {
            let why = "is missing: by velocity or torque the host closes the loop";
            return refused(path.clone(), why);
        }
        (DriveControl::Velocity, Some(given)) => {
            if given.feed_forward.weight.is_some_and(|weight| weight > 0.0) {
                let why = "is a torque: by velocity the drive's own loop holds the weight";
                return refused(path.then("feed_forward").then("weight"), why);
            }
            // A loop at its limit must not look like a runaway loop.
            let output = Output {
                most: given.runaway_velocity.unwrap_or(1.2 * axis.max_velocity),
                of: "rad/s of the motor; runaway_velocity at the most",
                weight: 0.0,
            };
            (given, output)
        }
        (DriveControl::Torque, Some(given)) => {
            if let Law::Proportional(_) = given.law {
                let why =
                    "is for control = \"velocity\": by torque nothing would damp it, use cascade";
                return refused(path.then("law").then("proportional"), why);
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
        within(&path.then("runaway_velocity"), runaway, range)?;
    }
    let limit = check_law(&path.then("law"), period, given, output, axis)?;
    check_feed_forward(
        &path.then("feed_forward"),
        &given.feed_forward,
        limit,
        output,
        axis,
    )
}

/// Checks the law and returns its limit.
fn check_law(
    path: &Path,
    period: Duration,
    given: &Loop,
    output: &Output,
    axis: &Axis,
) -> Result<f64, (Path, crate::cell::Problem)> {
    let limited = |path: &Path, limit: f64| {
        let range = Range::new(LEAST_LIMIT * output.most, output.most, output.of);
        within(&path.then("limit"), limit, range)
    };
    let period = period.as_secs_f64();
    let count = TAU / f64::from(axis.counts_per_revolution());
    let error = axis.following_error;
    let rate = Range::new(0.0, INTEGRATED / period, "1/s; 100 per period at the most");
    let of = "1/s; one per period at the most";
    let position_gain = Range::new(LEAST_GAIN, 1.0 / period, of);
    let fraction = Range::new(0.0, 1.0 - f64::EPSILON, "below 1");
    match given.law {
        Law::Incremental(it) => {
            let path = path.then("incremental");
            limited(&path, it.limit)?;
            within(&path.then("a"), it.a, fraction)?;
            within(
                &path.then("b0"),
                it.b0,
                Range::new(f64::MIN_POSITIVE, GREATEST, ""),
            )?;
            within(&path.then("b1"), it.b1, Range::new(0.0, GREATEST, ""))?;
            within(&path.then("eps"), it.eps, fraction)?;
            let because = "with integral = false";
            no_effect(&path.then("eps"), !it.integral && it.eps != 0.0, because)?;
            let of = "one count does not put out more than limit";
            let gain = Range::new(f64::MIN_POSITIVE, it.limit / it.b0, of);
            within(&path.then("gain"), it.gain, gain)?;
            Ok(it.limit)
        }
        Law::Cascade(it) => {
            let path = path.then("cascade");
            limited(&path, it.limit)?;
            within(&path.then("position_gain"), it.position_gain, position_gain)?;
            within(&path.then("integral_rate"), it.integral_rate, rate)?;
            let least = LEAST_OUTPUT * it.limit / (it.position_gain * error);
            let most = it.limit * period / count;
            let of = "output per rad/s; following_error puts out something, one count not all";
            let velocity_gain = Range::new(least.min(most), most, of);
            within(&path.then("velocity_gain"), it.velocity_gain, velocity_gain)?;
            Ok(it.limit)
        }
        Law::Proportional(it) => {
            let path = path.then("proportional");
            limited(&path, it.limit)?;
            let least = LEAST_OUTPUT * it.limit / error;
            let of = "1/s; following_error puts out something, and one per period at the most";
            let least = least.clamp(LEAST_GAIN, position_gain.high);
            let gain = Range::new(least, position_gain.high, of);
            within(&path.then("position_gain"), it.position_gain, gain)?;
            within(&path.then("integral_rate"), it.integral_rate, rate)?;
            Ok(it.limit)
        }
    }
}

/// The feed-forward output must be within the limit of the loop.
fn check_feed_forward(
    path: &Path,
    given: &FeedForward,
    limit: f64,
    output: &Output,
    axis: &Axis,
) -> Checked {
    let up_to = |most: f64, of| Range::new(0.0, most, of);
    let of = "limit / max_velocity at the most";
    let velocity = up_to(limit / axis.max_velocity, of);
    within(&path.then("velocity"), given.velocity, velocity)?;
    let of = "limit / max_acceleration at the most";
    let acceleration = up_to(limit / axis.max_acceleration, of);
    within(&path.then("acceleration"), given.acceleration, acceleration)?;
    within(
        &path.then("coulomb"),
        given.coulomb,
        up_to(limit, "limit at the most"),
    )?;
    let weight = up_to(output.weight, "output per N·m");
    within(&path.then("weight"), given.weight.unwrap_or(0.0), weight)?;
    let constant = Range::new(-limit, limit, "limit at the most, either way");
    within(&path.then("constant"), given.constant, constant)?;
    let stribeck = path.then("stribeck_velocity");
    match (given.stiction, given.stribeck_velocity) {
        (None, None) => Ok(()),
        (None, Some(_)) => {
            let why = "is for a friction that is greater at break-away: stiction";
            refused(stribeck, why)
        }
        (Some(stiction), falls) => {
            let path = path.then("stiction");
            let range = Range::new(
                given.coulomb,
                limit,
                "coulomb at the least, limit at the most",
            );
            within(&path, stiction, range)?;
            let Some(velocity) = falls else {
                let why = "needs the velocity over which it falls: stribeck_velocity";
                return refused(path, why);
            };
            within(
                &stribeck,
                velocity,
                Range::new(1e-3, 1e5, "rad/s of the motor"),
            )
        }
    }
}
