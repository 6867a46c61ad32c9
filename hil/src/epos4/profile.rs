//! Trapezoidal motion, computed step by step, so that limits and targets may change during the motion.

/// Limits of a profile, in counts and seconds. All values are above zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Limits {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) deceleration: f64,
}

/// State of a profile: counts and counts/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Motion {
    pub(super) position: f64,
    pub(super) velocity: f64,
}

impl Motion {
    /// Standstill at `position`.
    pub(super) const fn at(position: f64) -> Self {
        Self { position, velocity: 0.0 }
    }

    /// One step of `dt` towards standstill at `target`. Returns whether the target is reached.
    pub(super) fn approach(&mut self, target: f64, limits: &Limits, dt: f64) -> bool {
        let way = target - self.position;
        let braking = limits.deceleration * dt;
        let last_step = self.velocity.abs() * dt + 0.5 * braking * dt + 1e-6;
        if way.abs() <= last_step && self.velocity.abs() <= braking {
            *self = Self::at(target);
            return true;
        }
        // The largest velocity w after this step from which braking still ends at the target, with the distance s:
        // w²/2a + (v + w) dt/2 = s.
        let sign = way.signum();
        let rest = (way.abs() - 0.5 * sign * self.velocity * dt).max(0.0);
        let fastest = limits.deceleration * ((0.25 * dt * dt + 2.0 * rest / limits.deceleration).sqrt() - 0.5 * dt);
        self.ramp(sign * fastest.min(limits.velocity), limits, dt);
        false
    }

    /// One step of `dt` towards a velocity. Returns whether the velocity is reached.
    pub(super) fn ramp(&mut self, velocity: f64, limits: &Limits, dt: f64) -> bool {
        let slowing = self.velocity * velocity < 0.0 || velocity.abs() < self.velocity.abs();
        let rate = if slowing { limits.deceleration } else { limits.acceleration };
        let change = (velocity - self.velocity).clamp(-rate * dt, rate * dt);
        self.position += (self.velocity + 0.5 * change) * dt;
        self.velocity += change;
        self.velocity == velocity
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;

    #[test]
    fn every_profile_reaches_its_target_within_its_limits() {
        let limits = Limits { velocity: 5_000.0, acceleration: 20_000.0, deceleration: 30_000.0 };
        let starts = [(0.0, 0.0), (0.0, 3_000.0), (0.0, -4_000.0)];
        for (position, velocity) in starts {
            for target in [0.0, 0.4, 3.0, -7.0, 250.0, 9_999.5, -40_000.0] {
                let mut motion = Motion { position, velocity };
                let mut steps = 0;
                loop {
                    let before = motion;
                    let there = motion.approach(target, &limits, DT);
                    let rise = (motion.velocity - before.velocity).abs() / DT;
                    assert!(rise <= limits.deceleration + 1e-6, "{target}: {rise}");
                    assert!(motion.velocity.abs() <= limits.velocity + 1e-6);
                    if there {
                        break;
                    }
                    steps += 1;
                    assert!(steps < 20_000, "{velocity} never reaches {target}");
                }
                assert_eq!(motion, Motion::at(target));
            }
        }
    }

    #[test]
    fn a_long_move_takes_the_time_of_its_trapezoid() {
        let limits = Limits { velocity: 5_000.0, acceleration: 20_000.0, deceleration: 30_000.0 };
        let mut motion = Motion::default();
        let mut steps = 0.0;
        while !motion.approach(20_000.0, &limits, DT) {
            steps += 1.0;
        }
        // Each ramp adds half its duration to the 4 s at full speed.
        let expected = 4.0 + 0.5 * (5.0 / 20.0 + 5.0 / 30.0);
        assert!((steps * DT - expected).abs() < 3.0 * DT, "{}", steps * DT);
    }
}
