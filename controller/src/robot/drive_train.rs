//! Drive trains: gears and ball-screw triangles.

use std::f64::consts::{PI, TAU};

use serde::{Deserialize, Serialize};

use super::{Joints, KinematicsError, Limits, Motors, Space};

/// An axis behind a gear of constant ratio.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GearAxis {
    /// Motor angle per joint angle (per metre for a linear joint), negative if they turn in opposite directions.
    pub ratio: f64,
    /// Joint position at home, rad.
    pub joint_at_home: f64,
    /// Motor position at home, rad.
    pub motor_at_home: f64,
    /// Range of the joint, rad.
    pub joint_limits: Limits,
    /// Range of the motor, rad.
    pub motor_limits: Limits,
}

/// An axis driven by a ball screw across a triangle. The screw is the side opposite to the joint.
///
/// The length L of the screw follows from the law of cosines: L² = `squared` + `cosine`·cos θ + `sine`·sin θ. The two
/// coefficients include the angles at which crank and frame are mounted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScrewAxis {
    /// Screw travel per motor turn, m, positive if the screw lengthens as the motor turns forward.
    pub lead: f64,
    /// Sum of the squares of the triangle's fixed lengths, m².
    #[doc(alias = "sl123")]
    pub squared: f64,
    /// Coefficient of cos θ, m².
    #[doc(alias = "mi")]
    pub cosine: f64,
    /// Coefficient of sin θ, m².
    #[doc(alias = "ni")]
    pub sine: f64,
    /// Screw length at home, m.
    pub length_at_home: f64,
    /// Motor position at home, rad.
    pub motor_at_home: f64,
    /// Range of the joint, rad. The screw must lengthen with the angle over the whole range.
    pub joint_limits: Limits,
    /// Range of the motor, rad.
    pub motor_limits: Limits,
}

impl ScrewAxis {
    /// Length of the screw at a joint angle, m.
    fn length(&self, joint: f64) -> f64 {
        let (sin, cos) = joint.sin_cos();
        (self.squared + self.cosine * cos + self.sine * sin).sqrt()
    }

    /// Twice the product of the length and its derivative by the joint angle, m²/rad.
    fn slope(&self, joint: f64) -> f64 {
        let (sin, cos) = joint.sin_cos();
        self.sine * cos - self.cosine * sin
    }

    /// The joint angle for a screw length. Fails with the nearest length that a triangle can have.
    pub(super) fn joint(&self, length: f64) -> Result<f64, f64> {
        let swing = self.cosine.hypot(self.sine);
        let excess = length * length - self.squared;
        let shortest = (self.squared - swing).sqrt();
        if length < shortest {
            return Err(shortest);
        }
        if excess > swing {
            return Err((self.squared + swing).sqrt());
        }
        // Of the two triangles with this length, the one whose angle grows as the screw lengthens.
        let slope = (swing * swing - excess * excess).max(0.0).sqrt();
        let sin = self.sine * excess - self.cosine * slope;
        let cos = self.cosine * excess + self.sine * slope;
        Ok(sin.atan2(cos))
    }

    /// Whether angles and screw lengths correspond one to one over the range.
    pub(super) fn is_unambiguous(&self) -> bool {
        let Limits { low, high } = self.joint_limits;
        let shortest = self.squared - self.cosine.hypot(self.sine);
        let (at_low, at_high) = (self.slope(low), self.slope(high));
        shortest > 0.0 && at_low > 0.0 && at_high > 0.0 && low >= -PI && high <= PI && high - low < PI
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Transmission {
    Gear(GearAxis),
    Screw(ScrewAxis),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrainAxis {
    pub(super) transmission: Transmission,
    /// Axis of a lower index that carries this axis. The motor of this axis sits before that joint and acts across it
    /// through a differential. The motor of that axis therefore turns this axis one to one.
    pub(super) carried_by: Option<usize>,
}

impl TrainAxis {
    fn motor_at_home(&self) -> f64 {
        match &self.transmission {
            Transmission::Gear(gear) => gear.motor_at_home,
            Transmission::Screw(screw) => screw.motor_at_home,
        }
    }

    fn limits(&self, space: Space) -> Limits {
        match (&self.transmission, space) {
            (Transmission::Gear(gear), Space::Joint) => gear.joint_limits,
            (Transmission::Gear(gear), Space::Motor) => gear.motor_limits,
            (Transmission::Screw(screw), Space::Joint) => screw.joint_limits,
            (Transmission::Screw(screw), Space::Motor) => screw.motor_limits,
        }
    }

    /// Range of the joint. For a gear, the range also keeps the motor within its limits while other axes carry the
    /// motor by `carried` rad.
    fn range(&self, carried: f64) -> Limits {
        let Transmission::Gear(gear) = &self.transmission else {
            return self.limits(Space::Joint);
        };
        let joint = |motor| (motor - gear.motor_at_home - carried) / gear.ratio + gear.joint_at_home;
        gear.joint_limits.within(gear.motor_limits.map(joint))
    }

    /// Motor angle from home for this joint position, without the motion of carrying axes, rad.
    fn travel(&self, joint: f64) -> f64 {
        match &self.transmission {
            Transmission::Gear(gear) => gear.ratio * (joint - gear.joint_at_home),
            Transmission::Screw(screw) => (screw.length(joint) - screw.length_at_home) * (TAU / screw.lead),
        }
    }

    /// The inverse of [`TrainAxis::travel`]. Fails with the nearest travel that has a joint position.
    fn joint(&self, travel: f64) -> Result<f64, f64> {
        match &self.transmission {
            Transmission::Gear(gear) => Ok(travel / gear.ratio + gear.joint_at_home),
            Transmission::Screw(screw) => screw
                .joint(travel * (screw.lead / TAU) + screw.length_at_home)
                .map_err(|length| (length - screw.length_at_home) * (TAU / screw.lead)),
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct DriveTrain<const N: usize> {
    axes: [TrainAxis; N],
    pub(super) joint_limits: [Limits; N],
    pub(super) motor_limits: [Limits; N],
    /// Range of each joint within the limits of joint and motor, without the motion of carrying axes.
    ranges: [Limits; N],
}

impl<const N: usize> DriveTrain<N> {
    pub(super) fn new(axes: [TrainAxis; N]) -> Self {
        Self {
            ranges: axes.map(|axis| axis.range(0.0)),
            joint_limits: axes.map(|axis| axis.limits(Space::Joint)),
            motor_limits: axes.map(|axis| axis.limits(Space::Motor)),
            axes,
        }
    }

    pub(super) fn home(&self) -> Motors {
        self.axes.map(|axis| axis.motor_at_home()).into()
    }

    /// Refuses a joint position beyond its limit.
    pub(super) fn check_joint(&self, axis: usize, joint: f64) -> Result<(), KinematicsError> {
        self.joint_limits[axis].check(Space::Joint, axis, joint)
    }

    /// Motor positions for joints. Both are checked against their limits.
    pub(super) fn motors_from_joints(&self, joints: &[f64; N]) -> Result<Motors, KinematicsError> {
        for (axis, &joint) in joints.iter().enumerate() {
            self.check_joint(axis, joint)?;
        }
        let mut motors = [0.0; N];
        for (index, axis) in self.axes.iter().enumerate() {
            let carried = axis.carried_by.map_or(0.0, |by| motors[by] - self.axes[by].motor_at_home());
            motors[index] = axis.motor_at_home() + axis.travel(joints[index]) + carried;
        }
        for (axis, &motor) in motors.iter().enumerate() {
            self.motor_limits[axis].check(Space::Motor, axis, motor)?;
        }
        Ok(motors.into())
    }

    /// Joints for motor positions. Only positions that the mechanism cannot take are refused.
    pub(super) fn joints_from_motors(&self, motors: &[f64; N]) -> Result<Joints, KinematicsError> {
        let mut joints = [0.0; N];
        for (index, axis) in self.axes.iter().enumerate() {
            let carried = axis.carried_by.map_or(0.0, |by| motors[by] - self.axes[by].motor_at_home());
            let home = axis.motor_at_home() + carried;
            joints[index] = axis.joint(motors[index] - home).map_err(|travel| {
                let (value, limit) = (motors[index], home + travel);
                KinematicsError::BeyondLimit { space: Space::Motor, axis: index as u8, value, limit }
            })?;
        }
        Ok(joints.into())
    }

    /// `angle` plus the whole turns that bring a geared joint nearest to `near`. Turns within the limits of joint and
    /// motor are preferred, if there are any. `joints` holds the axes that carry this axis.
    pub(super) fn turn(&self, index: usize, angle: f64, joints: &[f64; N], near: f64) -> f64 {
        let range = match self.axes[index].carried_by {
            Some(by) => self.axes[index].range(self.carried(by, joints)),
            None => self.ranges[index],
        };
        let mut nearest = angle;
        // Most angles need no turn, and rounding is a function call.
        if (near - angle).abs() > PI {
            nearest += TAU * ((near - angle) / TAU).round();
        }
        let inside = match range.exceeded_by(nearest) {
            None => return nearest,
            Some(limit) if limit == range.low => nearest + TAU * ((limit - nearest) / TAU).ceil(),
            Some(limit) => nearest - TAU * ((nearest - limit) / TAU).ceil(),
        };
        if range.exceeded_by(inside).is_none() { inside } else { nearest }
    }

    /// Sum of the motor angles of an axis and of the axes that carry the axis, rad.
    fn carried(&self, axis: usize, joints: &[f64; N]) -> f64 {
        let carriers = std::iter::successors(Some(axis), |&by| self.axes[by].carried_by);
        carriers.map(|by| self.axes[by].travel(joints[by])).sum()
    }
}
