//! Motion time: the time by which all macrosteps of a cell advance. A speed override slows down the motion time.
//!
//! All effectors take their set-points at the same motion time. An override therefore changes neither the path of an
//! effector nor the synchronisation of effectors. An override acts from the next cycle on all macrosteps, including
//! queued macrosteps. Homing and stops do not depend on motion time.
//!
//! The rate is the advance of motion time per real time, without unit: 1 without an override, 0 in a pause.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use thiserror::Error;

use crate::{Knot, ServoAxisConfig};

/// Greatest fraction of an axis's acceleration limit for the sum of the planned acceleration and the acceleration by a
/// change of the rate.
const ROOM: f64 = 0.9;

/// Assumed greatest planned acceleration, as a fraction of an axis's acceleration limit. The bounds of the jerk hold
/// for plans within this fraction.
const PLANNED: f64 = 0.5;

/// Fractions of an axis's planned jerk that the two terms of a change of the rate may add: 3·a·r·g and v·h in
/// `Bounds::of_axis`.
const JERK: [f64; 2] = [0.6, 0.4];

/// Horizon of the bounds, s: about the usual duration of a change of the rate.
const AHEAD: f64 = 0.5;

/// Greatest change of the rate, 1/s, independent of the axes.
const BRISK: f64 = 10.0;

/// Greatest second derivative of the rate, 1/s², independent of the axes.
const BRISK_GROWTH: f64 = 200.0;

/// Fraction of the bound of the second derivative with which a change of the rate is planned. The rest is a reserve,
/// because the bounds may become tighter during the change.
const PLANNED_GROWTH: f64 = 0.8;

/// Distance from the requested rate that counts as reached.
const REACHED: f64 = 1e-9;

/// Speed of all macrosteps of a cell, as a fraction of the programmed speed. Any thread may set it. Homing and stops are
/// not affected.
///
/// The rate of motion time follows the request within the acceleration limits of all axes. The change adds at most the
/// planned jerk of each axis, if planned accelerations are at most half of the limit
/// ([`ServoAxisConfig::planned_jerk`]).
#[derive(Clone, Debug, Default)]
pub struct SpeedOverride(Arc<Requested>);

#[derive(Debug)]
struct Requested {
    /// Bits of the fraction.
    fraction: AtomicU64,
    paused: AtomicBool,
}

impl Default for Requested {
    fn default() -> Self {
        Self { fraction: AtomicU64::new(1f64.to_bits()), paused: AtomicBool::new(false) }
    }
}

/// A fraction that is not a number from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("the speed override is a fraction from 0 to 1, not {0}")]
pub struct OverrideError(pub f64);

impl SpeedOverride {
    /// Requests this fraction of the programmed speed, 0 to 1. A pause stays in effect.
    pub fn set(&self, fraction: f64) -> Result<(), OverrideError> {
        if !(0.0..=1.0).contains(&fraction) {
            return Err(OverrideError(fraction));
        }
        self.0.fraction.store(fraction.to_bits(), Ordering::Relaxed);
        Ok(())
    }

    /// The fraction last set.
    pub fn fraction(&self) -> f64 {
        f64::from_bits(self.0.fraction.load(Ordering::Relaxed))
    }

    /// Requests that all programmed motions stop on their paths. The drives remain on. A robot that homes continues.
    pub fn pause(&self) {
        self.0.paused.store(true, Ordering::Relaxed);
    }

    /// Continues at the fraction last set.
    pub fn resume(&self) {
        self.0.paused.store(false, Ordering::Relaxed);
    }

    /// Whether a pause is requested.
    pub fn is_paused(&self) -> bool {
        self.0.paused.load(Ordering::Relaxed)
    }

    fn target(&self) -> f64 {
        if self.is_paused() { 0.0 } else { self.fraction() }
    }
}

/// Bounds of the derivatives of the rate of motion time in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    /// Least change of the rate by acceleration limits, 1/s, at most zero.
    least: f64,
    /// Greatest change of the rate by acceleration limits, 1/s, at least zero.
    most: f64,
    /// Greatest change of the rate, 1/s, by the jerk and by the velocities within the horizon.
    change: f64,
    /// Greatest second derivative of the rate, 1/s².
    growth: f64,
}

impl Bounds {
    /// The bounds without an axis.
    pub(crate) const NONE: Self = Self { least: -BRISK, most: BRISK, change: BRISK, growth: BRISK_GROWTH };

    /// The bounds by an axis at the set-point `knot` of motion time.
    ///
    /// v, a and j are the planned velocity, acceleration and jerk with respect to motion time. g and h are the first
    /// and second derivatives of the rate r. The axis has the jerk j·r³ + 3·a·r·g + v·h and the acceleration a·r² +
    /// v·g. `least` and `most` depend on the present v and a, and may become tight within a cycle. `change` and
    /// `growth` hold for all velocities that the axis can reach within the horizon, so g can follow them gradually.
    pub(crate) fn of_axis(knot: Knot, rate: f64, limits: &ServoAxisConfig) -> Self {
        let ServoAxisConfig { max_velocity, max_acceleration, planned_jerk, .. } = *limits;
        let speed = knot.velocity.abs();
        let planned = knot.acceleration * rate * rate * knot.velocity.signum();
        let change = |room: f64| if room < BRISK * speed { (room / speed).max(0.0) } else { BRISK };
        let foreseen = max_velocity.min(speed + PLANNED * max_acceleration * AHEAD);
        let [by_acceleration, by_velocity] = JERK;
        Self {
            least: -change(ROOM * max_acceleration + planned),
            most: change(ROOM * max_acceleration - planned),
            change: ((ROOM - PLANNED) * max_acceleration / foreseen)
                .min(by_acceleration * planned_jerk / (3.0 * PLANNED * max_acceleration)),
            growth: by_velocity * planned_jerk / foreseen,
        }
    }

    pub(crate) fn within(self, other: Self) -> Self {
        Self {
            least: self.least.max(other.least),
            most: self.most.min(other.most),
            change: self.change.min(other.change),
            growth: self.growth.min(other.growth),
        }
    }
}

/// Advance of the motion time in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    /// Advance in periods, 0 to 1.
    pub(crate) periods: f64,
    /// Rate at the end of the advance, 0 to 1.
    pub(crate) rate: f64,
    /// Change of the rate, 1/s.
    pub(crate) change: f64,
}

impl Motion {
    /// Greatest advance of the next cycle, in periods. `dt` is the duration of a cycle, s.
    pub(crate) fn most_next(&self, dt: f64) -> f64 {
        (self.rate + 0.5 * BRISK * dt).min(1.0)
    }

    /// The set-point at the present rate, from the set-point in motion time.
    pub(crate) fn slow(&self, knot: Knot) -> Knot {
        Knot {
            position: knot.position,
            velocity: knot.velocity * self.rate,
            acceleration: knot.acceleration * self.rate * self.rate + knot.velocity * self.change,
        }
    }
}

/// The rate of motion time, which follows a [`SpeedOverride`].
///
/// The programmed speed is multiplied by the fractions of two overrides. Either can pause the motion.
#[derive(Debug)]
pub(crate) struct MotionTime {
    pub(crate) requested: SpeedOverride,
    /// The override of the operator.
    pub(crate) operator: SpeedOverride,
    rate: f64,
    change: f64,
}

impl MotionTime {
    pub(crate) fn new() -> Self {
        let [requested, operator] = [SpeedOverride::default(), SpeedOverride::default()];
        Self { requested, operator, rate: 1.0, change: 0.0 }
    }

    /// The requested rate.
    pub(crate) fn target(&self) -> f64 {
        self.requested.target() * self.operator.target()
    }

    /// Advances by a cycle of `dt` seconds towards the rate `target`. `bounds` gives the bounds at the present rate.
    pub(crate) fn advance(&mut self, target: f64, dt: f64, bounds: impl FnOnce(f64) -> Bounds) -> Motion {
        let last = self.rate;
        if target != self.rate || self.change != 0.0 {
            self.follow(target, bounds(self.rate), dt);
        }
        Motion { periods: 0.5 * (last + self.rate), rate: self.rate, change: self.change }
    }

    /// The advance of a cycle in which an effector repeats its set-points. The rate does not change.
    pub(crate) fn hold(&self) -> Motion {
        Motion { periods: self.rate, rate: self.rate, change: 0.0 }
    }

    /// Moves the rate towards `target`. The change of the rate varies by at most `growth` per second, unless an
    /// acceleration limit requires more.
    fn follow(&mut self, target: f64, bounds: Bounds, dt: f64) {
        // Distance to the target after this cycle, if the change of the rate decreased to zero within the cycle.
        let left = target - self.rate - 0.5 * self.change * dt;
        // If the change c decreases by `fading` in each cycle, the rate moves by about c² dt / (2 fading). In the last
        // two cycles the rate reaches the target exactly, without overshoot.
        let fading = PLANNED_GROWTH * bounds.growth * dt;
        let share = left.abs() / (fading * dt);
        let wanted = fading * if share < 0.5 { share } else { 0.5 * ((8.0 * share).sqrt() - 1.0) };
        let wanted = wanted.min(bounds.change).copysign(left);
        let most = bounds.growth * dt;
        let change = (self.change + (wanted - self.change).clamp(-most, most)).clamp(bounds.least, bounds.most);
        let rate = (self.rate + 0.5 * (self.change + change) * dt).clamp(0.0, 1.0);
        if (target - rate).abs() < REACHED && change.abs() <= most {
            (self.rate, self.change) = (target, 0.0);
        } else {
            (self.rate, self.change) = (rate, if rate == 0.0 || rate == 1.0 { 0.0 } else { change });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT: f64 = 0.002;

    fn limits(max_velocity: f64, max_acceleration: f64, planned_jerk: f64) -> ServoAxisConfig {
        let axis = crate::scripted::config(1).effectors[0].axes[0];
        ServoAxisConfig { max_velocity, max_acceleration, planned_jerk, ..axis }
    }

    #[test]
    fn a_fraction_outside_0_to_1_is_refused_and_changes_nothing() {
        let speed = SpeedOverride::default();
        speed.set(0.25).unwrap();
        for wrong in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
            let error = speed.set(wrong).unwrap_err();
            assert!(error.to_string().contains("from 0 to 1"), "{error}");
        }
        assert_eq!((speed.fraction(), speed.target()), (0.25, 0.25));
        speed.pause();
        assert_eq!(speed.target(), 0.0);
        speed.resume();
        assert_eq!(speed.target(), 0.25);
    }

    #[test]
    fn without_an_override_each_cycle_is_exactly_one_period() {
        let mut time = MotionTime::new();
        for _ in 0..1000 {
            let motion = time.advance(time.target(), DT, |_| unreachable!("the rate does not change"));
            assert_eq!(motion, Motion { periods: 1.0, rate: 1.0, change: 0.0 });
        }
    }

    proptest! {
        /// A motor oscillates with up to half of its acceleration limit while the override changes at random.
        #[test]
        fn acceleration_and_jerk_keep_their_limits(
            steps in prop::collection::vec((0.0..=1.0f64, 1..400u32), 1..8),
            frequency in 0.2..3.0f64, share in 0.05..0.5f64, limit in 10.0..1000.0f64,
        ) {
            let omega = std::f64::consts::TAU * frequency;
            let amplitude = share * limit / (omega * omega);
            let limits = limits(amplitude * omega, limit, omega.max(5.0) * share * limit);
            let at = |t: f64| Knot {
                position: amplitude * (omega * t).sin(),
                velocity: amplitude * omega * (omega * t).cos(),
                acceleration: -amplitude * omega * omega * (omega * t).sin(),
            };
            let mut time = MotionTime::new();
            let mut t = 0.0;
            let mut last: [f64; 3] = std::array::from_fn(|before| at((before as f64 - 2.0) * DT).position);
            for (fraction, cycles) in steps {
                time.requested.set(fraction).unwrap();
                for _ in 0..cycles + 500 {
                    let motion = time.advance(time.target(), DT, |rate| Bounds::of_axis(at(t), rate, &limits));
                    t += motion.periods * DT;
                    let [a, b, c] = last;
                    let d = at(t).position;
                    let acceleration = (d - 2.0 * c + b) / DT.powi(2);
                    let jerk = (d - 3.0 * c + 3.0 * b - a) / DT.powi(3);
                    prop_assert!(acceleration.abs() <= limit * 1.001, "{acceleration} of {limit} rad/s²");
                    prop_assert!(jerk.abs() <= 2.0 * limits.planned_jerk, "{jerk} of {} rad/s³", limits.planned_jerk);
                    last = [b, c, d];
                }
            }
        }
    }

    #[test]
    fn a_pause_at_full_speed_takes_as_long_as_the_limits_permit_and_ends_at_rest() {
        // The acceleration limit permits a change of 1.2 1/s, and the jerk limit permits this change after 0.1 s.
        let mut time = MotionTime::new();
        time.requested.pause();
        let limits = limits(100.0, 300.0, 3000.0);
        let bounds = |rate| Bounds::of_axis(Knot::new(0.0, 100.0), rate, &limits);
        let cycles = (1..).find(|_| time.advance(time.target(), DT, bounds).rate == 0.0).unwrap();
        let seconds = f64::from(cycles) * DT;
        assert!((0.83..1.0).contains(&seconds), "{seconds}");
        assert_eq!(time.advance(time.target(), DT, bounds), Motion { periods: 0.0, rate: 0.0, change: 0.0 });
        time.requested.resume();
        assert!((1..1000).any(|_| time.advance(time.target(), DT, bounds).rate == 1.0));
    }
}
