//! Devices of one axis: gripper and conveyor.

use std::sync::Arc;

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::parameters::{finite as finite_parameter, room};
use super::room::room as room_at_home;
use super::{
    Jacobian, Joints, KinematicsError, Limits, Motors, ParameterError, Robot, RobotParameters, Solutions, Space,
};

/// Tolerance for rounding errors in the distance of a pose from the path of such a device, m and rad.
const OFF_AXIS: f64 = 1e-9;

/// Parameters of one two-finger gripper: one motor, two jaws.
///
/// For the motor position m, rad, the opening is `square`·m² + `linear`·m + `constant`, in m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GripperParameters {
    /// Coefficient of m², m/rad².
    pub square: f64,
    /// Coefficient of m, m/rad.
    pub linear: f64,
    /// Constant term, m.
    pub constant: f64,
    /// Motor position at home, rad.
    pub motor_at_home: f64,
    /// Range of the motor, rad. The jaws open up to the vertex of the polynomial and close again beyond the vertex.
    pub motor_limits: Limits,
    /// Range of the opening, m.
    pub opening_limits: Limits,
}

impl GripperParameters {
    /// The gripper of the WUT robots (public code). The sign of `linear` is chosen so that home lies within the
    /// openings; the public code has the other sign. The vertex is at 2564 rad (derived), with home beyond the
    /// vertex.
    #[doc(alias = "tfg")]
    pub const fn two_finger() -> Self {
        Self {
            square: -2.8313e-9,
            linear: 1.451_910_074e-5,
            constant: 0.074,
            motor_at_home: 4830.0,
            motor_limits: Limits::new(-2000.0, 5000.0),
            opening_limits: Limits::new(0.053, 0.091),
        }
    }

    /// Opening of the jaws, m, at a motor position, rad. No limit is checked.
    fn opening(&self, motor: f64) -> Result<f64, KinematicsError> {
        finite((self.square * motor + self.linear) * motor + self.constant)
    }

    /// Motor position, rad, for an opening of the jaws, m, both within their limits. Of the two positions with this
    /// opening the one nearer to `near` is returned.
    fn motor(&self, opening: f64, near: f64) -> Result<f64, KinematicsError> {
        within(&self.opening_limits, opening, Space::Joint)?;
        finite(near)?;
        let excess = opening - self.constant;
        let root = (self.linear * self.linear + 4.0 * self.square * excess).sqrt();
        // This form of the solution stays accurate where `square` or `excess` is small.
        let opens = 2.0 * excess / (self.linear + root);
        let closes = -self.linear / self.square - opens;
        let mut ways = [opens, closes];
        if (closes - near).abs() < (opens - near).abs() {
            ways.swap(0, 1);
        }
        let [first, second] = ways.map(|motor| within(&self.motor_limits, motor, Space::Motor).map(|()| motor));
        first.or_else(|refusal| second.map_err(|_| refusal))
    }
}

/// Parameters of one conveyor: a belt behind a gear.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ConveyorParameters {
    /// Motor angle per displacement of the belt, rad/m.
    pub ratio: f64,
    /// Motor position at home, rad.
    pub motor_at_home: f64,
    /// Range of the motor, rad. The belt is endless, and the range is that of the counter.
    pub motor_limits: Limits,
}

impl ConveyorParameters {
    /// The conveyor of the WUT laboratory (public code). With 4000 counts per revolution, one count is 0.70 µm.
    /// Derived: a 32-bit counter of these counts covers the motor's range, ±1489 m of belt.
    pub const fn belt() -> Self {
        Self { ratio: 2250.0, motor_at_home: 0.0, motor_limits: Limits::new(-3.35e6, 3.35e6) }
    }
}

/// A device of one axis, whose flange moves along x by the position of its joint.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearDevice {
    map: AxisMap,
    joint_limits: Limits,
    motor_limits: Limits,
    motor_at_home: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum AxisMap {
    Gripper(GripperParameters),
    /// Motor angle per displacement, rad/m.
    Conveyor(f64),
}

impl LinearDevice {
    /// The two-finger gripper. Its joint is the opening of the jaws, m. Fails if a parameter is invalid.
    ///
    /// Two motor positions give the same opening, one on either side of the vertex of the polynomial. The motor
    /// position must be a function of the joint. The gripper therefore uses only the side of its home position, and
    /// its joint has the range of that side.
    pub fn gripper(parameters: &GripperParameters) -> Result<Self, ParameterError> {
        let name = "jaws";
        let GripperParameters { square, linear, constant, motor_at_home, mut motor_limits, opening_limits } =
            *parameters;
        for value in [square, linear, constant, motor_at_home] {
            finite_parameter(name, value)?;
        }
        room(name, motor_limits)?;
        room(name, opening_limits)?;
        if square == 0.0 {
            return Err(ParameterError::NoRatio { name });
        }
        let vertex = -linear / (2.0 * square);
        if motor_at_home < vertex {
            motor_limits.high = motor_limits.high.min(vertex);
        } else {
            motor_limits.low = motor_limits.low.max(vertex);
        }
        room(name, motor_limits)?;
        let opening = |motor| (square * motor + linear) * motor + constant;
        let joint_limits = opening_limits.within(motor_limits.map(opening));
        room(name, joint_limits)?;
        Ok(Self {
            map: AxisMap::Gripper(GripperParameters { motor_limits, ..*parameters }),
            joint_limits,
            motor_limits,
            motor_at_home,
        })
    }

    /// The endless conveyor. Its joint is the position of the belt, m. Fails if a parameter is invalid.
    pub fn conveyor(parameters: &ConveyorParameters) -> Result<Self, ParameterError> {
        let name = "belt";
        finite_parameter(name, parameters.ratio)?;
        finite_parameter(name, parameters.motor_at_home)?;
        if parameters.ratio == 0.0 {
            return Err(ParameterError::NoRatio { name });
        }
        room(name, parameters.motor_limits)?;
        Ok(Self {
            map: AxisMap::Conveyor(parameters.ratio),
            joint_limits: Limits::CONTINUOUS,
            motor_limits: parameters.motor_limits,
            motor_at_home: parameters.motor_at_home,
        })
    }

    /// Motor position, rad, for a position of the joint, m. Both are checked against their limits.
    fn motor(&self, joint: f64) -> Result<f64, KinematicsError> {
        match &self.map {
            AxisMap::Gripper(gripper) => {
                within(&self.joint_limits, joint, Space::Joint)?;
                gripper.motor(joint, self.motor_at_home)
            }
            AxisMap::Conveyor(ratio) => {
                let motor = joint * ratio;
                within(&self.motor_limits, motor, Space::Motor)?;
                Ok(motor)
            }
        }
    }

    /// Position of the joint, m, at a motor position, rad. No limit is checked.
    fn joint(&self, motor: f64) -> Result<f64, KinematicsError> {
        match &self.map {
            AxisMap::Gripper(gripper) => gripper.opening(motor),
            AxisMap::Conveyor(ratio) => finite(motor / ratio),
        }
    }
}

impl Robot for LinearDevice {
    fn joint_limits(&self) -> &[Limits] {
        std::slice::from_ref(&self.joint_limits)
    }

    fn motor_limits(&self) -> &[Limits] {
        std::slice::from_ref(&self.motor_limits)
    }

    fn home(&self) -> Motors {
        Motors::from([self.motor_at_home])
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        let [x] = *joints.exactly::<1>()?;
        Ok(Isometry3::translation(x, 0.0, 0.0))
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        near.exactly::<1>()?;
        let at = base_from_flange.translation.vector;
        let x = finite(at.x)?;
        let distance = finite(at.y.hypot(at.z))?;
        let angle = finite(base_from_flange.rotation.angle())?;
        if distance > OFF_AXIS || angle > OFF_AXIS {
            return Err(KinematicsError::OffAxis { distance, angle });
        }
        self.motor(x)?;
        Ok(Joints::from([x]).into())
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        let [joint] = *joints.exactly::<1>()?;
        Ok([self.motor(joint)?].into())
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        let [motor] = *motors.exactly::<1>()?;
        Ok([self.joint(motor)?].into())
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        joints.exactly::<1>()?;
        let mut jacobian = Jacobian::zeros();
        jacobian[(0, 0)] = 1.0;
        Ok(jacobian)
    }
}

fn finite(value: f64) -> Result<f64, KinematicsError> {
    if value.is_finite() { Ok(value) } else { Err(KinematicsError::NotFinite) }
}

fn within(limits: &Limits, value: f64, space: Space) -> Result<(), KinematicsError> {
    limits.check(space, 0, finite(value)?)
}

impl RobotParameters for GripperParameters {
    fn axes(&self) -> usize {
        1
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(LinearDevice::gripper(self)?))
    }

    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        let motor = room_at_home(motors, 0);
        let opening = |motor| self.opening(motor).ok();
        self.opening_limits = self.opening_limits.with_room_through(opening, self.motor_at_home, motor);
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, motor);
        self
    }
}

impl RobotParameters for ConveyorParameters {
    fn axes(&self) -> usize {
        1
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(LinearDevice::conveyor(self)?))
    }

    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, room_at_home(motors, 0));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jaws_open_along_the_published_polynomial_and_back() {
        let gripper = GripperParameters::two_finger();
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
        // Far from the vertex only one of the two positions lies within the motor's range.
        let back = gripper.motor(0.056_649_599_26, 5000.0).unwrap();
        assert!((back + 1000.0).abs() < 1e-6, "{back}");
    }

    #[test]
    fn an_opening_the_jaws_do_not_have_is_refused() {
        let gripper = GripperParameters::two_finger();
        for (opening, limit) in [(0.05, 0.053), (0.0915, 0.091)] {
            let beyond = KinematicsError::BeyondLimit { space: Space::Joint, axis: 0, value: opening, limit };
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
        let belt = LinearDevice::conveyor(&ConveyorParameters::belt()).unwrap();
        assert!((belt.motor(0.4).unwrap() - 900.0).abs() < 1e-9);
        assert!((belt.joint(900.0).unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(belt.motor(f64::NAN), Err(KinematicsError::NotFinite));
    }

    #[test]
    fn a_gripper_works_on_the_side_of_its_home() {
        let gripper = LinearDevice::gripper(&GripperParameters::two_finger()).unwrap();
        let home = gripper.joints_from_motors(&gripper.home()).unwrap();
        let motors = gripper.motors_from_joints(&home).unwrap();
        assert!((motors[0] - 4830.0).abs() < 1e-6, "{motors:?}");
        let pose = gripper.forward(&home).unwrap();
        assert_eq!(*gripper.inverse(&pose, &home).unwrap().preferred(), home);
        // Only motor positions on the other side of the vertex have this opening.
        let narrow = gripper.motors_from_joints(&Joints::from([0.06])).unwrap_err();
        assert_eq!(narrow.axis(), Some(0));
        let mut other = GripperParameters::two_finger();
        other.motor_at_home = 0.0;
        let motors = LinearDevice::gripper(&other).unwrap().motors_from_joints(&Joints::from([0.06]));
        assert!(motors.unwrap()[0] < 0.0);
    }

    #[test]
    fn a_pose_off_the_way_of_the_belt_is_refused() {
        let belt = LinearDevice::conveyor(&ConveyorParameters::belt()).unwrap();
        let near = Joints::from([0.0]);
        let there = belt.inverse(&Isometry3::translation(12.5, 0.0, 0.0), &near);
        assert_eq!(*there.unwrap().preferred(), Joints::from([12.5]));
        let turned = Isometry3::rotation(nalgebra::Vector3::z() * 0.1);
        for (pose, off) in [(Isometry3::translation(0.5, 0.3, 0.4), (0.5, 0.0)), (turned, (0.0, 0.1))] {
            let Err(KinematicsError::OffAxis { distance, angle }) = belt.inverse(&pose, &near) else {
                panic!("{pose} was not refused");
            };
            assert!((distance - off.0).abs() < 1e-12 && (angle - off.1).abs() < 1e-12);
        }
        let far = Isometry3::translation(1490.0, 0.0, 0.0);
        assert_eq!(belt.inverse(&far, &near).unwrap_err().axis(), Some(0));
        assert!(belt.motors_from_joints(&Joints::from([f64::NAN])).is_err());
    }
}
