//! The transducer: from the true wrench to a reading with gain errors, drift, noise and a limited range.

use std::time::Duration;

use can::Instant;

use super::{Channel, ForceSensorError, WrenchProbe};
use crate::Mechanism;
use crate::plant::Noise;

/// Errors and range of a transducer. The arrays have the order of [`Channel::ALL`].
#[derive(Clone, Debug, PartialEq)]
pub struct TransducerConfig {
    /// Reading per true value; 1 for an exact transducer.
    pub gain: [f64; 6],
    /// Greatest magnitude of a reading before the bias is subtracted, N and N·m. A reading at the range is saturated.
    pub range: [f64; 6],
    /// Reading of the sensor without load at the start temperature, N and N·m.
    pub offset: [f64; 6],
    /// Standard deviation of the white noise of a sample, N and N·m.
    pub noise: [f64; 6],
    /// Change of the reading per change of temperature, N/K and N·m/K.
    pub drift: [f64; 6],
    /// Temperature of the transducer.
    pub temperature: TemperatureCourse,
    /// Seed of the noise.
    pub seed: u64,
}

/// First-order temperature course: `end + (start - end) exp(-t / time_constant)`, with `t` from power-on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemperatureCourse {
    /// Temperature at power-on, °C. The drift is zero at this temperature.
    pub start: f64,
    /// Final temperature, °C.
    pub end: f64,
    /// Time constant. Zero: the transducer has its final temperature from power-on.
    pub time_constant: Duration,
}

impl TemperatureCourse {
    /// A constant 25 °C.
    pub const CONSTANT: Self = Self { start: 25.0, end: 25.0, time_constant: Duration::ZERO };

    /// Temperature, °C, at a time after power-on.
    pub fn at(&self, since: Duration) -> f64 {
        let left = if self.time_constant.is_zero() {
            0.0
        } else {
            (-since.as_secs_f64() / self.time_constant.as_secs_f64()).exp()
        };
        self.end + (self.start - self.end) * left
    }
}

impl Default for TransducerConfig {
    /// A transducer without errors. The range is the range of ATI's Gamma with calibration SI-130-10: 130 N along x and
    /// y, 400 N along z, and 10 N·m. No source gives the calibration of the transducers of the IRp-6.
    fn default() -> Self {
        Self {
            gain: [1.0; 6],
            range: [130.0, 130.0, 400.0, 10.0, 10.0, 10.0],
            offset: [0.0; 6],
            noise: [0.0; 6],
            drift: [0.0; 6],
            temperature: TemperatureCourse::CONSTANT,
            seed: 0,
        }
    }
}

impl TransducerConfig {
    fn check(&self) -> Result<(), ForceSensorError> {
        for (at, channel) in Channel::ALL.into_iter().enumerate() {
            let [gain, offset, drift, range, noise] =
                [self.gain, self.offset, self.drift, self.range, self.noise].map(|values| values[at]);
            if !gain.is_finite() {
                return Err(ForceSensorError::Gain { channel, value: gain });
            }
            if !offset.is_finite() {
                return Err(ForceSensorError::Offset { channel, value: offset });
            }
            if !drift.is_finite() {
                return Err(ForceSensorError::Drift { channel, value: drift });
            }
            if !(range.is_finite() && range > 0.0) {
                return Err(ForceSensorError::Range { channel, value: range });
            }
            if !(noise.is_finite() && noise >= 0.0) {
                return Err(ForceSensorError::Noise { channel, value: noise });
            }
        }
        let TemperatureCourse { start, end, .. } = self.temperature;
        if start.is_finite() && end.is_finite() { Ok(()) } else { Err(ForceSensorError::Temperature { start, end }) }
    }
}

/// One reading of all channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    /// Values, N and N·m.
    pub(super) values: [f64; 6],
    /// Saturated channels, channel Fx in the lowest bit. The bias does not change saturation.
    pub(super) saturated: u8,
}

pub(super) struct Transducer {
    config: TransducerConfig,
    probe: Box<dyn WrenchProbe>,
    power_on: Instant,
    noise: Noise,
    bias: [f64; 6],
}

impl Transducer {
    pub(super) fn new(
        config: TransducerConfig,
        power_on: Instant,
        probe: Box<dyn WrenchProbe>,
    ) -> Result<Self, ForceSensorError> {
        config.check()?;
        let noise = Noise::new(config.seed);
        Ok(Self { config, probe, power_on, noise, bias: [0.0; 6] })
    }

    /// The robot in a scene whose wrench the sensor measures.
    pub(super) fn mechanism(&self) -> Option<&Mechanism> {
        self.probe.mechanism()
    }

    /// Takes a sample at `now`.
    pub(super) fn read(&mut self, now: Instant) -> Reading {
        let mut reading = self.sample(now);
        for (value, bias) in reading.values.iter_mut().zip(self.bias) {
            *value -= bias;
        }
        reading
    }

    /// Takes a sample at `now`, including its noise. The values of the sample become the zero of later readings.
    pub(super) fn set_bias(&mut self, now: Instant) {
        self.bias = self.sample(now).values;
    }

    pub(super) fn clear_bias(&mut self) {
        self.bias = [0.0; 6];
    }

    /// Temperature, °C.
    pub(super) fn temperature(&self, now: Instant) -> f64 {
        self.config.temperature.at(now.since(self.power_on))
    }

    /// A sample before the bias. A true value that is not a number saturates its channel.
    fn sample(&mut self, now: Instant) -> Reading {
        let warmth = self.temperature(now) - self.config.temperature.start;
        let wrench = self.probe.wrench(now);
        let mut reading = Reading { values: [0.0; 6], saturated: 0 };
        for (at, truth) in wrench.into_iter().enumerate() {
            let config = &self.config;
            let mut value = config.gain[at] * truth + config.offset[at] + config.drift[at] * warmth;
            if config.noise[at] > 0.0 {
                value += config.noise[at] * self.noise.normal();
            }
            let range = config.range[at];
            // The comparison is false for NaN.
            if value.abs() < range {
                reading.values[at] = value;
            } else {
                reading.values[at] = range.copysign(value);
                reading.saturated |= 1 << at;
            }
        }
        reading
    }
}

/// Counts of a value, rounded to the nearest count and limited to 32 bits.
pub(super) fn counts(value: f64, per_count: f64) -> i32 {
    (value / per_count).round() as i32
}

/// As [`counts`], limited to 16 bits.
pub(super) fn counts_16(value: f64, per_count: f64) -> i16 {
    (value / per_count).round() as i16
}
