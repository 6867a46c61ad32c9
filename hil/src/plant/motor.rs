//! Motor with load.

use super::friction::{Friction, FrictionConfig};
use super::mechanism::{Loaded, Mount};
use super::thermal::{Thermal, ThermalConfig};
use super::{SUB_STEP, noise::Noise};

/// A permanent-magnet motor with its load, with all quantities at the motor shaft. For a mounted axis, inertia and weight
/// of the mechanism replace those of the load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorConfig {
    /// Torque per current, N·m/A, and back-EMF per speed, V·s/rad, at 25 °C.
    pub torque_constant: f64,
    /// Resistance of the winding at 25 °C, Ω.
    pub resistance: f64,
    /// Inductance of the winding, H.
    pub inductance: f64,
    /// Inertia of rotor and reflected load, kg·m².
    pub inertia: f64,
    /// Viscous friction, N·m·s/rad.
    pub viscous: f64,
    /// Dry friction.
    pub friction: FrictionConfig,
    /// Weight of the load.
    pub gravity: Gravity,
    /// Buffers at the ends of travel, if there are any.
    pub end_stops: Option<EndStops>,
    /// Thermal model.
    pub thermal: ThermalConfig,
    /// Random share of the motor's torque, drawn anew each millisecond.
    pub torque_ripple: f64,
}

/// The load's weight as a torque on the motor: `amplitude · cos(angle / ratio + phase)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// Amplitude at the motor, N·m.
    pub amplitude: f64,
    /// Motor angle per joint angle, negative if they turn in opposite directions.
    pub ratio: f64,
    /// Joint angle at which the motor reads zero, rad, measured from the pose of the greatest torque.
    pub phase: f64,
}

impl Gravity {
    /// A balanced load.
    pub const NONE: Self = Self { amplitude: 0.0, ratio: 1.0, phase: 0.0 };

    /// Torque on the motor at `angle`, rad.
    pub fn torque(&self, angle: f64) -> f64 {
        self.amplitude * (angle / self.ratio + self.phase).cos()
    }
}

/// Buffers beyond the ends of travel. Buffers push back and never pull.
///
/// The integration stays stable for a stiffness below `inertia / SUB_STEP²`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndStops {
    /// Motor angle at which the negative buffer is touched, rad.
    pub negative: f64,
    /// Motor angle at which the positive buffer is touched, rad.
    pub positive: f64,
    /// Stiffness at the motor, N·m/rad.
    pub stiffness: f64,
    /// Damping at the motor, N·m·s/rad.
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

/// Sub-steps between updates of gravity and ripple: 1 ms. At 250 rad/s and a gear of 130 the joint turns 2 mrad in
/// that time.
const MEDIUM: u32 = 10;
/// Sub-steps between updates of temperatures and the values that depend on them: 100 ms. The thermal time constant is
/// about 60 s.
const SLOW: u32 = 1000;
/// Relative increase of the resistance of copper, 1/K.
const COPPER: f64 = 0.0039;
/// Relative decrease of the flux of ferrite magnets, 1/K.
const FERRITE: f64 = 0.002;

/// State of the motor: windings, shaft and temperatures.
#[derive(Clone, Debug)]
pub(crate) struct Motor {
    config: MotorConfig,
    /// Mount of the motor, if any, and the last load at the mount.
    mounted: Option<(Mount, Loaded)>,
    /// Mount of the motor on a robot with coupled dynamics.
    coupled: Option<Mount>,
    friction: Friction,
    pub(super) thermal: Thermal,
    noise: Noise,
    /// Angle, rad.
    pub(super) angle: f64,
    pub(super) velocity: f64,
    /// Current, A.
    pub(super) current: f64,
    /// Sub-step over inertia.
    gain: f64,
    sub_step: u32,
    /// Sum of i² since the last slow update.
    heat: f64,
    gravity: f64,
    torque_constant: f64,
    torque_per_current: f64,
    conductance: f64,
    /// Remaining share of a current deviation after one sub-step, exp(-R dt / L).
    decay: f64,
}

impl Motor {
    /// A cold motor at standstill at `angle`, rad.
    pub(crate) fn new(config: &MotorConfig, mount: Option<&Mount>, angle: f64, noise: Noise) -> Self {
        let (coupled, mount) = if mount.is_some_and(Mount::release) { (mount, None) } else { (None, mount) };
        Self {
            config: *config,
            mounted: mount.map(|mount| (mount.clone(), mount.load(angle))),
            coupled: coupled.cloned(),
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

    /// One sub-step under a voltage, V. `None` means that the power stage is off, which ends the current at once. A
    /// brake resists by up to `brake` N·m. `outer` is the torque that forces on the robot cause at the motor, N·m.
    ///
    /// The current follows the exact solution of `L di/dt = V - R i - Ke w` at constant speed. The shaft follows
    /// semi-implicit Euler with friction by [`Friction::apply`].
    pub(crate) fn step(&mut self, voltage: Option<f64>, brake: f64, outer: f64) {
        if self.sub_step.is_multiple_of(MEDIUM) {
            self.update();
        }
        self.sub_step = (self.sub_step + 1) % SLOW;
        if let Some(motor) = self.coupled.as_ref().and_then(Mount::begin) {
            (self.velocity, self.gravity, self.gain) = (motor.velocity, motor.weight, SUB_STEP * motor.mobility);
        }
        let before = self.velocity;
        self.current = voltage.map_or(0.0, |voltage| {
            let settled = (voltage - self.torque_constant * self.velocity) * self.conductance;
            settled + (self.current - settled) * self.decay
        });
        self.heat += self.current * self.current;
        let mut torque = self.torque_per_current * self.current + self.gravity - self.config.viscous * self.velocity;
        torque += outer;
        if let Some(stops) = &self.config.end_stops {
            torque += stops.torque(self.angle, self.velocity);
        }
        let free = self.velocity + torque * self.gain;
        self.velocity = self.friction.apply(self.velocity, free, self.gain, brake);
        self.angle += self.velocity * SUB_STEP;
        if let Some(mount) = &self.coupled {
            mount.end(self.velocity - before, self.angle);
        }
    }

    /// Replaces the buffers at the ends of travel, and returns the previous ones.
    pub(super) fn set_buffers(&mut self, buffers: Option<EndStops>) -> Option<EndStops> {
        std::mem::replace(&mut self.config.end_stops, buffers)
    }

    /// The damping, N·m·s/rad, with which the motor comes off a spring without an oscillation.
    pub(super) fn critical_damping(&self, stiffness: f64) -> f64 {
        2.0 * (stiffness * self.config.inertia).sqrt()
    }

    /// Reverses torque and back-EMF, as two swapped phases do.
    pub(super) fn reverse(&mut self) {
        self.config.torque_constant = -self.config.torque_constant;
        self.torque_constant = -self.torque_constant;
        self.torque_per_current = -self.torque_per_current;
    }

    /// Updates the quantities that change slowly and need expensive functions.
    fn update(&mut self) {
        if self.sub_step == 0 {
            let seconds = f64::from(SLOW) * SUB_STEP;
            let resistance = self.config.resistance * (1.0 + COPPER * (self.thermal.winding - 25.0));
            self.thermal.step(resistance * self.heat / f64::from(SLOW), seconds);
            self.heat = 0.0;
            self.conductance = 1.0 / resistance;
            self.decay = (-resistance * SUB_STEP / self.config.inductance).exp();
            self.torque_constant = self.config.torque_constant * (1.0 - FERRITE * (self.thermal.housing - 25.0));
        }
        self.gravity = match &mut self.mounted {
            None => self.config.gravity.torque(self.angle),
            Some((mount, last)) => {
                let next = mount.load(self.angle);
                self.velocity *= last.slows_by(&next);
                self.gain = SUB_STEP / next.inertia();
                *last = next;
                next.links.torque
            }
        };
        let ripple =
            if self.config.torque_ripple > 0.0 { self.config.torque_ripple * self.noise.symmetric() } else { 0.0 };
        self.torque_per_current = self.torque_constant * (1.0 + ripple);
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

    use super::{EndStops, Gravity, Motor, MotorConfig};
    use crate::plant::{FrictionConfig, Noise, SUB_STEP, ThermalConfig};

    const CONFIG: MotorConfig = MotorConfig {
        torque_constant: 0.105,
        resistance: 0.6,
        inductance: 0.5e-3,
        inertia: 4e-4,
        viscous: 1e-3,
        friction: FrictionConfig { coulomb: 0.08, stiction: 0.08, stribeck_velocity: 5.0 },
        gravity: Gravity::NONE,
        end_stops: None,
        thermal: ThermalConfig {
            winding_to_housing: 1.0,
            housing_to_air: 2.0,
            winding_capacity: 60.0,
            housing_capacity: 800.0,
            air: 25.0,
            trip: 155.0,
        },
        torque_ripple: 0.0,
    };

    fn motor(config: &MotorConfig, velocity: f64) -> Motor {
        Motor { velocity, ..Motor::new(config, None, 0.0, Noise::new(1)) }
    }

    #[test]
    fn blocked_winding_rises_with_inductance_over_resistance() {
        let mut motor = motor(&CONFIG, 0.0);
        for k in 1..=50 {
            motor.step(Some(6.0), 100.0, 0.0);
            let exact = 10.0 * (1.0 - (-0.6 * SUB_STEP * f64::from(k) / 0.5e-3).exp());
            assert!((motor.current - exact).abs() < 1e-9, "{} A for {exact}", motor.current);
        }
    }

    #[test]
    fn unloaded_motor_runs_at_voltage_over_back_emf() {
        let config = MotorConfig { viscous: 0.0, friction: FrictionConfig::NONE, ..CONFIG };
        let mut motor = motor(&config, 0.0);
        for _ in 0..20_000 {
            motor.step(Some(35.8), 0.0, 0.0);
        }
        assert!((motor.velocity - 341.0).abs() < 0.1, "{} rad/s", motor.velocity);
    }

    #[test]
    fn coasting_follows_its_closed_form_to_standstill() {
        let mut motor = motor(&CONFIG, 50.0);
        let tau = CONFIG.inertia / CONFIG.viscous;
        let sag = CONFIG.friction.coulomb / CONFIG.viscous;
        let rest = tau * (1.0 + 50.0 / sag).ln();
        for k in 1..4_000 {
            let before = motor.velocity;
            motor.step(None, 0.0, 0.0);
            assert!(motor.velocity <= before, "gains speed at {k}");
            let t = f64::from(k) * SUB_STEP;
            let exact = if t < rest { (50.0 + sag) * (-t / tau).exp() - sag } else { 0.0 };
            assert!((motor.velocity - exact).abs() < 0.05, "at {t}: {} for {exact}", motor.velocity);
        }
        assert_eq!(motor.velocity, 0.0);
    }

    #[test]
    fn energy_that_goes_in_is_stored_or_lost() {
        let mut motor = motor(&CONFIG, 0.0);
        let (mut supplied, mut lost) = (0.0, 0.0);
        for _ in 0..3_000 {
            let (current, velocity) = (motor.current, motor.velocity);
            motor.step(Some(12.0), 0.0, 0.0);
            let (i, w) = (0.5 * (current + motor.current), 0.5 * (velocity + motor.velocity));
            supplied += 12.0 * i * SUB_STEP;
            lost += (0.6 * i * i + 1e-3 * w * w + 0.08 * w.abs()) * SUB_STEP;
        }
        let stored = 0.5 * 4e-4 * motor.velocity.powi(2) + 0.5 * 0.5e-3 * motor.current.powi(2);
        assert!(supplied > 3.0, "{supplied} J");
        assert!((supplied - lost - stored).abs() < 0.01 * supplied, "{supplied} J in, {lost} lost, {stored} stored");
    }

    #[test]
    fn weight_follows_the_joint() {
        // A horizontal arm at motor angle 0, which hangs down after a quarter turn of the joint.
        let gravity = Gravity { amplitude: 0.5, ratio: 100.0, phase: 0.0 };
        let cases = [(0.0, 0.5), (100.0 * FRAC_PI_3, 0.25), (100.0 * FRAC_PI_2, 0.0), (100.0 * PI, -0.5)];
        for (angle, torque) in cases {
            assert!((gravity.torque(angle) - torque).abs() < 1e-12, "at {angle}");
        }
    }

    #[test]
    fn warm_motor_resists_more_and_pulls_less() {
        let mut motor = motor(&CONFIG, 0.0);
        for _ in 0..2_000_000 {
            motor.step(Some(6.0), 100.0, 0.0);
        }
        let (winding, housing) = (motor.thermal.winding - 25.0, motor.thermal.housing - 25.0);
        assert!(winding > 50.0 && housing > 8.0, "{winding} K, {housing} K");
        let current = 10.0 / (1.0 + 0.0039 * winding);
        assert!((motor.current - current).abs() < 0.01, "{} A", motor.current);
        let torque = 0.105 * (1.0 - 0.002 * housing) * motor.current;
        let found = motor.torque_per_current * motor.current;
        assert!((found - torque).abs() < 1e-3 * torque, "{found} N·m for {torque}");
    }

    #[test]
    fn buffers_push_back_and_never_pull() {
        let stops = EndStops { negative: -1.0, positive: 2.0, stiffness: 50.0, damping: 0.1 };
        let cases = [
            (0.0, 10.0, 0.0),
            (-1.1, 0.0, 5.0),
            (-1.1, -10.0, 6.0),
            (-1.1, 100.0, 0.0),
            (2.1, 0.0, -5.0),
            (2.1, 10.0, -6.0),
            (2.1, -100.0, 0.0),
        ];
        for (angle, velocity, torque) in cases {
            let found = stops.torque(angle, velocity);
            assert!((found - torque).abs() < 1e-9, "{found} at {angle}, {velocity}");
        }
    }
}
