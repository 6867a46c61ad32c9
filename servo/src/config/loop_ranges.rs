//! Ranges of the gains and the feed-forward of a position loop that the servo closes.
//!
//! The ranges do not design a loop. The ranges exclude gains that are impossible in a sampled loop. The correction of
//! an error takes at least one period. One encoder count does not saturate the output. A position error of
//! `following_error` changes the output by at least a thousandth of its limit.

use std::{f64::consts::TAU, time::Duration};

use super::refusal::{KeyError, Range, conflict, no_effect, within};
use super::{FeedForward, Law};

/// Share of the greatest output that a limit of it may be at the least.
const LEAST_LIMIT: f64 = 1e-3;
/// Share of the limit that a position error as great as the following error puts out at the least.
const LEAST_OUTPUT: f64 = 1e-3;
/// The least position gain, 1/s: an error is gone after some minutes.
const LEAST_GAIN: f64 = 0.01;
/// Greatest rate of integration per period. One that cancels the pole of a motor may be as fast as the motor.
const INTEGRATED: f64 = 100.0;
/// Greatest coefficient of the incremental law.
const GREATEST: f64 = 1e6;

/// The axis that a loop is for, and what its drive can be sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopBounds {
    /// The servo period.
    pub period: Duration,
    /// Quadrature counts per motor revolution.
    pub counts_per_revolution: u32,
    /// Greatest motor velocity, rad/s.
    pub max_velocity: f64,
    /// Greatest motor acceleration, rad/s².
    pub max_acceleration: f64,
    /// Greatest distance between commanded and measured motor position, rad.
    pub following_error: f64,
    /// The most that the loop may put out.
    pub most: f64,
    /// Unit and origin of `most`, in the words of a message.
    pub of: &'static str,
    /// Greatest factor of the weight.
    pub weight: f64,
}

impl Law {
    /// Refuses what no sampled loop can be. Keys are those of a cell file below `law`.
    pub fn check(&self, bounds: &LoopBounds) -> Result<(), KeyError> {
        let limited = |key, limit| within(key, limit, Range::new(LEAST_LIMIT * bounds.most, bounds.most, bounds.of));
        let period = bounds.period.as_secs_f64();
        let count = TAU / f64::from(bounds.counts_per_revolution);
        let error = bounds.following_error;
        let rate = Range::new(0.0, INTEGRATED / period, "1/s; 100 per period at the most");
        let position_gain = Range::new(LEAST_GAIN, 1.0 / period, "1/s; one per period at the most");
        let fraction = Range::new(0.0, 1.0 - f64::EPSILON, "below 1");
        match *self {
            Self::Incremental(it) => {
                limited("incremental.limit", it.limit)?;
                within("incremental.a", it.a, fraction)?;
                within("incremental.b0", it.b0, Range::new(f64::MIN_POSITIVE, GREATEST, ""))?;
                within("incremental.b1", it.b1, Range::new(0.0, GREATEST, ""))?;
                within("incremental.eps", it.eps, fraction)?;
                no_effect("incremental.eps", !it.integral && it.eps != 0.0, "with integral = false")?;
                let of = "one count does not put out more than limit";
                let gain = Range::new(f64::MIN_POSITIVE, it.limit / it.b0, of);
                within("incremental.gain", it.gain, gain)
            }
            Self::Cascade(it) => {
                limited("cascade.limit", it.limit)?;
                within("cascade.position_gain", it.position_gain, position_gain)?;
                within("cascade.integral_rate", it.integral_rate, rate)?;
                let least = LEAST_OUTPUT * it.limit / (it.position_gain * error);
                let most = it.limit * period / count;
                let of = "output per rad/s; following_error puts out something, one count not all";
                let velocity_gain = Range::new(least.min(most), most, of);
                within("cascade.velocity_gain", it.velocity_gain, velocity_gain)
            }
            Self::Proportional(it) => {
                limited("proportional.limit", it.limit)?;
                let least = LEAST_OUTPUT * it.limit / error;
                let of = "1/s; following_error puts out something, and one per period at the most";
                let least = least.clamp(LEAST_GAIN, position_gain.high);
                let gain = Range::new(least, position_gain.high, of);
                within("proportional.position_gain", it.position_gain, gain)?;
                within("proportional.integral_rate", it.integral_rate, rate)
            }
        }
    }
}

impl FeedForward {
    /// Refuses what would exceed the `limit` of the law. Keys are those of a cell file below `feed_forward`.
    pub fn check(&self, limit: f64, bounds: &LoopBounds) -> Result<(), KeyError> {
        let up_to = |most: f64, of| Range::new(0.0, most, of);
        let velocity = up_to(limit / bounds.max_velocity, "limit / max_velocity at the most");
        within("velocity", self.velocity, velocity)?;
        let acceleration = up_to(limit / bounds.max_acceleration, "limit / max_acceleration at the most");
        within("acceleration", self.acceleration, acceleration)?;
        within("coulomb", self.coulomb, up_to(limit, "limit at the most"))?;
        within("weight", self.weight.unwrap_or(0.0), up_to(bounds.weight, "output per N·m"))?;
        let constant = Range::new(-limit, limit, "limit at the most, either way");
        within("constant", self.constant, constant)?;
        match (self.stiction, self.stribeck_velocity) {
            (None, None) => Ok(()),
            (None, Some(_)) => {
                conflict("stribeck_velocity", "is for a friction that is greater at break-away: stiction")
            }
            (Some(stiction), falls) => {
                let of = "coulomb at the least, limit at the most";
                within("stiction", stiction, Range::new(self.coulomb, limit, of))?;
                let Some(velocity) = falls else {
                    return conflict("stiction", "needs the velocity over which it falls: stribeck_velocity");
                };
                within("stribeck_velocity", velocity, Range::new(1e-3, 1e5, "rad/s of the motor"))
            }
        }
    }
}
