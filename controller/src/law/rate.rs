//! Approach of a direction under a speed override.

/// Force, relative to the force in which the approach ends, up to which a direction counts as in free space. The offset of
/// a sensor and the residual of its compensation are below.
const FREE: f64 = 0.25;

/// Force, relative to the force in which the approach ends, from which a direction counts as in contact.
const CONTACT: f64 = 0.5;

/// Velocity of a direction at a rate of motion time, 0 to 1: `approach` is its velocity in free space at the full rate,
/// and `yielding` the velocity that forces add. For laws of other crates, which read the rate from
/// [`LawInput::rate`](servo::LawInput::rate). All velocities are in m/s or rad/s.
///
/// In free space, the velocity is `rate · approach`, and 0 in a pause. A direction counts as in free space while the
/// velocity that forces add is at most a quarter of the approach, so that the residual of a sensor moves no arm in a pause.
/// From half of the approach on, the direction yields in full. If the force opposes the approach, the velocity is
/// `approach + yielding` at every rate from two fifths of the approach on. A direction whose force ends the approach
/// therefore reaches and keeps this force at every rate, and in a pause.
///
/// A law that limits the change of its velocity also limits the change by the rate.
///
/// ```
/// use mrroc_controller::law::velocity_at_rate;
///
/// assert!((velocity_at_rate(0.05, 0.0, 0.25) - 0.0125).abs() < 1e-12);
/// assert_eq!(velocity_at_rate(0.05, 0.0, 0.0), 0.0);
/// // In contact, and pushed back.
/// assert_eq!(velocity_at_rate(0.05, -0.04, 0.0), 0.05 - 0.04);
/// assert_eq!(velocity_at_rate(0.05, -0.2, 0.0), 0.05 - 0.2);
/// ```
pub fn velocity_at_rate(approach: f64, yielding: f64, rate: f64) -> f64 {
    approach + yielding - withheld(approach, yielding, yielding, rate)
}

/// Part of `approach + yielding` that a direction leaves out at a rate of motion time. `contact`: the part of `yielding` by the
/// force of a contact.
pub(super) fn withheld(approach: f64, yielding: f64, contact: f64, rate: f64) -> f64 {
    if rate >= 1.0 || approach == 0.0 {
        return 0.0;
    }
    let (speed, sign) = (approach.abs(), approach.signum());
    let lost = 1.0 - rate.max(0.0);
    let free = |force: f64| 1.0 - ((force - FREE) / (CONTACT - FREE)).clamp(0.0, 1.0);
    let force = -contact * sign / speed;
    let pull = (-force).max(0.0);
    // The part of the approach that only compensates an opposed yielding is no motion.
    let opposed = (-yielding * sign).max(0.0);
    sign * ((speed * lost * free(force) - opposed).max(0.0) + speed * lost * pull * free(pull))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Velocity of an approach at 1 m/s, at a force relative to the force in which the approach ends.
    fn at(force: f64, rate: f64) -> f64 {
        let [one, other] = [1.0, -1.0].map(|sign| sign * velocity_at_rate(sign, -sign * force, rate));
        assert_eq!(one, other, "force {force}, rate {rate}");
        one
    }

    #[test]
    fn the_rate_slows_an_approach_in_free_space_and_neither_yielding_nor_the_force_in_contact() {
        for rate in [0.0, 0.1, 0.25, 0.5, 0.9] {
            assert!((at(0.0, rate) - rate).abs() < 1e-15);
            // A residual of the sensor does not move the direction beyond the rate.
            for residual in [0.0, 0.1, 0.2, 0.25] {
                assert!((at(residual, rate) - rate.min(1.0 - residual)).abs() < 1e-15, "{rate} {residual}");
            }
            // In contact, and pushed back.
            for force in [0.4, 0.5, 0.9, 1.0, 1.1, 3.0, 50.0] {
                assert_eq!(at(force, rate), 1.0 - force, "{rate}");
            }
            // Pulled along the approach.
            for force in [-0.5, -1.0, -20.0] {
                assert!((at(force, rate) - (rate - force)).abs() < 1e-12, "{rate} {force}");
            }
            for residual in [-0.01, -0.1, -0.25] {
                assert!((at(residual, rate) - rate * (1.0 - residual)).abs() < 1e-12, "{rate} {residual}");
            }
            // No step of the velocity over the force, and never faster than at the full rate.
            for k in 0..3000 {
                let force = -1.0 + f64::from(k) * 1e-3;
                let [here, next] = [force, force + 1e-3].map(|force| at(force, rate));
                assert!((next - here).abs() < 4.1e-3, "{rate} {force}");
                assert!(here <= at(force, 1.0) + 1e-15, "{rate} {force}");
            }
        }
    }

    #[test]
    fn a_direction_without_approach_has_the_same_velocity_at_every_rate() {
        for rate in [0.0, 0.25, 1.0] {
            for yielding in [-2.0, -0.1, 0.0, 0.3] {
                assert_eq!(velocity_at_rate(0.0, yielding, rate), yielding);
                assert_eq!(velocity_at_rate(0.7, yielding, 1.0), 0.7 + yielding);
            }
        }
    }
}
