use std::f64::consts::TAU;

/// A position as the drive counts it: quadrature counts of its encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Increments(pub i32);

/// Turns motor positions into increments and back: the only place that does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    increments_per_radian: f64,
    home_position: f64,
}

impl Scale {
    /// `counts_per_revolution` are quadrature counts of one motor turn, negative if they fall while
    /// the motor turns in its positive direction; `home_position` is the motor position, rad, at
    /// which the homed counter reads zero. `None` for zero counts or a number that is not finite.
    pub fn new(counts_per_revolution: i32, home_position: f64) -> Option<Self> {
        (counts_per_revolution != 0 && home_position.is_finite()).then(|| Self {
            increments_per_radian: f64::from(counts_per_revolution) / TAU,
            home_position,
        })
    }

    /// Motor position, rad.
    pub fn position(&self, increments: Increments) -> f64 {
        f64::from(increments.0) / self.increments_per_radian + self.home_position
    }

    /// The nearest count; saturates at the ends of `i32`.
    pub fn increments(&self, position: f64) -> Increments {
        Increments(((position - self.home_position) * self.increments_per_radian).round() as i32)
    }

    /// Increments per radian of motor rotation, signed.
    pub fn increments_per_radian(&self) -> f64 {
        self.increments_per_radian
    }
}
