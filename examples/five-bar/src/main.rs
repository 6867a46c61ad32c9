//! A program with every command of `mrroc` for a five-bar robot. Two motors on the x axis turn one link each. Two
//! further links join these links at the flange. The flange moves in the plane without rotation. All numbers are
//! nominal.

use std::{f64::consts::PI, process::ExitCode, sync::Arc};

use mrroc::Extension;
use mrroc::robots::{
    EmulatedJoint, EmulatedLink, Joints, KinematicsError, Limits, Motors, OwnRobot, ParameterError, Pose, Robot,
    RobotParameters, Solutions, Space,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motor angle per joint angle.
const RATIO: f64 = 50.0;
/// Angles of the driven links to the x axis at home, their ranges, and ranges of the motors from home, rad.
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

    /// Rods of 2 kg/m: the driven links, then the links that join at the flange.
    fn emulated_links(&self) -> Vec<EmulatedLink> {
        [self.proximal, self.proximal, self.distal, self.distal].map(|it| EmulatedLink::rod(2.0 * it, it)).into()
    }

    /// Poses from the triangle of elbows and flange. The emulator does not use the kinematics of the controller.
    fn place_links(&self, motors: &[f64], poses: &mut [Pose]) -> bool {
        let turn = |angle: f64| Pose::rotation([0.0, 0.0, angle].into());
        for (side, stand) in [(0, -0.5), (1, 0.5)] {
            poses[side] = Pose::translation(stand * self.base, 0.0, 0.0) * turn(HOME[side] + motors[side] / RATIO);
            poses[2 + side] = poses[side] * Pose::translation(self.proximal, 0.0, 0.0);
        }
        let elbows = [2, 3].map(|link: usize| poses[link].translation);
        let between = elbows[1].vector - elbows[0].vector;
        let (along, corner) = (between.y.atan2(between.x), (0.5 * between.norm() / self.distal).acos());
        (poses[2], poses[3]) = (elbows[0] * turn(along + corner), elbows[1] * turn(along + PI - corner));
        poses[4] = (poses[2] * Pose::translation(self.distal, 0.0, 0.0)).translation.into();
        corner.is_finite()
    }
}

impl FiveBar {
    /// The flange, m.
    fn place(&self, joints: &[f64; 2]) -> Result<[f64; 2], KinematicsError> {
        let elbow = |i: usize, stand: f64| [stand + self.proximal * joints[i].cos(), self.proximal * joints[i].sin()];
        let ([x, y], right) = (elbow(0, -0.5 * self.base), elbow(1, 0.5 * self.base));
        let between = [0.5 * (right[0] - x), 0.5 * (right[1] - y)];
        let half = between[0].hypot(between[1]);
        if !(half < self.distal && half > 0.0) {
            return Err(KinematicsError::Open { leg: 1, residual: 2.0 * (half - self.distal) });
        }
        let height = (self.distal * self.distal - half * half).sqrt() / half;
        Ok([x + between[0] - height * between[1], y + between[1] + height * between[0]])
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
        let [x, y] = self.place(joints.exactly()?)?;
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
            let margin = (way - proximal - distal).max((proximal - distal).abs() - way);
            if !(margin <= 0.0 && way > 0.0) {
                return Err(KinematicsError::Unreachable { margin });
            }
            let cosine = (proximal * proximal + way * way - distal * distal) / (2.0 * proximal * way);
            *joint = y.atan2(x) + turn * cosine.acos();
        }
        self.motors_from_joints(&joints.into())?;
        Ok(Solutions::from(Joints::from(joints)))
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        self.place(joints.exactly()?)?;
        (0..2).try_for_each(|axis| JOINTS[axis].check(Space::Joint, axis, joints[axis]))?;
        Ok(Motors::from([0, 1].map(|axis| RATIO * (joints[axis] - HOME[axis]))))
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        let motors: &[f64; 2] = motors.exactly()?;
        Ok(Joints::from([0, 1].map(|axis| HOME[axis] + motors[axis] / RATIO)))
    }
}

fn main() -> ExitCode {
    mrroc_console::main(&Extension::new().robot::<FiveBar>())
}
