//! Limits of the set-points sent.

use crate::{Braking, Knot, ServoAxisConfig, StopCause};

/// Fraction by which a finite difference of sent positions may exceed a limit.
///
/// Positions of some 10⁴ rad carry rounding errors of 10⁻¹² rad. Over the square of a period of 1 ms, such an error is
/// 10⁻⁵ rad/s². A thousandth of any real limit is far above this error and far below any effect in a drive.
pub(crate) const RELATIVE_TOLERANCE: f64 = 1e-3;

/// Distance beyond a position limit, rad, that counts as rounding.
///
/// Positions up to 10⁷ rad are rounded to 10⁻⁹ rad. A position at its limit has passed through a drive train and an
/// interpolation. The shortest count of a drive is above 10⁻⁷ rad.
const POSITION_TOLERANCE: f64 = 1e-8;

/// Fraction of a braking distance that counts as rounding.
const ROUNDING: f64 = 1e-6;

/// Checks whether `next` may follow `last` and `before_last`, in periods of `dt` seconds.
///
/// Speed and acceleration are the first and second difference of the positions sent, with a tolerance of a thousandth.
/// Positions have a tolerance of 10⁻⁸ rad. An axis beyond a position limit may move back towards the limit. A stop from
/// `next` with the greatest acceleration must end within the position limit, so that no stop overshoots it.
pub(crate) fn check(
    limits: &ServoAxisConfig,
    before_last: f64,
    last: f64,
    next: f64,
    dt: f64,
) -> Result<(), StopCause> {
    if !next.is_finite() {
        return Err(StopCause::NotFinite);
    }
    check_position(limits, last, next)?;
    let velocity = (next - last) / dt;
    if velocity.abs() > limits.max_velocity * (1.0 + RELATIVE_TOLERANCE) {
        return Err(StopCause::VelocityLimit { velocity, limit: limits.max_velocity });
    }
    let acceleration = (velocity - (last - before_last) / dt) / dt;
    if acceleration.abs() > limits.max_acceleration * (1.0 + RELATIVE_TOLERANCE) {
        return Err(StopCause::AccelerationLimit { acceleration, limit: limits.max_acceleration });
    }
    check_room(limits, Knot::new(next, velocity), dt)
}

/// The motor at `from` in a stop. An axis beyond a position limit has no room.
pub(crate) fn braking(limits: &ServoAxisConfig, from: Knot) -> Braking {
    let ahead =
        if from.velocity > 0.0 { limits.max_position - from.position } else { from.position - limits.min_position };
    Braking { from, max_acceleration: limits.max_acceleration, room: ahead }
}

fn check_room(limits: &ServoAxisConfig, from: Knot, dt: f64) -> Result<(), StopCause> {
    let braking = braking(limits, from);
    let way = braking.way(braking.least_periods(dt), dt);
    // An axis that moves back from beyond the other limit has more room than the whole range.
    if way > braking.room.max(0.0) + POSITION_TOLERANCE + way * ROUNDING {
        let upper = from.velocity > 0.0;
        let limit = if upper { limits.max_position } else { limits.min_position };
        return Err(StopCause::NoRoomToStop { rest: from.position + way.copysign(from.velocity), limit });
    }
    Ok(())
}

/// Checks whether a motor at `last` may go to `next`, rad: within the position limits, or back towards them.
pub(crate) fn check_position(limits: &ServoAxisConfig, last: f64, next: f64) -> Result<(), StopCause> {
    if next > limits.max_position + POSITION_TOLERANCE && next > last {
        return Err(StopCause::PositionLimit { position: next, limit: limits.max_position });
    }
    if next < limits.min_position - POSITION_TOLERANCE && next < last {
        return Err(StopCause::PositionLimit { position: next, limit: limits.min_position });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StraightStop;
    use proptest::prelude::*;

    const DT: f64 = 0.01;

    fn limits() -> ServoAxisConfig {
        ServoAxisConfig {
            min_position: -10.0,
            max_position: 10.0,
            max_velocity: 5.0,
            max_acceleration: 100.0,
            ..crate::scripted::config(1).effectors[0].axes[0]
        }
    }

    #[test]
    fn a_position_that_rounding_takes_beyond_its_limit_is_within() {
        // The limits of a motor that turns without end behind a gear of 50, and of a short ball screw.
        for limit in [3.35e6, 100.0] {
            let limits = ServoAxisConfig { min_position: -limit, max_position: limit, ..limits() };
            let beyond: f64 = limit + 4.0 * (limit * f64::EPSILON);
            assert!(beyond > limit);
            for (last, next) in [(limit - 1e-3, beyond), (1e-3 - limit, -beyond)] {
                let found = check(&limits, last, last, next, DT);
                assert_eq!(found, Ok(()), "{next}");
            }
            let found = check(&limits, limit - 1e-3, limit - 1e-3, limit + 1e-6, DT);
            assert!(found.is_err(), "{limit}");
        }
    }

    #[test]
    fn a_set_point_at_a_limit_with_its_tolerance_passes() {
        // Periods and positions without rounding.
        const DT: f64 = 0.5;
        let limits = ServoAxisConfig { min_position: -1e3, max_position: 1e3, ..limits() };
        let fastest = limits.max_velocity * (1.0 + RELATIVE_TOLERANCE);
        let hardest = limits.max_acceleration * (1.0 + RELATIVE_TOLERANCE);
        for sign in [1.0, -1.0] {
            let step = sign * fastest * DT;
            assert_eq!(check(&limits, -step, 0.0, step, DT), Ok(()));
            let fast = ServoAxisConfig { max_velocity: 1e3, ..limits };
            let step = sign * hardest * DT * DT;
            assert_eq!(check(&fast, 0.0, 0.0, step, DT), Ok(()));
            let harder = check(&fast, 0.0, 0.0, step * (1.0 + RELATIVE_TOLERANCE), DT);
            assert!(matches!(harder, Err(StopCause::AccelerationLimit { .. })), "{harder:?}");
            let beyond = sign * (limits.max_position + POSITION_TOLERANCE);
            assert_eq!(check_position(&limits, 0.0, beyond), Ok(()));
        }
    }

    #[test]
    fn a_long_stop_ends_at_a_limit_up_to_its_rounding() {
        let limits = ServoAxisConfig { max_acceleration: 0.0125, ..limits() };
        for sign in [1.0, -1.0] {
            let braking = braking(&limits, Knot::new(0.0, sign * 5.0));
            let way = braking.way(braking.least_periods(DT), DT);
            assert!(way > 999.0, "{way}");
            let room = |share: f64| check_room(&limits, Knot::new(sign * (10.0 - share * way), sign * 5.0), DT);
            assert_eq!(room(1.0 - ROUNDING / 2.0), Ok(()));
            assert!(matches!(room(1.0 - 2.0 * ROUNDING), Err(StopCause::NoRoomToStop { .. })));
        }
    }

    #[test]
    fn each_limit_is_named_with_both_sides() {
        type Case = (f64, f64, f64, Option<StopCause>);
        let beyond = |position, limit| Some(StopCause::PositionLimit { position, limit });
        let cases: [Case; 16] = [
            (0.0, 0.0, 0.0, None),
            (0.0, 0.0, 0.01, None),
            (9.98, 9.99, 10.0, None),
            (9.96, 9.98, 9.99, None),
            (9.96, 9.98, 10.0, Some(StopCause::NoRoomToStop { rest: 10.01, limit: 10.0 })),
            (-9.96, -9.98, -10.0, Some(StopCause::NoRoomToStop { rest: -10.01, limit: -10.0 })),
            (11.0, 10.98, 10.96, None),
            (9.98, 10.0, 10.02, beyond(10.02, 10.0)),
            (-9.98, -10.0, -10.02, beyond(-10.02, -10.0)),
            (11.0, 11.0, 11.0, None),
            (-11.0, -11.0, -11.0, None),
            (11.0, 11.0, 10.995, None),
            (11.0, 11.0, 11.005, beyond(11.005, 10.0)),
            (0.0, 0.05, 0.1, None),
            (0.0, 0.0, f64::NAN, Some(StopCause::NotFinite)),
            (0.0, 0.0, f64::NEG_INFINITY, Some(StopCause::NotFinite)),
        ];
        for (before_last, last, next, expected) in cases {
            let found = check(&limits(), before_last, last, next, DT).err();
            assert_eq!(found, expected, "{before_last} {last} {next}");
        }
        let too_fast = check(&limits(), 0.0, 0.05, 0.11, DT);
        assert!(matches!(too_fast, Err(StopCause::VelocityLimit { velocity, limit: 5.0 }) if velocity > 5.9));
        let too_hard = check(&limits(), 0.0, 0.0, 0.02, DT);
        assert!(matches!(too_hard, Err(StopCause::AccelerationLimit { acceleration, .. }) if acceleration > 199.0));
    }

    proptest! {
        #[test]
        fn what_passes_is_within_every_limit(
            last in -12.0..12.0f64, v in -8.0..8.0f64, dv in -3.0..3.0f64,
        ) {
            let before_last = last - v * DT;
            let next = last + (v + dv) * DT;
            if check(&limits(), before_last, last, next, DT).is_ok() {
                prop_assert!((v + dv).abs() <= 5.0 * 1.001 + 1e-9);
                prop_assert!(dv.abs() <= 1.0 * 1.001 + 1e-9);
                prop_assert!(next.abs() <= 10.0 || next.abs() <= last.abs());
                // A stop that begins there does not overshoot the limit.
                let mut stop = StraightStop::new([braking(&limits(), Knot::new(next, v + dv))], DT);
                while stop.advance() {}
                prop_assert!(stop.at(0).position.abs() <= 10.0_f64.max(next.abs()) + 1e-6);
            }
        }
    }
}
