//! Scale between increments of a drive and radians of the motor.

use std::f64::consts::TAU;

/// Revolutions per minute per radian per second: 60 s over 2π rad.
const RPM: f64 = 60.0 / TAU;

/// A position in the drive's unit: quadrature counts of its encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Increments(pub i32);

/// A velocity in the unit of an EPOS4 with the default of object 0x60A9: revolutions of the motor per minute, positive
/// towards a rising counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Rpm(pub(crate) i32);

/// A torque in the unit of CiA 402-2 §15.5.1: thousandths of the motor's rated torque, positive towards a rising
/// counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Permille(pub(crate) i16);

/// A motor current in the unit of an axis controller, mA, positive towards a rising counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Milliamperes(pub(crate) i16);

/// A pulse width in the unit of an axis controller: thousandths, positive towards a rising counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct PulseWidth(pub(crate) i16);

/// Converts motor positions, velocities, torques and duties to the units of a device and back. No other place converts
/// them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    increments_per_radian: f64,
    home_position: f64,
}

impl Scale {
    /// A scale, or `None` for zero counts or a number that is not finite. `counts_per_revolution` are quadrature
    /// counts per motor turn, negative if the count falls while the motor turns in its positive direction.
    /// `home_position` is the motor position, rad, at which the homed counter reads zero.
    pub fn new(counts_per_revolution: i32, home_position: f64) -> Option<Self> {
        (counts_per_revolution != 0 && home_position.is_finite())
            .then(|| Self { increments_per_radian: f64::from(counts_per_revolution) / TAU, home_position })
    }

    /// Motor position, rad.
    pub fn position(&self, increments: Increments) -> f64 {
        f64::from(increments.0) / self.increments_per_radian + self.home_position
    }

    /// The nearest count; `None` beyond the 32 bits of the counter.
    pub fn increments(&self, position: f64) -> Option<Increments> {
        nearest_i32((position - self.home_position) * self.increments_per_radian).map(Increments)
    }

    /// Increments per radian of motor rotation, signed.
    pub fn increments_per_radian(&self) -> f64 {
        self.increments_per_radian
    }

    /// The device velocity nearest to `velocity`, rad/s; `None` beyond 32 bits.
    ///
    /// A device velocity counts turns instead of increments, but has the sign of the counter.
    pub(crate) fn rpm(&self, velocity: f64) -> Option<Rpm> {
        nearest_i32(velocity * RPM * self.increments_per_radian.signum()).map(Rpm)
    }

    /// The device torque nearest to `torque`, N·m, for a motor of `rated_torque`, N·m; `None` beyond 16 bits.
    pub(crate) fn permille(&self, torque: f64, rated_torque: f64) -> Option<Permille> {
        let permille = torque / rated_torque * 1_000.0 * self.increments_per_radian.signum();
        nearest_i32(permille).and_then(|n| i16::try_from(n).ok()).map(Permille)
    }

    /// Motor torque, N·m, of a motor of `rated_torque`, N·m.
    pub(crate) fn torque(&self, permille: Permille, rated_torque: f64) -> f64 {
        f64::from(permille.0) / 1_000.0 * rated_torque * self.increments_per_radian.signum()
    }

    /// The nearest current for `torque`, N·m, of a motor of `torque_constant`, N·m/A; `None` beyond 16 bits.
    pub(crate) fn milliamperes(&self, torque: f64, torque_constant: f64) -> Option<Milliamperes> {
        let current = torque / torque_constant * self.increments_per_radian.signum();
        nearest_i32(current * 1_000.0).and_then(|n| i16::try_from(n).ok()).map(Milliamperes)
    }

    /// Motor torque, N·m, of a current in a motor of `torque_constant`, N·m/A.
    pub(crate) fn torque_of(&self, current: Milliamperes, torque_constant: f64) -> f64 {
        f64::from(current.0) / 1_000.0 * torque_constant * self.increments_per_radian.signum()
    }

    /// The pulse width nearest to `duty`, -1 to 1; `None` beyond.
    pub(crate) fn pulse_width(&self, duty: f64) -> Option<PulseWidth> {
        (-1.0..=1.0)
            .contains(&duty)
            .then(|| PulseWidth((duty * 1_000.0 * self.increments_per_radian.signum()).round() as i16))
    }

    /// The number of increments in `distance`, rad, regardless of direction; `None` beyond 32 bits.
    pub(crate) fn distance(&self, distance: f64) -> Option<u32> {
        nearest_u32((distance * self.increments_per_radian).abs())
    }
}

/// Converts a speed, rad/s, to rpm, or an acceleration, rad/s², to rpm/s: both by the factor 60 / 2π. `None` if the
/// value is negative or exceeds 32 bits.
pub(crate) fn rpm_magnitude(value: f64) -> Option<u32> {
    nearest_u32(value * RPM)
}

fn nearest_i32(value: f64) -> Option<i32> {
    let nearest = value.round();
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&nearest).then_some(nearest as i32)
}

fn nearest_u32(value: f64) -> Option<u32> {
    let nearest = value.round();
    (0.0..=f64::from(u32::MAX)).contains(&nearest).then_some(nearest as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One scale of 2000 counts per turn rising with the motor, and one falling against the motor, with home at 1 rad.
    fn scales() -> (Scale, Scale) {
        (Scale::new(2_000, 0.0).unwrap(), Scale::new(-2_000, 1.0).unwrap())
    }

    #[test]
    fn a_turn_is_its_counts_and_the_sign_is_the_counters() {
        let (rising, falling) = scales();
        assert_eq!(rising.increments(TAU), Some(Increments(2_000)));
        assert_eq!(falling.increments(1.0 + TAU), Some(Increments(-2_000)));
        assert_eq!(falling.position(Increments(-2_000)), 1.0 + TAU);
        assert_eq!(rising.rpm(TAU), Some(Rpm(60)));
        assert_eq!(falling.rpm(TAU), Some(Rpm(-60)));
        assert_eq!(rising.permille(0.05, 0.1), Some(Permille(500)));
        assert_eq!(falling.permille(0.05, 0.1), Some(Permille(-500)));
        assert_eq!(falling.torque(Permille(-500), 0.1), 0.05);
        assert_eq!(falling.distance(TAU), Some(2_000));
        assert_eq!(rpm_magnitude(TAU), Some(60));
    }

    #[test]
    fn currents_and_pulse_widths_have_the_sign_of_the_counter() {
        let (rising, falling) = scales();
        assert_eq!(rising.milliamperes(0.105, 0.105), Some(Milliamperes(1_000)));
        assert_eq!(falling.milliamperes(0.105, 0.105), Some(Milliamperes(-1_000)));
        assert_eq!(falling.torque_of(Milliamperes(-2_000), 0.105), 0.21);
        assert_eq!(rising.pulse_width(-1.0), Some(PulseWidth(-1_000)));
        assert_eq!(falling.pulse_width(0.7451), Some(PulseWidth(-745)));
    }

    #[test]
    fn what_does_not_fit_is_refused_not_wrapped() {
        let (rising, _) = scales();
        let furthest = rising.position(Increments(i32::MAX));
        assert_eq!(rising.increments(furthest), Some(Increments(i32::MAX)));
        assert_eq!(rising.increments(furthest + 0.01), None);
        assert_eq!(rising.increments(f64::NAN), None);
        assert_eq!(rising.rpm(3e8), None);
        assert_eq!(rising.permille(3.3, 0.1), None);
        assert_eq!(rising.milliamperes(3.45, 0.105), None);
        assert_eq!(rising.milliamperes(f64::NAN, 0.105), None);
        assert_eq!(rising.pulse_width(1.0001), None);
        assert_eq!(rising.pulse_width(f64::NAN), None);
        assert_eq!(rpm_magnitude(-1.0), None);
        assert_eq!(Scale::new(0, 0.0), None);
        assert_eq!(Scale::new(1, f64::INFINITY), None);
    }
}
