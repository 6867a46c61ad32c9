use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{KinematicsError, Limits, Space};

/// The only axis of the devices here.
const AXIS: u8 = 0;

/// The two-finger gripper: one motor, two jaws.
///
/// The opening, m, is `square`·m² + `linear`·m + `constant` for the motor position m, rad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Gripper {
    /// m/rad².
    pub square: f64,
    /// m/rad.
    pub linear: f64,
    /// m.
    pub constant: f64,
    /// Motor position at home, rad.
    pub motor_at_home: f64,
    /// Range of the motor, rad. The jaws open up to the polynomial's vertex and close again past it.
    pub motor_limits: Limits,
    /// Range of the opening, m.
    pub opening_limits: Limits,
}

impl Gripper {
    /// The gripper of the WUT robots (public code). Its vertex is at 2564 rad (derived), its home past it.
    #[doc(alias = "tfg")]
    pub const fn two_finger() -> Self {
        Self {
            square: -2.8313e-9,
            linear: 1.451_910_074e-5,
            constant: 0.074,
            motor_at_home: 4830.0,
            motor_limits: Limits {
                low: -2000.0,
                high: 5000.0,
            },
            opening_limits: Limits {
                low: 0.053,
                high: 0.091,
            },
        }
    }

    /// Opening of the jaws, m, at a motor position, rad. Looks at no limit: it serves measured positions.
    pub fn opening(&self, motor: f64) -> Result<f64, KinematicsError> {
        finite((self.square * motor + self.linear) * motor + self.constant)
    }

    /// Motor position, rad, for an opening of the jaws, m, both within their limits: of the two positions
    /// that have it the one nearer to `near`.
    pub fn motor(&self, opening: f64, near: f64) -> Result<f64, KinematicsError> {
        within(&self.opening_limits, opening, Space::Joint)?;
        finite(near)?;
        let excess = opening - self.constant;
        let root = (self.linear * self.linear + 4.0 * self.square * excess).sqrt();
        // This form of the solution keeps its digits where square or excess are small.
        let opens = 2.0 * excess / (self.linear + root);
        let closes = -self.linear / self.square - opens;
        let mut ways = [opens, closes];
        if (closes - near).abs() < (opens - near).abs() {
            ways.swap(0, 1);
        }
        let [first, second] =
            ways.map(|motor| within(&self.motor_limits, motor, Space::Motor).map(|()| motor));
        first.or_else(|refusal| second.map_err(|_| refusal))
    }
}

/// The conveyor: a belt behind a gear.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Conveyor {
    /// Motor rad per m of belt.
    pub ratio: f64,
}

impl Conveyor {
    /// The conveyor of the WUT laboratory (public code); 4000 counts per revolution make 0.70 µm each.
    pub const fn belt() -> Self {
        Self { ratio: 2250.0 }
    }

    /// Position of the belt, m, at a motor position, rad.
    pub fn belt_position(&self, motor: f64) -> Result<f64, KinematicsError> {
        finite(motor / self.ratio)
    }

    /// Motor position, rad, for a position of the belt, m.
    pub fn motor(&self, belt: f64) -> Result<f64, KinematicsError> {
        finite(belt * self.ratio)
    }
}

fn finite(value: f64) -> Result<f64, KinematicsError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(KinematicsError::NotFinite)
    }
}

fn within(limits: &Limits, value: f64, space: Space) -> Result<(), KinematicsError> {
    match limits.exceeded_by(finite(value)?) {
        Some(limit) => Err(KinematicsError::BeyondLimit {
            space,
            axis: AXIS,
            value,
            limit,
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jaws_open_along_the_published_polynomial_and_back() {
        let gripper = Gripper::two_finger();
        for (motor, opening) in [
            (-1000.0, 0.056_649_599_26),
            (0.0, 0.074),
            (1000.0, 0.085_687_800_74),
            (4830.0, 0.078_076_142_004_2),
            (5000.0, 0.075_813_003_7),
        ] {
            assert!((gripper.opening(motor).unwrap() - opening).abs() < 1e-12);
            let back = gripper.motor(opening, motor).unwrap();
            assert!((back - motor).abs() < 1e-6, "{motor} {back}");
        }
        // Far from there only one of the two is within the motor's range.
        let back = gripper.motor(0.056_649_599_26, 5000.0).unwrap();
        assert!((back + 1000.0).abs() < 1e-6, "{back}");
    }

    #[test]
    fn an_opening_the_jaws_do_not_have_is_refused() {
        let gripper = Gripper::two_finger();
        for (opening, limit) in [(0.05, 0.053), (0.0915, 0.091)] {
            let beyond = KinematicsError::BeyondLimit {
                space: Space::Joint,
                axis: 0,
                value: opening,
                limit,
            };
            assert_eq!(gripper.motor(opening, 0.0), Err(beyond));
        }
        let mut narrow = gripper;
        narrow.motor_limits.low = -500.0;
        let refusal = narrow.motor(0.056_649_599_26, 0.0).unwrap_err();
        assert_eq!(refusal.axis(), Some(0));
        let spoilt = [gripper.motor(f64::NAN, 0.0), gripper.motor(0.06, f64::NAN)];
        assert!(spoilt.iter().all(Result::is_err));
        assert_eq!(gripper.opening(f64::NAN), Err(KinematicsError::NotFinite));
    }

    #[test]
    fn belt_moves_a_metre_in_2250_rad() {
        let belt = Conveyor::belt();
        assert!((belt.motor(0.4).unwrap() - 900.0).abs() < 1e-9);
        assert!((belt.belt_position(900.0).unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(belt.motor(f64::NAN), Err(KinematicsError::NotFinite));
    }
}
