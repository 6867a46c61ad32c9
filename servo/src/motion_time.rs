//! Motion time: the time by which all macrosteps of a cell advance. A speed override slows it.
//!
//! Every effector takes its set-points at the same motion time. An override therefore changes neither the path of an
//! effector nor the relation between effectors. It acts in the next cycle on all macrosteps, also on those that wait in
//! a queue. Homing and stops do not depend on motion time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use thiserror::Error;

use crate::Knot;

/// Fraction of an axis's acceleration limit that a change of the rate may use, together with the planned acceleration.
/// The rest covers the change of the acceleration within a period.
const ROOM: f64 = 0.9;

/// Greatest change of the rate, 1/s: a pause takes at least a tenth of a second.
const BRISK: f64 = 10.0;

/// Time in which the change of the rate grows from zero to its bound, s. The acceleration then has no jump.
const RAMP: f64 = 0.05;

/// Distance from the requested rate that counts as reached.
const REACHED: f64 = 1e-5;

/// Speed of all macrosteps of a cell, as a fraction of the programmed speed. Any thread may set it. Homing and stops are
/// not affected.
///
/// The rate of motion time follows the request within the acceleration limits of all axes that move.
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

    /// Slows all macrosteps along their paths to a stand. The drives stay on. A robot that homes continues.
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

/// Bounds of the change of the rate, 1/s: `least` is negative or zero, `most` positive or zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    least: f64,
    most: f64,
}

impl Bounds {
    pub(crate) const NONE: Self = Self { least: -BRISK, most: BRISK };

    /// The bounds by an axis at the set-point `knot` of motion time, with this acceleration limit, rad/s². At the rate r
    /// and its change g, the acceleration of the axis is a·r² + v·g.
    pub(crate) fn of_axis(knot: Knot, rate: f64, limit: f64) -> Self {
        let speed = knot.velocity.abs();
        let planned = knot.acceleration * rate * rate * knot.velocity.signum();
        let change = |room: f64| if room < BRISK * speed { (room / speed).max(0.0) } else { BRISK };
        Self { least: -change(ROOM * limit + planned), most: change(ROOM * limit - planned) }
    }

    pub(crate) fn within(self, other: Self) -> Self {
        Self { least: self.least.max(other.least), most: self.most.min(other.most) }
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
    /// Greatest advance of the next cycle of `dt` seconds, in periods.
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

    /// Advances by a cycle of `dt` seconds. `bounds` gives the bounds at the present rate.
    pub(crate) fn advance(&mut self, dt: f64, bounds: impl FnOnce(f64) -> Bounds) -> Motion {
        let target = self.requested.target() * self.operator.target();
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

    /// Moves the rate towards `target`. The change of the rate grows at most by its bound per [`RAMP`], and fades
    /// before the target is reached.
    fn follow(&mut self, target: f64, bounds: Bounds, dt: f64) {
        let distance = target - self.rate;
        let bound = if distance < 0.0 { -bounds.least } else { bounds.most };
        // Change of the change of the rate, 1/s². The plan uses a part of it, and the rest is for deviations.
        let growth = bound / RAMP;
        let planned = 0.7 * growth;
        // Close to the target, the distance fades exponentially; further away, the change fades at a constant rate.
        let fading = (2.0 / RAMP).min(0.5 / dt);
        let near = planned / (fading * fading);
        let speed = if distance.abs() <= near {
            fading * distance.abs()
        } else {
            (2.0 * planned * (distance.abs() - 0.5 * near)).sqrt()
        };
        let wanted = speed.min(bound).copysign(distance);
        let step = wanted - self.change;
        let most = if step * self.change < 0.0 { 2.0 * growth.max(self.change.abs() / RAMP) } else { growth };
        let change = self.change + step.clamp(-most * dt, most * dt);
        let change = change.clamp(bounds.least, bounds.most);
        let rate = (self.rate + 0.5 * (self.change + change) * dt).clamp(0.0, 1.0);
        let left = target - rate;
        if left.abs() < REACHED && change.abs() < 2.0 * fading * REACHED {
            (self.rate, self.change) = (target, 0.0);
        } else {
            // A target that moved may be passed by a little: a change of the rate never ends at once.
            (self.rate, self.change) = (rate, if rate == 0.0 || rate == 1.0 { 0.0 } else { change });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT: f64 = 0.002;

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
            let motion = time.advance(DT, |_| unreachable!("the rate does not change"));
            assert_eq!(motion, Motion { periods: 1.0, rate: 1.0, change: 0.0 });
        }
    }

    proptest! {
        /// A motor swings at up to 60 % of its acceleration limit while the override changes at random.
        #[test]
        fn the_acceleration_keeps_its_limit_and_never_jumps(
            steps in prop::collection::vec((0.0..=1.0f64, 1..400u32), 1..8),
            frequency in 0.2..3.0f64, share in 0.05..0.6f64, limit in 10.0..1000.0f64,
        ) {
            let omega = std::f64::consts::TAU * frequency;
            let amplitude = share * limit / (omega * omega);
            let at = |t: f64| Knot {
                position: amplitude * (omega * t).sin(),
                velocity: amplitude * omega * (omega * t).cos(),
                acceleration: -amplitude * omega * omega * (omega * t).sin(),
            };
            let mut time = MotionTime::new();
            let (mut t, mut last, mut before_last) = (0.0, at(0.0).position, at(-DT).position);
            let mut acceleration: Option<f64> = None;
            for (fraction, cycles) in steps {
                time.requested.set(fraction).unwrap();
                for _ in 0..cycles + 500 {
                    let motion = time.advance(DT, |rate| Bounds::of_axis(at(t), rate, limit));
                    t += motion.periods * DT;
                    let here = at(t).position;
                    let found = (here - 2.0 * last + before_last) / (DT * DT);
                    prop_assert!(found.abs() <= limit * 1.001, "{found} of {limit}");
                    if let Some(acceleration) = acceleration {
                        prop_assert!((found - acceleration).abs() <= 0.25 * limit, "jump {}", found - acceleration);
                    }
                    acceleration = Some(found);
                    (before_last, last) = (last, here);
                }
            }
        }
    }

    #[test]
    fn a_pause_at_full_speed_takes_as_long_as_the_limit_permits_and_ends_at_rest() {
        // 100 rad/s at 300 rad/s²: a third of a second, and the ramps.
        let mut time = MotionTime::new();
        time.requested.pause();
        let bounds = |rate| Bounds::of_axis(Knot::new(0.0, 100.0), rate, 300.0);
        let cycles = (1..).find(|_| time.advance(DT, bounds).rate == 0.0).unwrap();
        let seconds = f64::from(cycles) * DT;
        assert!((0.37..0.8).contains(&seconds), "{seconds}");
        assert_eq!(time.advance(DT, bounds), Motion { periods: 0.0, rate: 0.0, change: 0.0 });
        time.requested.resume();
        assert!((1..1000).any(|_| time.advance(DT, bounds).rate == 1.0));
    }
}
