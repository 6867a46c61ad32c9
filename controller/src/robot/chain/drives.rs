//! Motor positions of a chain as linear functions of its joint positions.

use nalgebra::DMatrix;
use servo::MAX_AXES;

use super::super::{KinematicsError, Limits, LinkKind, Space};
use super::parameters::ChainParameters;

/// Range of the motor of an endless joint on either side of home, rad: that of a 32-bit counter with 4000 counts per
/// revolution.
const ENDLESS: f64 = 3.35e6;

type Matrix = [[f64; MAX_AXES]; MAX_AXES];

/// Gears and couplings between motors and joints, with the ranges of both.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drives {
    pub(super) axes: usize,
    motors_from_joints: Matrix,
    joints_from_motors: Matrix,
    joints_at_home: [f64; MAX_AXES],
    pub(super) motors_at_home: [f64; MAX_AXES],
    pub(super) joint_limits: [Limits; MAX_AXES],
    pub(super) motor_limits: [Limits; MAX_AXES],
    /// Motors that an endless joint moves. Only the limits of these motors do not follow from the limits of the joints.
    endless: [bool; MAX_AXES],
}

impl Drives {
    /// The drives of parameters whose check returned this matrix.
    pub(super) fn new(parameters: &ChainParameters, matrix: &DMatrix<f64>) -> Self {
        let joints = &parameters.joints;
        let axes = joints.len();
        let inverse = matrix.clone().try_inverse().expect("the check inverts the matrix");
        let mut drives = Self {
            axes,
            motors_from_joints: padded(matrix),
            joints_from_motors: padded(&inverse),
            joints_at_home: [0.0; MAX_AXES],
            motors_at_home: [0.0; MAX_AXES],
            joint_limits: [Limits::CONTINUOUS; MAX_AXES],
            motor_limits: [Limits::CONTINUOUS; MAX_AXES],
            endless: [false; MAX_AXES],
        };
        for (axis, joint) in joints.iter().enumerate() {
            drives.joints_at_home[axis] = joint.joint_at_home;
            drives.motors_at_home[axis] = joint.motor_at_home;
            if joint.kind != LinkKind::Continuous {
                drives.joint_limits[axis] = joint.limits;
            }
        }
        for motor in 0..axes {
            let home = drives.motors_at_home[motor];
            let mut limits = Limits::new(home, home);
            for axis in 0..axes {
                let factor = drives.motors_from_joints[motor][axis];
                if factor == 0.0 {
                    continue;
                }
                let range = drives.joint_limits[axis].map(|end| factor * (end - drives.joints_at_home[axis]));
                limits = Limits::new(limits.low + range.low, limits.high + range.high);
            }
            if limits.is_continuous() {
                drives.endless[motor] = true;
                limits = Limits::new(home - ENDLESS, home + ENDLESS);
            }
            drives.motor_limits[motor] = limits;
        }
        drives
    }

    /// Refuses a posture with a joint beyond its limit.
    pub(super) fn check_joints(&self, joints: &[f64; MAX_AXES]) -> Result<(), KinematicsError> {
        let limits = self.joint_limits[..self.axes].iter().zip(joints).enumerate();
        limits.into_iter().try_for_each(|(axis, (limits, &joint))| limits.check(Space::Joint, axis, joint))
    }

    /// Motor positions for joint positions. Both are checked against their limits.
    pub(super) fn motors(&self, joints: &[f64; MAX_AXES]) -> Result<[f64; MAX_AXES], KinematicsError> {
        self.check_joints(joints)?;
        let motors = self.mapped(&self.motors_from_joints, joints, &self.joints_at_home, &self.motors_at_home)?;
        for (axis, &motor) in motors[..self.axes].iter().enumerate() {
            if self.endless[axis] {
                self.motor_limits[axis].check(Space::Motor, axis, motor)?;
            }
        }
        Ok(motors)
    }

    /// Joint positions at motor positions. No limit is checked.
    pub(super) fn joints(&self, motors: &[f64; MAX_AXES]) -> Result<[f64; MAX_AXES], KinematicsError> {
        self.mapped(&self.joints_from_motors, motors, &self.motors_at_home, &self.joints_at_home)
    }

    fn mapped(
        &self,
        matrix: &Matrix,
        from: &[f64; MAX_AXES],
        from_home: &[f64; MAX_AXES],
        to_home: &[f64; MAX_AXES],
    ) -> Result<[f64; MAX_AXES], KinematicsError> {
        let mut mapped = [0.0; MAX_AXES];
        for row in 0..self.axes {
            let travel: f64 =
                (0..self.axes).map(|column| matrix[row][column] * (from[column] - from_home[column])).sum();
            mapped[row] = to_home[row] + travel;
            if !mapped[row].is_finite() {
                return Err(KinematicsError::NotFinite);
            }
        }
        Ok(mapped)
    }
}

fn padded(matrix: &DMatrix<f64>) -> Matrix {
    let mut padded = [[0.0; MAX_AXES]; MAX_AXES];
    for (row, numbers) in padded[..matrix.nrows()].iter_mut().enumerate() {
        for (column, number) in numbers[..matrix.ncols()].iter_mut().enumerate() {
            *number = matrix[(row, column)];
        }
    }
    padded
}
