//! A program with every command of `mrroc` for a five-bar robot, which is no serial chain of joints. Two motors stand
//! side by side on the x axis, and each turns a link. Two further links join the ends of these links at the flange,
//! which moves in the plane and keeps its orientation. All numbers are nominal.

use std::{process::ExitCode, sync::Arc};

use mrroc::Extension;
use mrroc::robots::{
    EmulatedJoint, Jacobian, Joints, KinematicsError, Limits, Motors, OwnRobot, ParameterError, Pose, Robot,
    RobotParameters, Solutions, Space,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motor angle per joint angle.
const RATIO: f64 = 50.0;
/// Angles of the driven links to the x axis at home, ranges of the links, and ranges of the motors, which are at zero
/// at home; rad.
const HOME: [f64; 2] = [2.1, 1.04];
const JOINTS: [Limits; 2] = [Limits { low: 1.2, high: 3.1 }, Limits { low: 0.04, high: 1.94 }];
const MOTORS: [Limits; 2] = [Limits { low: -45.0, high: 50.0 }, Limits { low: -50.0, high: 45.0 }];

/// Lengths of a five-bar robot.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct FiveBar {
    /// Distance of the motors, m.
    base: f64,
    /// Length of the driven links, m.
    proximal: f64,
    /// Length of the links that join at the flange, m.
    distal: f64,
}

impl Default for FiveBar {
    fn default() -> Self {
        Self { base: 0.2, proximal: 0.25, distal: 0.35 }
    }
}

impl RobotParameters for FiveBar {
    fn axes(&self) -> usize {
        2
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        let lengths = [("base", self.base), ("proximal", self.proximal), ("distal", self.distal)];
        match lengths.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite())) {
            Some((name, value)) => Err(ParameterError::NotPositive { name, value }),
            None => Ok(Arc::new(self.clone())),
        }
    }
}

impl OwnRobot for FiveBar {
    const MODEL: &'static str = "five-bar";

    fn joint(&self, _axis: usize) -> EmulatedJoint {
        EmulatedJoint { ratio: RATIO, inertia: 0.05, velocity: 4.0, effort: 8.0 }
    }
}

impl FiveBar {
    /// The flange, and its position relative to each elbow, m.
    fn place(&self, joints: &[f64; 2]) -> Result<([f64; 2], [[f64; 2]; 2]), KinematicsError> {
        let elbow = |i: usize, stand: f64| [stand + self.proximal * joints[i].cos(), self.proximal * joints[i].sin()];
        let elbows = [elbow(0, -0.5 * self.base), elbow(1, 0.5 * self.base)];
        let between = [elbows[1][0] - elbows[0][0], elbows[1][1] - elbows[0][1]];
        let half = 0.5 * between[0].hypot(between[1]);
        if half >= self.distal || half == 0.0 {
            return Err(KinematicsError::Open { leg: 1, residual: 2.0 * (half - self.distal) });
        }
        let height = (self.distal * self.distal - half * half).sqrt() / (2.0 * half);
        let from_left = [0.5 * between[0] - height * between[1], 0.5 * between[1] + height * between[0]];
        let from_right = [from_left[0] - between[0], from_left[1] - between[1]];
        Ok(([elbows[0][0] + from_left[0], elbows[0][1] + from_left[1]], [from_left, from_right]))
    }
}

impl Robot for FiveBar {
    fn joint_limits(&self) -> &[Limits] {
        &JOINTS
    }

    fn motor_limits(&self) -> &[Limits] {
        &MOTORS
    }

    fn home(&self) -> Motors {
        Motors::from([0.0; 2])
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, KinematicsError> {
        let ([x, y], _) = self.place(joints.exactly()?)?;
        Ok(Pose::translation(x, y, 0.0))
    }

    fn inverse(&self, base_from_flange: &Pose, _near: &Joints) -> Result<Solutions, KinematicsError> {
        let &FiveBar { base, proximal, distal } = self;
        let (place, angle) = (base_from_flange.translation.vector, base_from_flange.rotation.angle());
        if !(place.z.abs() < 1e-9 && angle < 1e-9) {
            return Err(KinematicsError::OffAxis { distance: place.z.abs(), angle });
        }
        let mut joints = [0.0; 2];
        // Both elbows point outwards.
        for (joint, turn) in joints.iter_mut().zip([1.0, -1.0]) {
            let (x, y) = (place.x + 0.5 * turn * base, place.y);
            let way = x.hypot(y);
            let cosine = (proximal * proximal + way * way - distal * distal) / (2.0 * proximal * way);
            if cosine.is_nan() || cosine.abs() > 1.0 {
                let margin = (way - proximal - distal).max((proximal - distal).abs() - way);
                return Err(KinematicsError::Unreachable { margin });
            }
            *joint = y.atan2(x) + turn * cosine.acos();
        }
        self.motors_from_joints(&joints.into())?;
        Ok(Solutions::from(Joints::from(joints)))
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        let joints: &[f64; 2] = joints.exactly()?;
        self.place(joints)?;
        (0..2).try_for_each(|axis| JOINTS[axis].check(Space::Joint, axis, joints[axis]))?;
        Ok(Motors::from([0, 1].map(|axis| RATIO * (joints[axis] - HOME[axis]))))
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        let motors: &[f64; 2] = motors.exactly()?;
        Ok(Joints::from([0, 1].map(|axis| HOME[axis] + motors[axis] / RATIO)))
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let joints: &[f64; 2] = joints.exactly()?;
        let (_, [left, right]) = self.place(joints)?;
        // The distal links keep their lengths: each row is the velocity of the flange along one distal link.
        let across = left[0] * right[1] - left[1] * right[0];
        if across.abs() < 1e-9 {
            return Err(KinematicsError::Singular { axis: 0, margin: across.abs() });
        }
        let along = |link: [f64; 2], joint: f64| self.proximal * (link[1] * joint.cos() - link[0] * joint.sin());
        let (first, second) = (along(left, joints[0]) / across, along(right, joints[1]) / across);
        let mut jacobian = Jacobian::zeros();
        (jacobian[(0, 0)], jacobian[(1, 0)]) = (right[1] * first, -right[0] * first);
        (jacobian[(0, 1)], jacobian[(1, 1)]) = (-left[1] * second, left[0] * second);
        Ok(jacobian)
    }
}

fn main() -> ExitCode {
    mrroc_console::main(&Extension::new().robot::<FiveBar>())
}
