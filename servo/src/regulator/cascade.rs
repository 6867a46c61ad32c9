//! Cascade: proportional position loop over proportional-integral velocity loop.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::proportional::{Proportional, ProportionalConfig};
use super::{is_not_negative, is_positive};

/// Gains of `velocity_gain (1 + integral_rate / s) (position_gain + s)`, which acts on the position error in rad.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Cascade")]
pub struct CascadeConfig {
    /// Velocity asked for per position error, 1/s.
    pub position_gain: f64,
    /// Output per velocity error, 1/(rad/s).
    pub velocity_gain: f64,
    /// How fast the velocity error is integrated, 1/s; zero for not at all.
    pub integral_rate: f64,
    /// The most that is put out either way.
    pub limit: f64,
}

impl CascadeConfig {
    /// The first field that makes no sense.
    pub(crate) fn nonsense(&self) -> Option<&'static str> {
        if !is_positive(self.position_gain) {
            Some("position_gain of its loop")
        } else if !is_positive(self.velocity_gain) {
            Some("velocity_gain of its loop")
        } else if !is_not_negative(self.integral_rate) {
            Some("integral_rate of its loop")
        } else if !is_positive(self.limit) {
            Some("limit of its loop")
        } else {
            None
        }
    }
}

/// A proportional position loop over a proportional-integral velocity loop.
///
/// ```text
/// C = velocity_gain (1 + integral_rate / s) (position_gain + s)
/// ```
///
/// At its limit the integral may come down but not wind up, and by itself it never exceeds the limit.
#[derive(Clone, Debug)]
pub struct Cascade {
    position_gain: f64,
    /// The same law, of the velocity error: it puts out N·m or duty.
    velocity_loop: Proportional,
}

impl Cascade {
    /// At rest: no output.
    pub fn new(config: CascadeConfig) -> Self {
        Self {
            position_gain: config.position_gain,
            velocity_loop: Proportional::new(ProportionalConfig {
                position_gain: config.velocity_gain,
                integral_rate: config.integral_rate,
                limit: config.limit,
            }),
        }
    }

    /// One period of `dt` seconds: position error, rad, and velocity error, rad/s, give the output for
    /// the next, to which `feed_forward` is added before it is limited. A `dt` of zero integrates nothing.
    ///
    /// An input that is not finite resets the law, and the output is zero.
    pub fn step(&mut self, error: f64, velocity_error: f64, feed_forward: f64, dt: f64) -> f64 {
        let error = velocity_error + self.position_gain * error;
        self.velocity_loop.step(error, feed_forward, dt)
    }

    /// Bumpless transfer: removes at most `output` from the integral part at rest and returns the amount removed. The next
    /// output is lower by that amount.
    pub fn give(&mut self, output: f64) -> f64 {
        self.velocity_loop.give(output)
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.velocity_loop.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: CascadeConfig = CascadeConfig {
        position_gain: 40.0,
        velocity_gain: 0.02,
        integral_rate: 50.0,
        limit: 2.0,
    };
    const DT: f64 = 0.002;

    #[test]
    fn errors_act_by_their_gains_and_are_integrated() {
        let mut cascade = Cascade::new(CONFIG);
        assert_eq!(cascade.step(0.1, 0.0, 0.25, DT), 0.08 + 0.25);
        // 0.08 · 50 / s · 2 ms.
        let output = cascade.step(0.0, 2.0, 0.0, DT);
        assert!((output - 0.048).abs() < 1e-12, "{output}");
        let output = cascade.step(0.0, 0.0, 0.0, 0.0);
        assert!((output - 0.012).abs() < 1e-12, "{output}");
    }

    #[test]
    fn output_stays_within_its_limit_and_leaves_it_at_once() {
        for sign in [1.0, -1.0] {
            let mut cascade = Cascade::new(CONFIG);
            for _ in 0..10_000 {
                let output = cascade.step(sign * 10.0, 0.0, 0.0, DT) * sign;
                assert!((0.0..=2.0).contains(&output), "{output}");
            }
            let output = cascade.step(-sign, 0.0, 0.0, DT) * sign;
            assert!(output < 0.0, "wound up: {output}");
        }
    }

    #[test]
    fn feed_forward_at_the_limit_does_not_wind_the_integral_up() {
        let mut cascade = Cascade::new(CONFIG);
        for _ in 0..1000 {
            assert_eq!(cascade.step(0.1, 0.0, 5.0, DT), 2.0);
        }
        assert_eq!(cascade.step(0.0, 0.0, 0.0, DT), 0.0);
    }

    #[test]
    fn what_is_not_a_number_gives_no_output_and_is_forgotten() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for at in 0..3 {
                let mut cascade = Cascade::new(CONFIG);
                cascade.step(0.1, 0.1, 0.0, DT);
                let mut inputs = [0.1, 0.1, 0.0];
                inputs[at] = bad;
                assert_eq!(cascade.step(inputs[0], inputs[1], inputs[2], DT), 0.0);
                assert_eq!(cascade.step(0.0, 0.0, 0.0, DT), 0.0, "as new");
            }
        }
    }
}
