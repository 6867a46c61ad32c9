//! A ball screw across a triangle, as it moves the lower and the upper arm of the IRp-6.

use std::f64::consts::TAU;

/// The nut pulls on a crank; the screw's other end turns about a pivot beside the crank's axis.
///
/// The triangle's sides are the crank, the line between axis and pivot, and the screw, whose length follows the
/// angle opposite to it. That angle grows with the joint's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Screw {
    /// Squares of crank and axis to pivot, summed, m².
    squares: f64,
    /// Their product, m².
    product: f64,
    /// Motor angle per length, rad/m.
    per_length: f64,
    /// Of the triangle at joint angle zero, rad.
    opposite: f64,
    /// At home, m.
    home: f64,
}

impl Screw {
    /// `pivot` is beside and below the axis, m; `opposite` is the angle between crank and pivot at joint angle zero,
    /// `home` the joint angle at home, both rad; `lead` is in m per turn.
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

    /// At a joint angle, m.
    pub(super) fn length(&self, joint: f64) -> f64 {
        (self.squares - 2.0 * self.product * (joint + self.opposite).cos()).sqrt()
    }

    /// The joint angle, rad, and motor angle per joint angle, where the motor is so far from home.
    pub(super) fn joint(&self, from_home: f64) -> (f64, f64) {
        let length = self.home + from_home / self.per_length;
        let cos = (self.squares - length * length) / (2.0 * self.product);
        // A motor taken out of all bounds leaves the triangle stretched or folded; short of that the gear stays finite.
        let cos = cos.clamp(-0.999, 0.999);
        let sin = (1.0 - cos * cos).sqrt();
        let gear = self.per_length * self.product * sin / length;
        (cos.acos() - self.opposite, gear)
    }
}

#[cfg(test)]
mod tests {
    use super::super::irp6::screws;

    #[test]
    fn screws_are_as_long_and_as_geared_as_those_of_the_robot() {
        // Joint angle, degrees; length, mm; mm per rad; motor per joint. Lengths at the ends are rounded.
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
                assert!(
                    (found * 1e3 - length).abs() < within,
                    "{degrees}°: {found} m"
                );
                let slope = (screw.length(angle + 1e-6) - screw.length(angle - 1e-6)) / 2e-6;
                assert!(
                    (slope * 1e3 - per_radian).abs() < 0.06,
                    "{degrees}°: {slope} m/rad"
                );
                let motor = (found - at_home) * std::f64::consts::TAU / 5e-3;
                let (back, ratio) = screw.joint(motor);
                assert!((back - angle).abs() < 1e-12, "{degrees}°: back at {back}");
                assert!((ratio - gear).abs() < 0.06, "{degrees}°: {ratio}");
            }
        }
    }
}
