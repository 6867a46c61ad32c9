//! The inner loops of a drive: position over velocity over current, as an EPOS4-class drive closes them.
//!
//! The current loop runs each sub-step of 100 µs, the outer loops each tenth. All gains follow from
//! the motor's data and one number, the velocity loop's bandwidth `ωv`, by [`Gains::new`]. The drive
//! knows its encoder and its current sensor, nothing else of the plant.

use std::f64::consts::TAU;

use crate::plant::{Demand, PlantConfig, SUB_STEP, Wut};

/// What a drive is set to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmplifierConfig {
    /// The most it lets flow, A.
    pub max_current: f64,
    /// Beyond it the power stage trips, A.
    pub trip_current: f64,
    /// The most it puts out, V.
    pub max_voltage: f64,
    /// Inertia that its loops are tuned for, kg·m².
    pub inertia: f64,
    /// Of the velocity loop over that inertia, rad/s.
    pub velocity_bandwidth: f64,
}

impl AmplifierConfig {
    /// 45 Hz: a fifth of what the encoder observer passes, which is itself a fifth of the 1 kHz
    /// rate of the loop.
    pub const VELOCITY_BANDWIDTH: f64 = 45.0 * TAU;
}

/// Sub-steps per turn of the outer loops.
pub(crate) const OUTER: u32 = 10;
const OUTER_STEP: f64 = OUTER as f64 * SUB_STEP;
/// How far neighbours in the cascade lie apart in bandwidth.
const SPACING: f64 = 5.0;
/// Of the current loop, rad/s.
const CURRENT_BANDWIDTH: f64 = 1000.0 * TAU;
/// Share of each millisecond's change of velocity feed-forward that its acceleration takes up, so
/// that a demand which changes every other millisecond does not make it jump.
const ACCELERATION_SHARE: f64 = 0.2;

/// The rule that turns a plant into gains.
#[derive(Clone, Copy, Debug)]
struct Gains {
    /// Demanded velocity per position error, 1/s: `ωv / 5`.
    position: f64,
    /// Torque per velocity error, N·m·s/rad: `J ωv`.
    velocity: f64,
    /// Torque per velocity error and outer step: its integral acts below `ωv / 5`.
    velocity_integral: f64,
    /// Torque per demanded acceleration, kg·m²: `J`.
    inertia: f64,
    /// Torque per demanded velocity, N·m·s/rad: `b`.
    viscous: f64,
    /// Voltage per current error, Ω. With `e = exp(-R dt / L)` the sampled winding has its pole at
    /// e; the controller's zero cancels it and `R (1 - p) / (1 - e)` puts the closed loop's single
    /// pole at `p = exp(-ωc dt)`.
    current: f64,
    /// Voltage per current error and sub-step.
    current_integral: f64,
    /// Critically damped observer of the encoder at `5 ωv`: per sub-step, on counts ...
    observer_counts: f64,
    /// ... and on counts/s.
    observer_velocity: f64,
}

impl Gains {
    fn new(config: &AmplifierConfig, plant: &PlantConfig) -> Self {
        let AmplifierConfig {
            inertia,
            velocity_bandwidth: bandwidth,
            ..
        } = *config;
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
            position: bandwidth / SPACING,
            velocity: inertia * bandwidth,
            velocity_integral: inertia * bandwidth * bandwidth / SPACING * OUTER_STEP,
            inertia,
            viscous,
            current,
            current_integral,
            observer_counts: 2.0 * observer * SUB_STEP,
            observer_velocity: observer * observer * SUB_STEP,
        }
    }
}

/// The loops at work.
#[derive(Clone, Debug)]
pub(crate) struct Amplifier {
    config: AmplifierConfig,
    gains: Gains,
    torque_constant: f64,
    radians_per_count: f64,
    /// The counter at the last reading, and how far the observer is ahead of it, counts.
    counts: i32,
    ahead: f64,
    /// Counts/s.
    observed_velocity: f64,
    /// Whether the velocity loop was closed a turn ago.
    closed: bool,
    /// Feed-forward of a turn ago, rad/s, and what it rises by, rad/s².
    velocity: f64,
    acceleration: f64,
    /// Of the velocity loop, N·m.
    torque_integral: f64,
    /// Asked of the current loop, A.
    current: f64,
    /// Of the current loop, V.
    voltage_integral: f64,
    /// Put out without a loop, V.
    fixed: Option<f64>,
    /// Added to what the velocity loop asks for, N·m.
    torque_offset: f64,
}

impl Amplifier {
    pub(crate) fn new(
        config: &AmplifierConfig,
        plant: &PlantConfig,
        counts_per_revolution: u32,
    ) -> Self {
        Self {
            config: *config,
            gains: Gains::new(config, plant),
            torque_constant: match plant {
                PlantConfig::Wut(wut) => wut.torque_constant,
                PlantConfig::Physical(motor) => motor.torque_constant,
            },
            radians_per_count: TAU / f64::from(counts_per_revolution),
            counts: 0,
            ahead: 0.5,
            observed_velocity: 0.0,
            closed: false,
            velocity: 0.0,
            acceleration: 0.0,
            torque_integral: 0.0,
            current: 0.0,
            voltage_integral: 0.0,
            fixed: None,
            torque_offset: 0.0,
        }
    }

    /// Has this torque, N·m, added to what the velocity loop asks for, until there is another.
    pub(crate) fn set_torque_offset(&mut self, torque: f64) {
        self.torque_offset = torque;
    }

    pub(crate) fn set_trip_current(&mut self, current: f64) {
        self.config.trip_current = current;
    }

    pub(crate) fn set_current_gains(&mut self, proportional: f64, integral: f64) {
        self.gains.current = proportional;
        self.gains.current_integral = integral;
    }

    /// Takes an encoder reading; each sub-step, power or not. A count stands for its middle.
    pub(crate) fn observe(&mut self, counts: i32) {
        self.ahead -= f64::from(counts.wrapping_sub(self.counts));
        self.counts = counts;
        let error = 0.5 - self.ahead;
        self.observed_velocity += self.gains.observer_velocity * error;
        self.ahead += self.observed_velocity * SUB_STEP + self.gains.observer_counts * error;
    }

    /// Power stage off: every loop forgets.
    pub(crate) fn release(&mut self) {
        self.closed = false;
        self.torque_integral = 0.0;
        self.current = 0.0;
        self.voltage_integral = 0.0;
        self.fixed = None;
    }

    /// Takes over what a demand says about the current loop itself. The loop goes on from the voltage
    /// that was put out.
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

    /// A turn of the outer loops, `sub_step` sub-steps into the demand.
    pub(crate) fn regulate(&mut self, demand: &Demand, sub_step: u32, counts: i32) {
        let (velocity, correction) = match *demand {
            Demand::Off => return self.release(),
            Demand::Current(_) | Demand::Duty(_) => return,
            Demand::Torque(torque) => {
                self.closed = false;
                self.current = self.limited(torque / self.torque_constant);
                // The velocity loop, should it take over, starts from here.
                self.torque_integral = self.current * self.torque_constant;
                return;
            }
            Demand::Velocity(velocity) => (velocity, 0.0),
            Demand::Position {
                counts: start,
                velocity,
            } => {
                let here = start + velocity * f64::from(sub_step) * SUB_STEP;
                (velocity, self.gains.position * (here - f64::from(counts)))
            }
        };
        let velocity_error =
            (velocity + correction - self.observed_velocity) * self.radians_per_count;
        let torque = self.feed_forward(velocity * self.radians_per_count)
            + self.gains.velocity * velocity_error
            + self.torque_integral
            + self.torque_offset;
        let wanted = torque / self.torque_constant;
        self.current = self.limited(wanted);
        // At its limit the integral may come down but not wind up.
        if self.current == wanted || velocity_error * wanted < 0.0 {
            self.torque_integral += self.gains.velocity_integral * velocity_error;
        }
    }

    /// Torque that the demanded motion needs of an ideal axis, N·m.
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

    /// One turn of the current loop: the voltage for a measured current.
    pub(crate) fn voltage(&mut self, measured: f64) -> f64 {
        if let Some(voltage) = self.fixed {
            return voltage;
        }
        let error = self.current - measured;
        let wanted = self.gains.current * error + self.voltage_integral;
        let voltage = wanted.clamp(-self.config.max_voltage, self.config.max_voltage);
        if voltage == wanted || error * wanted < 0.0 {
            self.voltage_integral += self.gains.current_integral * error;
        }
        voltage
    }

    /// The current of a motor that has no inductance, A: what the outer loops ask for, or what a fixed
    /// voltage drives against the back-EMF.
    pub(crate) fn settle(&mut self, wut: &Wut) -> f64 {
        if let Some(voltage) = self.fixed {
            self.current = wut.static_current(voltage);
        }
        self.current
    }

    /// Current that the outer loops ask for, A.
    pub(crate) fn current(&self) -> f64 {
        self.current
    }

    /// Whether a measured current is beyond what the power stage survives.
    pub(crate) fn overloaded(&self, measured: f64) -> bool {
        measured.abs() > self.config.trip_current
    }

    /// What the drive takes a measured current for, N·m.
    pub(crate) fn torque(&self, measured: f64) -> f64 {
        measured * self.torque_constant
    }

    /// Velocity, counts/s.
    pub(crate) fn observed_velocity(&self) -> f64 {
        self.observed_velocity
    }
}
