//! The inner loops of a drive: position over velocity over current, as in a drive of the EPOS4 class.
//!
//! The current loop runs each sub-step of 100 µs, the outer loops every tenth sub-step. [`Gains::new`] derives all
//! gains from the motor's data and the bandwidth `ωv` of the velocity loop. The drive reads its encoder and its
//! current sensor, and has no other access to the plant.

use std::f64::consts::TAU;

use crate::plant::{AxisConfig, Demand, PlantConfig, SUB_STEP, Wut};

/// Settings of a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmplifierConfig {
    /// Current limit, A.
    pub max_current: f64,
    /// Over-current threshold: the power stage trips beyond this current, A.
    pub trip_current: f64,
    /// Voltage limit, V.
    pub max_voltage: f64,
    /// Inertia for which the loops are tuned, kg·m².
    pub inertia: f64,
    /// Time constant of the low-pass filter of position set-points, s; 0 without a filter.
    pub setpoint_filter: f64,
}

impl AmplifierConfig {
    /// Bandwidth of the velocity loop, rad/s. 45 Hz: a fifth of the bandwidth of the encoder observer. The observer's
    /// bandwidth is a fifth of the loop's 1 kHz rate.
    pub const VELOCITY_BANDWIDTH: f64 = 45.0 * TAU;
    /// Gain of the position loop, 1/s.
    pub const POSITION_GAIN: f64 = Self::VELOCITY_BANDWIDTH / SPACING;
}

/// Sub-steps per step of the outer loops.
pub(crate) const OUTER: u32 = 10;
const OUTER_STEP: f64 = OUTER as f64 * SUB_STEP;
/// Ratio between the bandwidths of neighbouring loops in the cascade.
const SPACING: f64 = 5.0;
/// Bandwidth of the current loop, rad/s.
const CURRENT_BANDWIDTH: f64 = 1000.0 * TAU;
/// Weight of the newest sample in the low-pass filter of the feed-forward acceleration, per millisecond. Without the
/// filter, a demand that changes every other millisecond makes the acceleration jump.
const ACCELERATION_SHARE: f64 = 0.2;

#[derive(Clone, Copy, Debug)]
struct Gains {
    /// Demanded velocity per position error, 1/s: `ωv / 5`.
    position: f64,
    /// Torque per velocity error, N·m·s/rad: `J ωv`.
    velocity: f64,
    /// Torque per velocity error and outer step. The integral acts below `ωv / 5`.
    velocity_integral: f64,
    /// Weight of the newest position set-point in the filter, per outer step.
    setpoint_share: f64,
    /// Torque per demanded acceleration, kg·m²: `J`.
    inertia: f64,
    /// Torque per demanded velocity, N·m·s/rad: `b`.
    viscous: f64,
    /// Voltage per current error, Ω. With `e = exp(-R dt / L)` the sampled winding has its pole at e, and the
    /// controller's zero cancels that pole. `R (1 - p) / (1 - e)` puts the closed loop's single pole at
    /// `p = exp(-ωc dt)`.
    current: f64,
    /// Voltage per current error and sub-step.
    current_integral: f64,
    /// Critically damped observer of the encoder with bandwidth `5 ωv`: correction per sub-step of the counts ...
    observer_counts: f64,
    /// ... and of the counts/s.
    observer_velocity: f64,
}

impl Gains {
    fn new(config: &AmplifierConfig, plant: &PlantConfig) -> Self {
        let inertia = config.inertia;
        let bandwidth = AmplifierConfig::VELOCITY_BANDWIDTH;
        let (viscous, current, current_integral) = match plant {
            PlantConfig::Wut(wut) => (wut.viscous, 0.0, 0.0),
            PlantConfig::Physical(motor) => {
                let decay = (-motor.resistance * SUB_STEP / motor.inductance).exp();
                let pole = (-CURRENT_BANDWIDTH * SUB_STEP).exp();
                let gain = motor.resistance * (1.0 - pole) / (1.0 - decay);
                (motor.viscous, gain, gain * (1.0 - decay))
            }
        };
        let observer = SPACING * bandwidth;
        Self {
            position: AmplifierConfig::POSITION_GAIN,
            velocity: inertia * bandwidth,
            velocity_integral: inertia * bandwidth * bandwidth / SPACING * OUTER_STEP,
            setpoint_share: 1.0 - (-OUTER_STEP / config.setpoint_filter.max(1e-9)).exp(),
            inertia,
            viscous,
            current,
            current_integral,
            observer_counts: 2.0 * observer * SUB_STEP,
            observer_velocity: observer * observer * SUB_STEP,
        }
    }
}

/// State of the loops.
#[derive(Clone, Debug)]
pub(crate) struct Amplifier {
    pub(crate) config: AmplifierConfig,
    gains: Gains,
    pub(crate) torque_constant: f64,
    radians_per_count: f64,
    /// The counter at the last reading, and the lead of the observer over the counter, counts.
    counts: f64,
    ahead: f64,
    /// Observed velocity, counts/s.
    pub(crate) observed_velocity: f64,
    /// Output of the set-point filter, counts; `None` while the position loop is open.
    filtered: Option<f64>,
    /// Whether the velocity loop was closed in the previous outer step.
    closed: bool,
    /// Feed-forward velocity of the previous outer step, rad/s, and its filtered rate of change, rad/s².
    velocity: f64,
    acceleration: f64,
    /// Integral part of the velocity loop, N·m.
    torque_integral: f64,
    /// Set-point of the current loop, A.
    pub(crate) current: f64,
    /// Integral part of the current loop, V.
    voltage_integral: f64,
    /// Fixed output voltage in place of the current loop, V.
    fixed: Option<f64>,
    /// Whether the power stage was on in the previous sub-step.
    on: bool,
    /// Torque added to the output of the velocity loop, N·m.
    pub(crate) torque_offset: f64,
}

impl Amplifier {
    pub(crate) fn new(axis: &AxisConfig) -> Self {
        Self {
            config: axis.amplifier,
            gains: Gains::new(&axis.amplifier, &axis.plant),
            torque_constant: axis.plant.torque_constant(),
            radians_per_count: TAU / f64::from(axis.counts_per_revolution),
            counts: 0.0,
            ahead: 0.5,
            observed_velocity: 0.0,
            filtered: None,
            closed: false,
            velocity: 0.0,
            acceleration: 0.0,
            torque_integral: 0.0,
            current: 0.0,
            voltage_integral: 0.0,
            fixed: None,
            on: false,
            torque_offset: 0.0,
        }
    }

    /// Replaces the gains of the current loop that follow from the motor: voltage per current error, Ω, and voltage
    /// per current error and sub-step. The regression model does not use these gains.
    pub(crate) fn set_current_gains(&mut self, proportional: f64, integral: f64) {
        self.gains.current = proportional;
        self.gains.current_integral = integral;
    }

    /// Takes an encoder reading, whole counts. Called each sub-step, with the power stage on or off. The angle within a
    /// count is taken to be at the middle of the count.
    pub(crate) fn observe(&mut self, counts: f64) {
        self.ahead -= counts - self.counts;
        self.counts = counts;
        let error = 0.5 - self.ahead;
        self.observed_velocity += self.gains.observer_velocity * error;
        self.ahead += self.observed_velocity * SUB_STEP + self.gains.observer_counts * error;
    }

    /// Resets every loop. Called when the power stage is off.
    pub(crate) fn release(&mut self) {
        self.filtered = None;
        self.closed = false;
        self.torque_integral = 0.0;
        self.current = 0.0;
        self.voltage_integral = 0.0;
        self.fixed = None;
        self.on = false;
    }

    /// Applies a demand on the current loop itself, which continues from the last output voltage.
    pub(crate) fn command(&mut self, demand: &Demand) {
        self.fixed = None;
        match *demand {
            Demand::Current(current) => {
                self.closed = false;
                self.current = current;
                self.torque_integral = current * self.torque_constant;
            }
            Demand::Duty(share) => {
                self.closed = false;
                self.torque_integral = 0.0;
                let voltage = share.clamp(-1.0, 1.0) * self.config.max_voltage;
                self.voltage_integral = voltage;
                self.fixed = Some(voltage);
            }
            Demand::Off | Demand::Position { .. } | Demand::Velocity(_) | Demand::Torque(_) => {}
        }
    }

    /// One step of the outer loops. `sub_step` counts sub-steps since the demand was set.
    pub(crate) fn regulate(&mut self, demand: &Demand, sub_step: u32, counts: i32) {
        if !matches!(demand, Demand::Position { .. }) {
            self.filtered = None;
        }
        let (velocity, correction) = match *demand {
            Demand::Off => return self.release(),
            Demand::Current(_) | Demand::Duty(_) => return,
            Demand::Torque(torque) => {
                self.closed = false;
                self.current = self.limited(torque / self.torque_constant);
                // Bumpless transfer: a velocity loop that takes over starts from this torque.
                self.torque_integral = self.current * self.torque_constant;
                return;
            }
            Demand::Velocity(velocity) => (velocity, 0.0),
            Demand::Position { counts: start, velocity } => {
                let here = start + velocity * f64::from(sub_step) * SUB_STEP;
                let (here, velocity) = self.filter(here, velocity);
                (velocity, self.gains.position * (here - f64::from(counts)))
            }
        };
        let velocity_error = (velocity + correction - self.observed_velocity) * self.radians_per_count;
        let torque = self.feed_forward(velocity * self.radians_per_count)
            + self.gains.velocity * velocity_error
            + self.torque_integral
            + self.torque_offset;
        let wanted = torque / self.torque_constant;
        self.current = self.limited(wanted);
        // Anti-windup: at the current limit the integral may shrink but not grow.
        if self.current == wanted || velocity_error * wanted < 0.0 {
            self.torque_integral += self.gains.velocity_integral * velocity_error;
        }
    }

    /// Set-point behind the filter, counts, and its velocity, counts/s.
    fn filter(&mut self, counts: f64, velocity: f64) -> (f64, f64) {
        if self.config.setpoint_filter == 0.0 {
            return (counts, velocity);
        }
        let last = self.filtered.unwrap_or(counts);
        let filtered = last + self.gains.setpoint_share * (counts - last);
        self.filtered = Some(filtered);
        (filtered, (filtered - last) / OUTER_STEP)
    }

    /// Torque that an ideal axis needs for the demanded motion, N·m.
    fn feed_forward(&mut self, velocity: f64) -> f64 {
        if self.closed {
            let rise = (velocity - self.velocity) / OUTER_STEP;
            self.acceleration += ACCELERATION_SHARE * (rise - self.acceleration);
        } else {
            self.closed = true;
            self.acceleration = 0.0;
        }
        self.velocity = velocity;
        self.gains.inertia * self.acceleration + self.gains.viscous * velocity
    }

    fn limited(&self, current: f64) -> f64 {
        current.clamp(-self.config.max_current, self.config.max_current)
    }

    /// One step of the current loop: the voltage for a measured current.
    ///
    /// A motor may turn when its drive is switched on, for example under a load that falls. The loop then starts from the
    /// back-EMF at the observed velocity. Otherwise the back-EMF would drive a current that trips the drive.
    pub(crate) fn voltage(&mut self, measured: f64) -> f64 {
        let was_on = std::mem::replace(&mut self.on, true);
        if let Some(voltage) = self.fixed {
            return voltage;
        }
        if !was_on {
            self.voltage_integral = self.torque_constant * self.observed_velocity * self.radians_per_count;
        }
        let error = self.current - measured;
        let wanted = self.gains.current * error + self.voltage_integral;
        let voltage = wanted.clamp(-self.config.max_voltage, self.config.max_voltage);
        if voltage == wanted || error * wanted < 0.0 {
            self.voltage_integral += self.gains.current_integral * error;
        }
        voltage
    }

    /// Current of a motor without inductance, A: the set-point of the outer loops, or the current that a fixed
    /// voltage drives against the back-EMF.
    pub(crate) fn settle(&mut self, wut: &Wut) -> f64 {
        if let Some(voltage) = self.fixed {
            self.current = wut.static_current(voltage);
        }
        self.current
    }

    /// Whether a measured current exceeds the over-current threshold.
    pub(crate) fn overloaded(&self, measured: f64) -> bool {
        measured.abs() > self.config.trip_current
    }
}
