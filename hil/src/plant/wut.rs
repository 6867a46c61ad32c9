//! Motor model of the original IRp-6 software.

use super::friction::{Friction, FrictionConfig};

/// The motor model in the hardware emulation of the IRp-6 software of the Warsaw University of Technology. Current
/// causes torque, and viscous friction resists. The model has no other effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WutConfig {
    /// Torque per current, N·m/A.
    pub torque_constant: f64,
    /// Inertia, kg·m².
    pub inertia: f64,
    /// Viscous friction, N·m·s/rad.
    pub viscous: f64,
    /// Dry friction. The original model has none.
    pub friction: FrictionConfig,
    /// Resistance of the winding, Ω. The original model has no winding and therefore no pulse widths. Under
    /// [`Demand::Duty`] the current follows at once: (voltage - torque_constant · w) / resistance. No other demand
    /// uses the resistance.
    ///
    /// [`Demand::Duty`]: super::Demand::Duty
    pub resistance: f64,
}

/// The regression model: `dw/dt = (torque_constant · current - viscous · w) / inertia`.
///
/// Semi-implicit Euler: velocity first, then angle with the new velocity. The original takes one step per servo
/// period of 2 ms, after the current of that period was computed from the encoder. The encoder count is the floor of
/// angle · counts / 2π.
#[derive(Clone, Debug)]
pub struct Wut {
    config: WutConfig,
    friction: Friction,
    /// Angle, rad.
    pub angle: f64,
    /// Velocity, rad/s.
    pub velocity: f64,
}

impl Wut {
    /// A motor at standstill at `angle`, rad.
    pub fn new(config: &WutConfig, angle: f64) -> Self {
        Self { config: *config, friction: Friction::new(&config.friction), angle, velocity: 0.0 }
    }

    /// Integrates one step of `dt` seconds under a constant current, A, with a brake that resists by up to `brake` N·m.
    pub fn step(&mut self, current: f64, dt: f64, brake: f64) {
        let torque = self.config.torque_constant * current - self.config.viscous * self.velocity;
        let gain = dt / self.config.inertia;
        self.velocity = self.friction.apply(self.velocity, self.velocity + torque * gain, gain, brake);
        self.angle += self.velocity * dt;
    }

    /// Reverses torque and back-EMF, as two swapped phases do.
    pub(super) fn reverse(&mut self) {
        self.config.torque_constant = -self.config.torque_constant;
    }

    /// The current that a voltage drives at the present speed, A.
    pub(crate) fn static_current(&self, voltage: f64) -> f64 {
        (voltage - self.config.torque_constant * self.velocity) / self.config.resistance
    }
}

#[cfg(test)]
mod tests {
    use super::{Wut, WutConfig};
    use crate::plant::FrictionConfig;

    const COLUMN: WutConfig = WutConfig {
        torque_constant: 0.105,
        inertia: 1.5e-4,
        viscous: 0.02,
        friction: FrictionConfig::NONE,
        resistance: 0.6,
    };

    fn spun_up(config: &WutConfig, current: f64) -> Wut {
        let mut wut = Wut::new(config, 0.0);
        for _ in 0..20_000 {
            wut.step(current, 1e-4, 0.0);
        }
        wut
    }

    #[test]
    fn current_and_viscous_friction_settle_at_their_balance() {
        let wut = spun_up(&COLUMN, 10.0);
        assert!((wut.velocity - 52.5).abs() < 1e-9, "{}", wut.velocity);
    }

    #[test]
    fn coasting_slows_with_inertia_over_viscous_friction() {
        let mut wut = spun_up(&COLUMN, 10.0);
        let mut steps = 0;
        while wut.velocity > 52.5 / std::f64::consts::E {
            wut.step(0.0, 1e-5, 0.0);
            steps += 1;
        }
        assert!((f64::from(steps) * 1e-5 - 7.5e-3).abs() < 2e-5, "{steps} steps of 10 µs");
    }

    #[test]
    fn dry_friction_brings_it_to_rest_for_good() {
        let friction = FrictionConfig { coulomb: 0.1, stiction: 0.15, stribeck_velocity: 5.0 };
        let mut wut = spun_up(&WutConfig { friction, ..COLUMN }, 10.0);
        for _ in 0..10_000 {
            wut.step(0.0, 1e-4, 0.0);
        }
        let angle = wut.angle;
        for _ in 0..10_000 {
            wut.step(1.4, 1e-4, 0.0);
        }
        assert_eq!((wut.velocity, wut.angle), (0.0, angle), "0.147 N·m is below stiction");
    }
}
