//! The incremental regulator that the IRp-6 closes its position loops with, and its table of axes.
//!
//! It counts as the robot's hardware does: encoder counts per servo period in, milliamperes out. As a
//! filter of the position error it is
//!
//! ```text
//!           (b0 - b1 z⁻¹) ((1 + eps) - (1 - eps) z⁻¹)
//! C(z) = kp ─────────────────────────────────────────
//!                   (1 - z⁻¹) (1 - a z⁻¹)
//! ```
//!
//! one integrator, two zeros close to 1 and one pole at a; over a motor, which integrates, the loop
//! follows a constant velocity without error. Coefficients hold for a period of 2 ms. Left out: the
//! variant without integrator and the laws whose output is a pulse width.

use drive::Increments;

/// What a drive in current mode counts in, mA.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Milliamperes(pub i32);

/// The coefficients of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IncrementalConfig {
    /// Pole.
    pub a: f64,
    /// Weight of the filtered error.
    pub b0: f64,
    /// Weight of the filtered error one period ago.
    pub b1: f64,
    /// How far the first zero lies from 1, about half of it.
    pub eps: f64,
    /// Current per unit of output, mA.
    pub gain_ma: f64,
    /// The most that is asked for either way, mA.
    pub max_current_ma: f64,
}

/// The IRp-6: column, lower arm, upper arm, T, V, N.
pub const IRP6: [IncrementalConfig; 6] = [
    axis(0.412429378531, 1.5569592, 1.5028614, 0.010, 200.0, 20_000.0),
    axis(0.655629139073, 0.6181068, 0.5916852, 0.008, 150.0, 15_000.0),
    axis(0.315789473684, 1.1984784, 1.1424828, 0.008, 180.0, 15_000.0),
    axis(0.548946716233, 0.6305064, 0.5874396, 0.010, 170.0, 15_000.0),
    axis(0.391982182628, 0.4458592, 0.4085392, 0.020, 110.0, 8_000.0),
    axis(0.3, 0.5456, 0.5056, 0.005, 11.0, 1_000.0),
];

const fn axis(
    a: f64,
    b0: f64,
    b1: f64,
    eps: f64,
    gain_ma: f64,
    max_current_ma: f64,
) -> IncrementalConfig {
    IncrementalConfig {
        a,
        b0,
        b1,
        eps,
        gain_ma,
        max_current_ma,
    }
}

/// The regulator of one axis and what it remembers.
#[derive(Clone, Debug)]
pub struct Incremental {
    config: IncrementalConfig,
    /// Increment demanded less increment made, one period ago, counts.
    error: f64,
    /// The error summed up with its leading zero, one period ago, counts.
    filtered: f64,
    /// Limited output one and two periods ago.
    output: [f64; 2],
}

impl Incremental {
    /// At rest: no error, no current.
    pub fn new(config: IncrementalConfig) -> Self {
        Self {
            config,
            error: 0.0,
            filtered: 0.0,
            output: [0.0; 2],
        }
    }

    /// One period: how far the axis was to move in it and how far it did, counts, give the current
    /// for the next.
    ///
    /// The limited output is what it remembers, and that is its only guard against winding up.
    pub fn step(&mut self, demanded: f64, moved: Increments) -> Milliamperes {
        let IncrementalConfig {
            a,
            b0,
            b1,
            eps,
            gain_ma,
            max_current_ma,
        } = self.config;
        let error = demanded - f64::from(moved.0);
        let filtered = self.filtered + (1.0 + eps) * error - (1.0 - eps) * self.error;
        let wanted =
            (1.0 + a) * self.output[0] - a * self.output[1] + b0 * filtered - b1 * self.filtered;
        let limit = max_current_ma / gain_ma;
        let output = wanted.clamp(-limit, limit);
        self.error = error;
        self.filtered = filtered;
        self.output = [output, self.output[0]];
        Milliamperes((gain_ma * output) as i32)
    }

    /// Forgets everything, as after homing.
    pub fn reset(&mut self) {
        *self = Self::new(self.config);
    }
}

#[cfg(test)]
mod tests {
    use super::{IRP6, Incremental, IncrementalConfig, Milliamperes};
    use drive::Increments;

    fn outputs(config: IncrementalConfig, errors: &[f64]) -> Vec<i32> {
        let mut regulator = Incremental::new(config);
        errors
            .iter()
            .map(|error| regulator.step(*error, Increments(0)).0)
            .collect()
    }

    #[test]
    fn response_is_that_of_the_transfer_function() {
        // The increments of a position error that steps to 1000 counts, so that C(z) acts on a step.
        let config = IncrementalConfig {
            gain_ma: 1.0,
            max_current_ma: 1e9,
            ..IRP6[0]
        };
        let IncrementalConfig { a, b0, b1, eps, .. } = config;
        let (c0, c1, c2) = (
            b0 * (1.0 + eps),
            -b0 * (1.0 - eps) - b1 * (1.0 + eps),
            b1 * (1.0 - eps),
        );
        let (mut y1, mut y2) = (0.0, 0.0);
        let expected: Vec<i32> = (0..50)
            .map(|k| {
                let x = |n: i32| if k >= n { 1000.0 } else { 0.0 };
                let y = (1.0 + a) * y1 - a * y2 + c0 * x(0) + c1 * x(1) + c2 * x(2);
                (y1, y2) = (y, y1);
                y as i32
            })
            .collect();
        let mut errors = [0.0; 50];
        errors[0] = 1000.0;
        assert_eq!(outputs(config, &errors), expected);
        assert_eq!(expected[..2], [1572, 734]);
    }

    #[test]
    fn standing_error_is_integrated() {
        let mut errors = [0.0; 400];
        errors[0] = 1.0;
        let currents = outputs(IRP6[0], &errors);
        let risen = currents[399] - currents[199];
        // 200 mA · (b0 - b1) · 2 eps / (1 - a) in each of 200 periods.
        assert!((73..=75).contains(&risen), "{risen} mA");
    }

    #[test]
    fn current_stays_within_its_limit_and_leaves_it_at_once() {
        for config in IRP6 {
            let limit = config.max_current_ma as i32;
            let mut regulator = Incremental::new(config);
            for _ in 0..100 {
                let Milliamperes(current) = regulator.step(1000.0, Increments(0));
                assert!((0..=limit).contains(&current), "{current}");
            }
            let Milliamperes(current) = regulator.step(-3000.0, Increments(0));
            assert!(current < limit, "{current}");
        }
    }

    #[test]
    fn reset_is_a_new_regulator() {
        let mut regulator = Incremental::new(IRP6[1]);
        for _ in 0..10 {
            regulator.step(7.0, Increments(3));
        }
        regulator.reset();
        assert_eq!(regulator.step(0.0, Increments(0)), Milliamperes(0));
    }
}
