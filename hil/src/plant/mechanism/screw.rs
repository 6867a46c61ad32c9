//! A ball screw across a triangle, which drives the lower or the upper arm of the IRp-6.

use std::f64::consts::TAU;

/// Greatest magnitude of the cosine of the angle between crank and pivot.
const STRETCHED: f64 = 0.999;

/// The nut pulls on a crank. The other end of the screw turns about a pivot beside the axis of the crank.
///
/// The sides of the triangle are the crank, the line between axis and pivot, and the screw. The length of the screw
/// follows from the opposite angle, which grows with the joint angle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Screw {
    /// Sum of the squares of crank length and distance from axis to pivot, m².
    squares: f64,
    /// Product of crank length and distance from axis to pivot, m².
    product: f64,
    /// Motor angle per screw length, rad/m.
    per_length: f64,
    /// Angle of the triangle opposite to the screw, at joint angle zero, rad.
    opposite: f64,
    /// Screw length at home, m.
    home: f64,
}

impl Screw {
    /// `pivot` is the position of the pivot beside and below the axis, m. `opposite` is the angle between crank and
    /// pivot at joint angle zero, rad. `home` is the joint angle at home, rad. `lead` is in m per turn.
    pub(super) fn new(crank: f64, pivot: (f64, f64), lead: f64, opposite: f64, home: f64) -> Self {
        let beside = pivot.0.hypot(pivot.1);
        let mut screw = Self {
            squares: crank * crank + beside * beside,
            product: crank * beside,
            per_length: TAU / lead,
            opposite,
            home: 0.0,
        };
        screw.home = screw.length(home);
        screw
    }

    /// Screw length at a joint angle, m.
    pub(super) fn length(&self, joint: f64) -> f64 {
        (self.squares - 2.0 * self.product * (joint + self.opposite).cos()).sqrt()
    }

    /// The joint angle, rad, and the motor angle per joint angle, for a motor `from_home` rad away from home.
    pub(super) fn joint(&self, from_home: f64) -> (f64, f64) {
        let length = self.home + from_home / self.per_length;
        let cos = (self.squares - length * length) / (2.0 * self.product);
        // A motor far outside its range leaves the triangle stretched or folded. The clamp keeps the ratio finite.
        let cos = cos.clamp(-STRETCHED, STRETCHED);
        let sin = (1.0 - cos * cos).sqrt();
        let gear = self.per_length * self.product * sin / length;
        (cos.acos() - self.opposite, gear)
    }

    /// Greatest change of the joint angle per motor angle.
    pub(super) fn steepest(&self) -> f64 {
        let longest = (self.squares + 2.0 * self.product * STRETCHED).sqrt();
        longest / (self.per_length * self.product * (1.0 - STRETCHED * STRETCHED).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::super::irp6::screws;

    #[test]
    fn screws_are_as_long_and_as_geared_as_those_of_the_robot() {
        // Joint angle, degrees; length, mm; mm per rad; motor angle per joint angle. Lengths at the ends are rounded.
        let lower = [
            (-130.0, 127.5, 0.06, 109.0, 136.9),
            (-90.0, 220.3374, 5e-4, 138.2, 173.7),
            (-50.0, 307.5, 0.06, 106.5, 133.9),
        ];
        let upper = [
            (-25.0, 127.6, 0.06, 109.0, 136.9),
            (0.0, 183.8348, 5e-4, 139.4, 175.1),
            (40.0, 277.6, 0.06, 121.8, 153.0),
        ];
        for (screw, home, rows) in [(screws().0, -90.0, lower), (screws().1, 0.0, upper)] {
            let at_home = screw.length(f64::to_radians(home));
            for (degrees, length, within, per_radian, gear) in rows {
                let angle = f64::to_radians(degrees);
                let found = screw.length(angle);
                assert!((found * 1e3 - length).abs() < within, "{degrees}°: {found} m");
                let slope = (screw.length(angle + 1e-6) - screw.length(angle - 1e-6)) / 2e-6;
                assert!((slope * 1e3 - per_radian).abs() < 0.06, "{degrees}°: {slope} m/rad");
                let motor = (found - at_home) * std::f64::consts::TAU / 5e-3;
                let (back, ratio) = screw.joint(motor);
                assert!((back - angle).abs() < 1e-12, "{degrees}°: back at {back}");
                assert!((ratio - gear).abs() < 0.06, "{degrees}°: {ratio}");
            }
        }
    }
}
