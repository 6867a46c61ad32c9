//! The straight stop: all motors decelerate in proportion and come to rest at the same time.

use crate::{Knot, MAX_AXES};

/// A straight stop: all motors decelerate together and come to rest at the same time.
///
/// The stop starts from the set-points that were sent: the initial velocity is the last step over the period. From
/// there each step of a motor is shorter than the step before by the same amount, |v| / N. N is the number of periods
/// that the slowest motor needs at its greatest acceleration. All steps stay in proportion, so the motors stop along
/// the straight line of their motion. No motor brakes harder than its limit, the velocity has no jump at either end,
/// and the last set-point is exactly at rest. Motor *i* travels v·dt·(N − 1) / 2.
///
/// A motor that would travel beyond its position limit leaves the straight line: it brakes over fewer periods, at most as
/// hard as its greatest acceleration, and rests at its limit.
#[derive(Clone, Copy, Debug)]
pub struct StraightStop {
    from: [Knot; MAX_AXES],
    /// Greatest number of periods of each motor, by its room.
    most: [u32; MAX_AXES],
    /// Number of periods of the stop.
    periods: u32,
    /// Periods already commanded.
    done: u32,
    /// The period, s.
    dt: f64,
}

/// Upper limit of the number of periods of a stop. The limit is far above every real stop and prevents an overflow by
/// an absurd configuration.
const MOST_PERIODS: f64 = 1e9;

/// A motor at the beginning of a stop.
#[derive(Clone, Copy, Debug)]
pub struct Braking {
    /// The last position sent, and the step to it divided by the period.
    pub from: Knot,
    /// Greatest acceleration, rad/s².
    pub max_acceleration: f64,
    /// Distance to the position limit ahead, rad.
    pub room: f64,
}

impl Braking {
    /// Least number of periods of `dt` seconds until rest.
    pub(crate) fn least_periods(&self, dt: f64) -> u32 {
        // Rounding must not add a period to a stop of a whole number of periods.
        (self.from.velocity.abs() / self.max_acceleration / dt - 1e-9).ceil().clamp(0.0, MOST_PERIODS) as u32
    }

    /// Distance travelled over `periods`, rad.
    pub(crate) fn way(&self, periods: u32, dt: f64) -> f64 {
        self.from.velocity.abs() * dt * f64::from(periods.saturating_sub(1)) / 2.0
    }

    /// Greatest number of periods for which the room suffices, at least the least number.
    fn most_periods(&self, dt: f64) -> u32 {
        let most = 2.0 * self.room.max(0.0) / (self.from.velocity.abs() * dt) + 1.0 + 1e-9;
        // NaN, of a motor at rest without room, becomes 0.
        (most.floor().min(MOST_PERIODS) as u32).max(self.least_periods(dt))
    }
}

impl StraightStop {
    /// A stop of motors in periods of `dt` seconds.
    pub fn new(motors: impl IntoIterator<Item = Braking>, dt: f64) -> Self {
        let (mut from, mut most, mut periods) = ([Knot::default(); MAX_AXES], [u32::MAX; MAX_AXES], 0);
        for (axis, motor) in motors.into_iter().enumerate() {
            (from[axis], most[axis]) = (motor.from, motor.most_periods(dt));
            periods = periods.max(motor.least_periods(dt));
        }
        Self { from, most, periods, done: 0, dt }
    }

    /// Number of periods of the stop.
    pub fn periods(&self) -> u32 {
        self.periods
    }

    /// The same stop over at least this number of periods, if its first period is still to come. Stops of an equal number of
    /// periods stay in proportion: each is at the same share of its way and of its initial velocity.
    #[must_use]
    pub fn lasting(self, periods: u32) -> Self {
        let periods = if self.done == 0 { self.periods.max(periods) } else { self.periods };
        Self { periods, ..self }
    }

    /// Advances by one period; false if the stop has ended.
    pub fn advance(&mut self) -> bool {
        let under_way = self.done < self.periods;
        self.done += u32::from(under_way);
        under_way
    }

    /// Distance, rad, by which motor `axis` is ahead if it is `beyond` its set-point by this signed distance. A motor that
    /// began the stop at rest is ahead in both directions.
    pub(crate) fn ahead(&self, axis: usize, beyond: f64) -> f64 {
        let velocity = self.from[axis].velocity;
        if velocity == 0.0 { beyond.abs() } else { beyond * velocity.signum() }
    }

    /// Position at which motor `axis` comes to rest, rad.
    pub(crate) fn rest(&self, axis: usize) -> f64 {
        Self { done: self.periods, ..*self }.at(axis).position
    }

    /// Present set-point of motor `axis`.
    pub fn at(&self, axis: usize) -> Knot {
        let (from, periods) = (self.from[axis], self.periods.min(self.most[axis]));
        if periods == 0 {
            return Knot::at_rest(from.position);
        }
        // The sum of the steps 1 − i / N for i = 1 ..= done.
        let (done, periods) = (f64::from(self.done.min(periods)), f64::from(periods));
        let steps = done - done * (done + 1.0) / (2.0 * periods);
        Knot::new(from.position + from.velocity * self.dt * steps, from.velocity * (1.0 - done / periods))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limit::RELATIVE_TOLERANCE;
    use proptest::prelude::*;

    const DT: f64 = 0.001;

    proptest! {
        /// proptest prints the failing case and keeps its seed.
        #[test]
        fn a_straight_stop_is_straight_smooth_and_within_limits(
            motors in prop::collection::vec(
                (-500.0..500.0f64, -300.0..300.0f64, 50.0..5000.0f64), 1..=MAX_AXES),
        ) {
            let from: Vec<Knot> =
                motors.iter().map(|&(position, velocity, _)| Knot::new(position, velocity)).collect();
            let limits: Vec<f64> = motors.iter().map(|m| m.2).collect();
            let free = |(&from, &max_acceleration)| Braking { from, max_acceleration, room: f64::INFINITY };
            let mut stop = StraightStop::new(from.iter().zip(&limits).map(free), DT);
            let mut last = from.clone();
            // The positions sent before the stop: constant velocity.
            let mut step: Vec<f64> = from.iter().map(|k| k.velocity * DT).collect();
            let mut periods = 0;
            while stop.advance() {
                periods += 1;
                prop_assert!(periods <= 6_001, "never ends");
                let share = stop.at(0).velocity / from[0].velocity;
                for axis in 0..from.len() {
                    let knot = stop.at(axis);
                    let moved = knot.position - last[axis].position;
                    let acceleration = (moved - step[axis]) / (DT * DT);
                    let allowed = limits[axis] * (1.0 + RELATIVE_TOLERANCE);
                    prop_assert!(acceleration.abs() <= allowed, "axis {axis}: {acceleration}");
                    let change = (knot.velocity - last[axis].velocity).abs();
                    prop_assert!(change <= allowed * DT, "velocity jumps by {change}");
                    let expected = from[axis].velocity * share;
                    prop_assert!((knot.velocity - expected).abs() < 1e-6, "not straight");
                    (last[axis], step[axis]) = (knot, moved);
                }
            }
            for axis in 0..from.len() {
                prop_assert_eq!(stop.at(axis).velocity, 0.0);
                // Repeating the last set-point keeps the acceleration limit as well.
                let acceleration = step[axis].abs() / (DT * DT);
                prop_assert!(acceleration <= limits[axis] * (1.0 + RELATIVE_TOLERANCE));
            }
        }
    }

    #[test]
    fn a_motor_is_ahead_in_the_direction_of_its_stop_or_in_both_if_it_was_at_rest() {
        let braking =
            |velocity| Braking { from: Knot::new(0.0, velocity), max_acceleration: 10.0, room: f64::INFINITY };
        let stop = StraightStop::new([2.0, -2.0, 0.0].map(braking), DT);
        let ahead = |beyond| [0, 1, 2].map(|axis| stop.ahead(axis, beyond));
        assert_eq!((ahead(0.5), ahead(-0.5)), ([0.5, -0.5, 0.5], [-0.5, 0.5, 0.5]));
    }

    #[test]
    fn a_stop_at_rest_is_over_at_once() {
        let knot = Knot::at_rest(1.0);
        let mut stop = StraightStop::new([Braking { from: knot, max_acceleration: 10.0, room: 0.0 }], DT);
        assert!(!stop.advance());
        assert_eq!(stop.at(0), knot);
    }

    #[test]
    fn the_slowest_axis_sets_the_time_and_no_period_is_lost() {
        let from = [Knot::new(0.0, 1.0), Knot::new(0.0, -1.0)];
        let free = |(from, max_acceleration)| Braking { from, max_acceleration, room: f64::INFINITY };
        let mut stop = StraightStop::new(from.into_iter().zip([100.0, 50.0]).map(free), DT);
        let periods = std::iter::from_fn(|| stop.advance().then_some(())).count();
        assert_eq!(periods, 20);
        assert!((stop.at(1).position + 0.0095).abs() < 1e-12);
    }
    #[test]
    fn a_motor_near_its_limit_rests_before_it_while_the_others_brake_on() {
        // The first motor needs 20 periods, the second 5 of the 20, and has room for 8.
        let slow = Braking { from: Knot::new(0.0, 1.0), max_acceleration: 50.0, room: f64::INFINITY };
        let near = Braking { from: Knot::new(2.0, -1.0), max_acceleration: 200.0, room: 0.0035 };
        let mut stop = StraightStop::new([slow, near], DT).lasting(30);
        let (mut periods, mut last) = (0, Knot::new(2.0, -1.0));
        while stop.advance() {
            periods += 1;
            let next = stop.at(1);
            let acceleration = ((next.position - last.position) / DT - last.velocity) / DT;
            assert!(acceleration.abs() <= 200.0 * (1.0 + RELATIVE_TOLERANCE), "{acceleration}");
            assert!(next.position >= 2.0 - 0.0035 - 1e-12);
            last = Knot::new(next.position, (next.position - last.position) / DT);
        }
        assert_eq!((periods, stop.at(1)), (30, Knot::at_rest(2.0 - 0.0035)));
    }
}
