//! Checks of the homing of an axis: the method must find home, and the search must end.

use std::time::Duration;

use super::{Checked, axis::Place, no_effect, refused, within};
use crate::cell::drives::FARTHEST_INDEX;
use crate::cell::{Axis, Path, Range};
use controller::robot::Limits;

/// The homing methods of an EPOS4.
const METHODS: [i8; 15] = [37, 34, 33, 27, 23, 18, 17, 11, 7, 2, 1, -1, -2, -3, -4];

/// Methods whose reference is the negative end of the travel (a limit switch or a mechanical stop), and methods for
/// the positive end. The ends refer to the direction of the drive's counter.
const NEGATIVE_END: [i8; 4] = [1, 17, -2, -4];
const POSITIVE_END: [i8; 4] = [2, 18, -1, -3];

/// Greatest distance of home from such an end, rad. A switch, an index pulse and a buffer lie in between.
const NEAR_END: f64 = FARTHEST_INDEX;

/// Greatest travel of an axis with ends, rad. A greater travel means an axis without ends, whose limits are those of
/// the counter.
const ENDLESS: f64 = 1e5;

/// Longest time of a search across the travel, s. The ways to the end, back, and off a switch as wide as the travel
/// then take an hour.
const CROSSING: f64 = 1200.0;

/// Least distance of a search of an axis without ends, rad, and time-out of such a search by the drive, s.
const ENDLESS_SEARCH: (f64, f64) = (100.0, 120.0);

/// Longest time from the home switch to the index pulse, s, in a search by the host.
const ZEROING: f64 = 300.0;

/// Least time for a drive to begin its search, periods. A controlword takes effect within four.
const START_PERIODS: f64 = 10.0;

/// Longest time for a drive to begin its search, ms.
const LONGEST_START: f64 = 60_000.0;

/// Longest time until a search reaches its velocity, s.
const RAMP: f64 = 10.0;

/// Whether an axis with these limits turns without end.
pub(super) fn is_endless(limits: Limits) -> bool {
    limits.high - limits.low > ENDLESS
}

/// The least homing velocity for an axis with these limits, rad/s.
pub(super) fn slowest(limits: Limits) -> f64 {
    if is_endless(limits) { ENDLESS_SEARCH.0 / ENDLESS_SEARCH.1 } else { (limits.high - limits.low) / CROSSING }
}

/// Checks the homing of an axis. `model` holds the limits of the motor from the model, and `home` is the home
/// position, rad.
pub(super) fn check(path: &Path, axis: &Axis, place: Place<'_>, period: Duration, model: Limits, home: f64) -> Checked {
    let homing = axis.homing;
    match place {
        Place::Bus(_) => {
            let because = "on a CAN bus: the drive's homing method decides";
            no_effect(path, "direction", homing.direction.is_some(), because)?;
            no_effect(path, "reverse_at_limit", homing.reverse_at_limit.is_some(), because)?;
            let least = START_PERIODS * period.as_secs_f64() * 1e3;
            let start = homing.start_timeout().as_secs_f64() * 1e3;
            within(path, "start_timeout_ms", start, Range::new(least, LONGEST_START, "ms, at least 10 periods"))?;
            check_method(path, axis, model, home)?;
        }
        Place::Serial(_) if homing.method.is_some() => {
            return refused(path, "method", "is a drive's: an axis on a serial line is homed by the host");
        }
        Place::Serial(_) => {
            let because = "on a serial line: the host searches";
            no_effect(path, "start_timeout_ms", homing.start_timeout_ms.is_some(), because)?;
        }
    }
    let most = axis.max_velocity;
    let of = "rad/s of the motor: from crossing the travel in 20 min to max_velocity";
    let search = Range::new(slowest(model), most, of);
    within(path, "search_velocity", homing.search_velocity, search)?;
    let zero = match place {
        Place::Bus(_) => search,
        Place::Serial(_) => {
            let of = "rad/s of the motor: from five turns in 5 min to max_velocity";
            Range::new((FARTHEST_INDEX / ZEROING).min(most), most, of)
        }
    };
    within(path, "zero_velocity", homing.zero_velocity, zero)?;
    let fastest = homing.search_velocity.max(homing.zero_velocity);
    let most = axis.max_acceleration;
    let of = "rad/s² of the motor: from reaching the search velocity in 10 s to max_acceleration";
    within(path, "acceleration", homing.acceleration, Range::new((fastest / RAMP).min(most), most, of))?;
    let Place::Serial(_) = place else {
        return Ok(());
    };
    let most = (2.0 * homing.acceleration * FARTHEST_INDEX).sqrt();
    let of = "rad/s of the motor: a search by the host brakes within five turns behind the switch";
    within(path, "search_velocity", homing.search_velocity, Range::new(0.0, most, of))
}

/// The reference of the method must be at the robot's home position, because a homed counter reads zero there.
fn check_method(path: &Path, axis: &Axis, model: Limits, home: f64) -> Checked {
    let Some(method) = axis.homing.method else {
        return refused(path, "method", "is missing: a drive homes by one of its methods");
    };
    if !METHODS.contains(&method) {
        let why = format!("is {method}, must be 37, 34, 33, 27, 23, 18, 17, 11, 7, 2, 1 or -1 to -4");
        return refused(path, "method", why);
    }
    let reversed = axis.drive.as_ref().is_some_and(|drive| drive.reversed);
    let negative = NEGATIVE_END.contains(&method);
    if !negative && !POSITIVE_END.contains(&method) {
        return Ok(());
    }
    let (end, distance) = if negative == reversed { ("upper", model.high - home) } else { ("lower", home - model.low) };
    if distance <= NEAR_END {
        return Ok(());
    }
    let by = if method > 0 { "limit switch" } else { "mechanical stop" };
    let why = format!(
        "is {method}, which takes the {by} at the {end} end of the travel for home, and the home of this axis is \
         {distance:.0} rad from there: use a method with a home switch (7, 11, 23, 27)"
    );
    refused(path, "method", why)
}
