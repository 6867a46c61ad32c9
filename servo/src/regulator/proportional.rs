//! Proportional position loop, and the cascade of such a loop over a velocity loop.

use serde::{Deserialize, Serialize};

use super::share;
use crate::config::refusal::{first_wrong, is_not_negative, is_positive};

/// Gains of `position_gain (1 + integral_rate / s)`, which acts on the position error in rad.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "schema", schemars(rename = "Proportional"))]
pub struct ProportionalConfig {
    /// Velocity per position error, 1/s: about the crossover, rad/s. Some fifth of what the drive's velocity loop
    /// passes, and less than 0.1 per delay from sample to effect (two and a half periods on CAN). The loop is stable with
    /// twice this gain.
    pub position_gain: f64,
    /// How fast the position error is integrated, 1/s; zero for not at all.
    #[serde(default)]
    pub integral_rate: f64,
    /// The most that is put out either way, rad/s.
    pub limit: f64,
}

impl ProportionalConfig {
    /// The first field that makes no sense.
    pub(crate) fn nonsense(&self) -> Option<&'static str> {
        first_wrong([
            (is_positive(self.position_gain), "position_gain of its loop"),
            (is_not_negative(self.integral_rate), "integral_rate of its loop"),
            (is_positive(self.limit), "limit of its loop"),
        ])
    }
}

/// Gains of `velocity_gain (1 + integral_rate / s) (position_gain + s)`, which acts on the position error in rad.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "schema", schemars(rename = "Cascade"))]
pub struct CascadeConfig {
    /// Velocity asked for per position error, 1/s.
    pub position_gain: f64,
    /// Output per velocity error, 1/(rad/s). The loop is stable with twice and with half this gain, for a motor whose
    /// inertia and damping are those of `feed_forward`.
    pub velocity_gain: f64,
    /// How fast the velocity error is integrated, 1/s; zero for not at all.
    pub integral_rate: f64,
    /// The most that is put out either way.
    pub limit: f64,
}

impl CascadeConfig {
    /// The first field that makes no sense.
    pub(crate) fn nonsense(&self) -> Option<&'static str> {
        first_wrong([
            (is_positive(self.position_gain), "position_gain of its loop"),
            (is_positive(self.velocity_gain), "velocity_gain of its loop"),
        ])
        .or_else(|| self.velocity_loop().nonsense())
    }

    /// The law of the velocity loop below the proportional position loop. It acts on the velocity error in rad/s.
    pub(crate) fn velocity_loop(&self) -> ProportionalConfig {
        ProportionalConfig { position_gain: self.velocity_gain, integral_rate: self.integral_rate, limit: self.limit }
    }
}

/// A proportional-integral position loop over a velocity loop that the drive closes.
///
/// ```text
/// C = position_gain (1 + integral_rate / s)
/// ```
///
/// With [`FeedForward::velocity`](crate::FeedForward::velocity) of 1 the commanded velocity needs no error.
/// At its limit the integral may come down but not wind up, and by itself it never exceeds the limit.
///
/// The velocity loop of a cascade is the same law of the velocity error, rad/s. Its output is N·m or a duty.
#[derive(Clone, Debug)]
pub struct Proportional {
    config: ProportionalConfig,
    integral: f64,
}

impl Proportional {
    /// At rest: no output.
    pub fn new(config: ProportionalConfig) -> Self {
        Self { config, integral: 0.0 }
    }

    /// One period of `dt` seconds: the position error, rad, gives the velocity for the next, rad/s, to which
    /// `feed_forward` is added before it is limited. A `dt` of zero integrates nothing.
    ///
    /// An input that is not finite resets the law, and the output is zero.
    pub fn step(&mut self, error: f64, feed_forward: f64, dt: f64) -> f64 {
        let ProportionalConfig { position_gain, integral_rate, limit } = self.config;
        let proportional = position_gain * error;
        let output = proportional + self.integral + feed_forward;
        if !output.is_finite() {
            self.reset();
            return 0.0;
        }
        if output.abs() <= limit || proportional * output < 0.0 {
            let integral = self.integral + proportional * integral_rate * dt;
            self.integral = integral.clamp(-limit, limit);
        }
        output.clamp(-limit, limit)
    }

    /// Bumpless transfer: removes at most `output` from the integral part at rest and returns the amount removed. The next
    /// output is lower by that amount.
    pub fn give(&mut self, output: f64) -> f64 {
        let given = share(self.integral, output);
        self.integral -= given;
        given
    }

    /// The integral part of the output.
    pub fn integral(&self) -> f64 {
        self.integral
    }

    /// Resets the law, and presets its integral part to `output`, clamped to the limit.
    pub fn restart(&mut self, output: f64) {
        let limit = self.config.limit;
        self.integral = if output.is_finite() { output.clamp(-limit, limit) } else { 0.0 };
    }

    /// Resets the law to its state at rest with zero output.
    pub fn reset(&mut self) {
        self.restart(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.002;

    fn law() -> Proportional {
        Proportional::new(ProportionalConfig { position_gain: 50.0, integral_rate: 5.0, limit: 250.0 })
    }

    #[test]
    fn an_error_acts_by_its_gain_and_is_integrated() {
        let mut law = law();
        assert_eq!(law.step(0.1, 20.0, DT), 25.0);
        // 5 rad/s · 5 / s · 2 ms.
        assert!((law.step(0.0, 0.0, DT) - 0.05).abs() < 1e-12);
        assert!((law.step(0.0, 0.0, 0.0) - 0.05).abs() < 1e-12);
    }

    #[test]
    fn output_stays_within_its_limit_and_leaves_it_at_once() {
        for sign in [1.0, -1.0] {
            let mut law = law();
            for _ in 0..10_000 {
                assert_eq!(law.step(sign * 10.0, 0.0, DT) * sign, 250.0);
            }
            let output = law.step(-0.01 * sign, 0.0, DT) * sign;
            assert!(output < 0.0, "wound up: {output}");
        }
    }

    #[test]
    fn feed_forward_at_the_limit_does_not_wind_the_integral_up() {
        let mut law = law();
        for _ in 0..1000 {
            assert_eq!(law.step(0.1, 500.0, DT), 250.0);
        }
        assert_eq!(law.step(0.0, 0.0, DT), 0.0);
    }

    #[test]
    fn what_is_not_a_number_gives_no_output_and_is_forgotten() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for (error, feed_forward) in [(bad, 0.0), (0.1, bad)] {
                let mut law = law();
                law.step(0.1, 0.0, DT);
                assert_eq!(law.step(error, feed_forward, DT), 0.0);
                assert_eq!(law.step(0.0, 0.0, DT), 0.0, "as new");
            }
        }
    }
}
