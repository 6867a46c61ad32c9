//! Dry friction with break-away.

/// Dry friction of a motor and its gear, at the motor shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionConfig {
    /// Friction torque when sliding fast, N·m.
    pub coulomb: f64,
    /// Friction torque at standstill, N·m, at least `coulomb`.
    pub stiction: f64,
    /// Speed at which the friction torque falls from `stiction` to `coulomb`, rad/s.
    pub stribeck_velocity: f64,
}

impl FrictionConfig {
    /// No dry friction.
    pub const NONE: Self = Self { coulomb: 0.0, stiction: 0.0, stribeck_velocity: 1.0 };
}

/// Entries per Stribeck velocity. The error of linear interpolation is then within 0.1 % of the excess over
/// `coulomb`.
const ENTRIES_PER_UNIT: usize = 16;
/// Beyond four Stribeck velocities exp(-x²) is 1e-7 and counts as zero.
const ENTRIES: usize = 4 * ENTRIES_PER_UNIT + 1;

/// Coulomb friction with the Stribeck curve `Tc + (Ts - Tc) exp(-(w / ws)²)`, tabulated. Sticking follows Karnopp: at
/// standstill, friction balances the applied torque up to the friction level.
#[derive(Clone, Debug)]
pub(crate) struct Friction {
    coulomb: f64,
    entries_per_velocity: f64,
    excess: [f64; ENTRIES],
}

impl Friction {
    pub(crate) fn new(config: &FrictionConfig) -> Self {
        let step = 1.0 / ENTRIES_PER_UNIT as f64;
        let excess = std::array::from_fn(|i| {
            let x = i as f64 * step;
            (config.stiction - config.coulomb) * (-x * x).exp()
        });
        Self {
            coulomb: config.coulomb,
            entries_per_velocity: ENTRIES_PER_UNIT as f64 / config.stribeck_velocity,
            excess,
        }
    }

    /// Maximum friction torque at a speed, N·m.
    fn level(&self, speed: f64) -> f64 {
        let x = speed * self.entries_per_velocity;
        if x >= (ENTRIES - 1) as f64 {
            return self.coulomb;
        }
        let i = x as usize;
        let (low, high) = (self.excess[i], self.excess[i + 1]);
        self.coulomb + low + (x - i as f64) * (high - low)
    }

    /// Velocity at the end of a step. `before` is the velocity at the beginning. `free` is the velocity that all
    /// other torques would lead to. `gain` is step over inertia. `extra` adds to the friction level, N·m.
    ///
    /// Friction reduces velocity and never reverses it. If friction can more than stop the motor, the motor stops.
    /// The motor then stays at standstill until the torque exceeds the break-away level.
    pub(crate) fn apply(&self, before: f64, free: f64, gain: f64, extra: f64) -> f64 {
        let most = (self.level(before.abs()) + extra) * gain;
        if free.abs() <= most { 0.0 } else { free - most.copysign(free) }
    }
}

#[cfg(test)]
mod tests {
    use super::{Friction, FrictionConfig};

    const CONFIG: FrictionConfig = FrictionConfig { coulomb: 0.08, stiction: 0.12, stribeck_velocity: 5.0 };

    #[test]
    fn level_is_the_stribeck_curve() {
        let friction = Friction::new(&CONFIG);
        for i in 0..1000 {
            let w = f64::from(i) * 0.03;
            let exact = 0.08 + 0.04 * (-(w / 5.0) * (w / 5.0)).exp();
            let level = friction.level(w);
            assert!((level - exact).abs() < 5e-5, "at {w}: {level} for {exact}");
        }
    }

    #[test]
    fn standing_shaft_moves_only_beyond_stiction() {
        let friction = Friction::new(&CONFIG);
        let gain = 0.25;
        let cases = [(0.119, 0.0), (-0.119, 0.0), (0.13, 0.01), (-0.13, -0.01)];
        for (torque, over) in cases {
            let velocity = friction.apply(0.0, torque * gain, gain, 0.0);
            assert!((velocity - over * gain).abs() < 1e-12, "{torque} N·m gives {velocity}");
        }
        assert_eq!(friction.apply(0.0, 1.0 * gain, gain, 1.0), 0.0, "a brake adds to it");
    }

    #[test]
    fn friction_never_reverses_a_motion() {
        let friction = Friction::new(&CONFIG);
        assert_eq!(friction.apply(1e-6, 1e-6, 0.25, 0.0), 0.0);
        assert_eq!(friction.apply(-1e-6, -1e-6, 0.25, 0.0), 0.0);
    }
}
