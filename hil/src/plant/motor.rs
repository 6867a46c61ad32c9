use super::SUB_STEP;
use super::friction::{Friction, FrictionConfig};
use super::noise::Noise;
use super::thermal::{Thermal, ThermalConfig};

/// A permanent-magnet motor with its load, everything at the motor shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorConfig {
    /// Torque per current, N·m/A, and back-EMF per speed, V·s/rad, at 25 °C.
    pub torque_constant: f64,
    /// Of the winding at 25 °C, Ω.
    pub resistance: f64,
    /// Of the winding, H.
    pub inductance: f64,
    /// Of rotor and reflected load, kg·m².
    pub inertia: f64,
    /// Viscous friction, N·m·s/rad.
    pub viscous: f64,
    /// Dry friction.
    pub friction: FrictionConfig,
    /// What the load weighs.
    pub gravity: Gravity,
    /// Where the mechanics ends, if it does.
    pub end_stops: Option<EndStops>,
    /// How it warms.
    pub thermal: ThermalConfig,
    /// Share of the motor's torque that varies at random, drawn anew each millisecond.
    pub torque_ripple: f64,
}

/// The load's weight as a torque on the motor: `amplitude · cos(angle / ratio + phase)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// At the motor, N·m.
    pub amplitude: f64,
    /// Motor angle per joint angle, negative if they turn against each other.
    pub ratio: f64,
    /// Of the joint where the motor reads zero, rad; torque is greatest where it makes zero.
    pub phase: f64,
}

impl Gravity {
    /// A load in balance.
    pub const NONE: Self = Self {
        amplitude: 0.0,
        ratio: 1.0,
        phase: 0.0,
    };
}

/// Buffers that push back, and never pull, beyond the ends of travel.
///
/// The integration stays stable for a stiffness below `inertia / SUB_STEP²`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndStops {
    /// Motor angle at which the negative buffer is touched, rad.
    pub negative: f64,
    /// Motor angle at which the positive buffer is touched, rad.
    pub positive: f64,
    /// N·m/rad at the motor.
    pub stiffness: f64,
    /// N·m·s/rad at the motor.
    pub damping: f64,
}

impl EndStops {
    fn torque(&self, angle: f64, velocity: f64) -> f64 {
        if angle < self.negative {
            (self.stiffness * (self.negative - angle) - self.damping * velocity).max(0.0)
        } else if angle > self.positive {
            (self.stiffness * (self.positive - angle) - self.damping * velocity).min(0.0)
        } else {
            0.0
        }
    }
}

/// Sub-steps between updates of gravity and ripple, 1 ms: at 250 rad/s and a gear of 130 the joint
/// turns 2 mrad between two of them.
const MEDIUM: u32 = 10;
/// Sub-steps between updates of temperatures and what depends on them, 100 ms of some 60 s.
const SLOW: u32 = 1000;
/// Copper gains this share of its resistance per kelvin.
const COPPER: f64 = 0.0039;
/// Ferrite magnets lose this share of their flux per kelvin.
const FERRITE: f64 = 0.002;

/// The motor moving: windings, shaft and temperatures.
#[derive(Clone, Debug)]
pub(crate) struct Motor {
    config: MotorConfig,
    friction: Friction,
    thermal: Thermal,
    noise: Noise,
    angle: f64,
    velocity: f64,
    current: f64,
    /// Step over inertia.
    gain: f64,
    sub_step: u32,
    /// Sum of i² since the last slow update.
    heat: f64,
    gravity: f64,
    torque_constant: f64,
    torque_per_current: f64,
    conductance: f64,
    /// What is left of a current deviation after one sub-step, exp(-R dt / L).
    decay: f64,
}

impl Motor {
    /// A cold motor at rest at `angle`, rad.
    pub(crate) fn new(config: &MotorConfig, angle: f64, noise: Noise) -> Self {
        Self {
            config: *config,
            friction: Friction::new(&config.friction),
            thermal: Thermal::new(&config.thermal),
            noise,
            angle,
            velocity: 0.0,
            current: 0.0,
            gain: SUB_STEP / config.inertia,
            sub_step: 0,
            heat: 0.0,
            gravity: 0.0,
            torque_constant: 0.0,
            torque_per_current: 0.0,
            conductance: 0.0,
            decay: 0.0,
        }
    }

    /// One sub-step under a voltage, V, or with the power stage off, which ends the current at once.
    /// A brake resists by up to `brake` N·m.
    ///
    /// The current follows the exact solution of `L di/dt = V - R i - Ke w` at constant speed, the
    /// shaft semi-implicit Euler with friction as in [`Friction::apply`].
    pub(crate) fn step(&mut self, voltage: Option<f64>, brake: f64) {
        if self.sub_step.is_multiple_of(MEDIUM) {
            self.update();
        }
        self.sub_step = (self.sub_step + 1) % SLOW;
        self.current = voltage.map_or(0.0, |voltage| {
            let settled = (voltage - self.torque_constant * self.velocity) * self.conductance;
            settled + (self.current - settled) * self.decay
        });
        self.heat += self.current * self.current;
        let mut torque = self.torque_per_current * self.current + self.gravity
            - self.config.viscous * self.velocity;
        if let Some(stops) = &self.config.end_stops {
            torque += stops.torque(self.angle, self.velocity);
        }
        let free = self.velocity + torque * self.gain;
        self.velocity = self.friction.apply(self.velocity, free, self.gain, brake);
        self.angle += self.velocity * SUB_STEP;
    }

    /// What changes slowly, and needs the functions that are slow.
    fn update(&mut self) {
        if self.sub_step == 0 {
            let seconds = f64::from(SLOW) * SUB_STEP;
            let resistance =
                self.config.resistance * (1.0 + COPPER * (self.thermal.winding() - 25.0));
            self.thermal
                .step(resistance * self.heat / f64::from(SLOW), seconds);
            self.heat = 0.0;
            self.conductance = 1.0 / resistance;
            self.decay = (-resistance * SUB_STEP / self.config.inductance).exp();
            self.torque_constant =
                self.config.torque_constant * (1.0 - FERRITE * (self.thermal.housing() - 25.0));
        }
        let Gravity {
            amplitude,
            ratio,
            phase,
        } = self.config.gravity;
        self.gravity = amplitude * (self.angle / ratio + phase).cos();
        let ripple = if self.config.torque_ripple > 0.0 {
            self.config.torque_ripple * self.noise.symmetric()
        } else {
            0.0
        };
        self.torque_per_current = self.torque_constant * (1.0 + ripple);
    }

    /// Angle, rad.
    pub(crate) fn angle(&self) -> f64 {
        self.angle
    }

    /// Current, A.
    pub(crate) fn current(&self) -> f64 {
        self.current
    }

    /// Whether the winding is hotter than the drive allows.
    pub(crate) fn overheated(&self) -> bool {
        self.thermal.tripped()
    }
}
