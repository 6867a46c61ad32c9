//! Incremental law of the original IRp-6 controller.

use serde::{Deserialize, Serialize};

use super::share;
use crate::config::refusal::{first_wrong, is_not_negative, is_positive};

/// Coefficients of `gain (b0 - b1/z) ((1 + eps) - (1 - eps)/z) / ((1 - 1/z) (1 - a/z))`, which acts on the position
/// error in counts; they hold for one servo period.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "schema", schemars(rename = "Incremental"))]
pub struct IncrementalConfig {
    /// Pole, from 0 to below 1.
    pub a: f64,
    /// Weight of the filtered error.
    pub b0: f64,
    /// Weight of the filtered error one period ago.
    pub b1: f64,
    /// How far the first zero lies from 1, about half of it.
    pub eps: f64,
    /// Whether the position error is integrated; a lead filter otherwise, in which eps means nothing.
    #[serde(default = "integrating")]
    pub integral: bool,
    /// Output per unit of the law's own.
    pub gain: f64,
    /// The most that is put out either way.
    pub limit: f64,
}

const fn integrating() -> bool {
    true
}

/// The IRp-6 by torque: column, lower arm, upper arm, T, V, N. For encoder counts and 2 ms.
pub const IRP6: [IncrementalConfig; 6] = [
    by_current(0.412429378531, 1.5569592, 1.5028614, 0.010, 200.0, 20_000.0),
    by_current(0.655629139073, 0.6181068, 0.5916852, 0.008, 150.0, 15_000.0),
    by_current(0.315789473684, 1.1984784, 1.1424828, 0.008, 180.0, 15_000.0),
    by_current(0.548946716233, 0.6305064, 0.5874396, 0.010, 170.0, 15_000.0),
    by_current(0.391982182628, 0.4458592, 0.4085392, 0.020, 110.0, 8_000.0),
    by_current(0.3, 0.5456, 0.5056, 0.005, 11.0, 1_000.0),
];

/// The same by pulse width: the law counts 255ths of it and uses up to 190.
pub const IRP6_DUTY: [IncrementalConfig; 6] = {
    let mut table = IRP6;
    let mut axis = 0;
    while axis < table.len() {
        table[axis].gain = 1.0 / 255.0;
        table[axis].limit = 190.0 / 255.0;
        axis += 1;
    }
    table
};

/// Torque per current of the IRp-6's motors, N·m/mA.
const TORQUE_CONSTANT: f64 = 0.105e-3;

const fn by_current(a: f64, b0: f64, b1: f64, eps: f64, gain_ma: f64, max_current_ma: f64) -> IncrementalConfig {
    IncrementalConfig {
        a,
        b0,
        b1,
        eps,
        integral: true,
        gain: gain_ma * TORQUE_CONSTANT,
        limit: max_current_ma * TORQUE_CONSTANT,
    }
}

impl IncrementalConfig {
    /// The first field that makes no sense.
    pub(crate) fn nonsense(&self) -> Option<&'static str> {
        first_wrong([
            (is_not_negative(self.a) && self.a < 1.0, "a of its loop"),
            (is_positive(self.b0), "b0 of its loop"),
            (is_not_negative(self.b1), "b1 of its loop"),
            (is_not_negative(self.eps) && self.eps < 1.0, "eps of its loop"),
            (is_positive(self.gain), "gain of its loop"),
            (is_positive(self.limit), "limit of its loop"),
        ])
    }
}

/// The incremental regulator that the IRp-6 closes its position loops with.
///
/// It takes the change of the position error in each period. As a filter of that error it is
///
/// ```text
///             (b0 - b1 z⁻¹) ((1 + eps) - (1 - eps) z⁻¹)                        b0 - b1 z⁻¹
/// C(z) = gain ─────────────────────────────────────────   or, without   gain ────────────
///                     (1 - z⁻¹) (1 - a z⁻¹)                 integral           1 - a z⁻¹
/// ```
///
/// With one integrator over a motor, which integrates, the loop follows a constant velocity without
/// error. The limited output is what it remembers, and that is its only guard against winding up.
#[derive(Clone, Debug)]
pub struct Incremental {
    config: IncrementalConfig,
    /// Change of the error, one period ago.
    error: f64,
    /// That summed up with its leading zero, one period ago.
    filtered: f64,
    /// Limited output, less feed-forward, one and two periods ago.
    output: [f64; 2],
}

impl Incremental {
    /// At rest: no error, no output.
    pub fn new(config: IncrementalConfig) -> Self {
        Self { config, error: 0.0, filtered: 0.0, output: [0.0; 2] }
    }

    /// One period: by how much the position error grew in it gives the output for the next, to which
    /// `feed_forward` is added before it is limited.
    ///
    /// An input that is not finite resets the law, and the output is zero.
    pub fn step(&mut self, error: f64, feed_forward: f64) -> f64 {
        let IncrementalConfig { a, b0, b1, eps, integral, gain, limit } = self.config;
        let filtered = if integral { self.filtered + (1.0 + eps) * error - (1.0 - eps) * self.error } else { error };
        let wanted = (1.0 + a) * self.output[0] - a * self.output[1] + b0 * filtered - b1 * self.filtered;
        let output = gain * wanted + feed_forward;
        if !output.is_finite() {
            self.reset();
            return 0.0;
        }
        let limited = output.clamp(-limit, limit);
        self.error = error;
        self.filtered = filtered;
        self.output = [(limited - feed_forward) / gain, self.output[0]];
        limited
    }

    /// Bumpless transfer: removes at most `output` from the integral part at rest and returns the amount removed. The next
    /// output is lower by that amount.
    pub fn give(&mut self, output: f64) -> f64 {
        let given = share(self.integral(), output);
        self.output.iter_mut().for_each(|own| *own -= given / self.config.gain);
        given
    }

    /// The integral part of the output. Valid at rest. Zero for a law without an integral part.
    pub fn integral(&self) -> f64 {
        if self.config.integral { self.config.gain * self.output[0] } else { 0.0 }
    }

    /// Resets the law, and presets its integral part to `output`, clamped to the limit. A law without an integral part
    /// begins at zero.
    pub fn restart(&mut self, output: f64) {
        let IncrementalConfig { integral, gain, limit, .. } = self.config;
        let preset = if integral && output.is_finite() { output.clamp(-limit, limit) } else { 0.0 };
        *self = Self { output: [preset / gain; 2], ..Self::new(self.config) };
    }

    /// Resets the law to its state at rest with zero output.
    pub fn reset(&mut self) {
        self.restart(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(config: IncrementalConfig, errors: &[f64]) -> Vec<f64> {
        let mut regulator = Incremental::new(config);
        errors.iter().map(|error| regulator.step(*error, 0.0)).collect()
    }

    /// The first of `length` increments of an error that steps to `error`.
    fn step_of(error: f64, length: usize) -> Vec<f64> {
        let mut errors = vec![0.0; length];
        errors[0] = error;
        errors
    }

    #[test]
    fn response_is_that_of_the_transfer_function() {
        for integral in [true, false] {
            let config = IncrementalConfig { integral, gain: 1.0, limit: 1e9, ..IRP6[0] };
            let IncrementalConfig { a, b0, b1, eps, .. } = config;
            let (numerator, denominator) = if integral {
                let zeros = [b0 * (1.0 + eps), -b0 * (1.0 - eps) - b1 * (1.0 + eps), b1 * (1.0 - eps)];
                (zeros, [1.0 + a, -a])
            } else {
                ([b0, -b1, 0.0], [a, 0.0])
            };
            let (mut y1, mut y2) = (0.0, 0.0);
            let found = outputs(config, &step_of(1000.0, 50));
            for (k, found) in found.iter().enumerate() {
                let x = |n: usize| if k >= n { 1000.0 } else { 0.0 };
                let y = denominator[0] * y1
                    + denominator[1] * y2
                    + numerator[0] * x(0)
                    + numerator[1] * x(1)
                    + numerator[2] * x(2);
                (y1, y2) = (y, y1);
                assert!((found - y).abs() < 1e-6, "{integral} {k}: {found} for {y}");
            }
        }
    }

    #[test]
    fn standing_error_is_integrated_or_not_as_configured() {
        let torque = outputs(IRP6[0], &step_of(1.0, 400));
        let risen = (torque[399] - torque[199]) / TORQUE_CONSTANT;
        // 200 mA · (b0 - b1) · 2 eps / (1 - a) in each of 200 periods.
        assert!((73.0..=75.0).contains(&risen), "{risen} mA");
        let lead = IncrementalConfig { integral: false, ..IRP6[0] };
        let torque = outputs(lead, &step_of(1.0, 400));
        let settled = 200.0 * TORQUE_CONSTANT * (lead.b0 - lead.b1) / (1.0 - lead.a);
        assert!((torque[399] - settled).abs() < 1e-9);
        assert!((torque[199] - settled).abs() < 1e-9);
    }

    #[test]
    fn output_stays_within_its_limit_and_leaves_it_at_once() {
        for config in IRP6.into_iter().chain(IRP6_DUTY) {
            for feed_forward in [0.0, 0.1] {
                let mut regulator = Incremental::new(config);
                for _ in 0..100 {
                    let output = regulator.step(1000.0, feed_forward);
                    assert!((0.0..=config.limit).contains(&output), "{output}");
                }
                let output = regulator.step(-3000.0, feed_forward);
                assert!(output < config.limit, "{output}");
            }
        }
    }

    #[test]
    fn what_is_not_a_number_gives_no_output_and_is_forgotten() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for at in 0..2 {
                let mut regulator = Incremental::new(IRP6[1]);
                regulator.step(7.0, 0.0);
                let mut inputs = [7.0, 0.0];
                inputs[at] = bad;
                assert_eq!(regulator.step(inputs[0], inputs[1]), 0.0);
                assert_eq!(regulator.step(0.0, 0.0), 0.0, "as new");
            }
        }
    }
}
