//! Parameters of the arm that IRb-6 and IRp-6 share, and errors of parameters.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    GearAxis, Limits, ScrewAxis,
    arm::PITCH,
    drive_train::{TrainAxis, Transmission},
    room,
};

/// The arm that IRb-6 and IRp-6 share: column, lower arm, upper arm, wrist pitch, wrist roll.
///
/// Joints are absolute angles, as the drives set them. th1 turns the column about the vertical. th2, th3 and th4 are
/// the inclinations of lower arm, upper arm and wrist to the horizontal, positive **down**. th2 = -90° is an upright
/// lower arm. th3 = th4 = 0 is a level upper arm and wrist. th5 rolls the wrist.
///
/// Parallelograms keep the inclination of the upper arm when the lower arm moves, and the inclination of the wrist
/// when either arm moves. The roll motor sits before the pitch joint, so that the pitch carries the roll.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ArmParameters {
    /// Height of the shoulder axis above the base frame, m.
    #[doc(alias = "d1")]
    pub shoulder_height: f64,
    /// Distance from the shoulder axis to the elbow axis, m.
    #[doc(alias = "a2")]
    pub lower_arm_length: f64,
    /// Distance from the elbow axis to the pitch axis, m.
    #[doc(alias = "a3")]
    pub upper_arm_length: f64,
    /// Distance from the pitch axis to the flange frame along the roll axis, m.
    #[doc(alias = "d5")]
    pub wrist_length: f64,
    /// Drive of th1.
    pub column: GearAxis,
    /// Drive of th2.
    pub lower_arm: ScrewAxis,
    /// Drive of th3.
    pub upper_arm: ScrewAxis,
    /// Drive of th4.
    pub pitch: GearAxis,
    /// Drive of th5.
    pub roll: GearAxis,
}

impl ArmParameters {
    /// The arm of the WUT robots on a pedestal, with the base frame at the shoulder.
    ///
    /// From public code: lengths, gears, screws, home positions and limits. The latest version of the code applies
    /// the limits of th3 and th4 to relative angles. Earlier versions and the mechanism itself apply the limits to
    /// absolute angles, as here.
    pub(super) const fn nominal() -> Self {
        Self {
            shoulder_height: 0.0,
            lower_arm_length: 0.455,
            upper_arm_length: 0.670,
            wrist_length: 0.190,
            column: GearAxis {
                ratio: -158.0,
                joint_at_home: 0.0,
                motor_at_home: -15.9,
                joint_limits: degrees(-170.0, 170.0),
                motor_limits: Limits::new(-470.0, 450.0),
            },
            lower_arm: ScrewAxis {
                lead: 0.005,
                squared: 0.077_895_25,
                cosine: 0.060_902_55,
                sine: 0.029_346_68,
                length_at_home: 0.220_337_4,
                motor_at_home: -5.0,
                joint_limits: degrees(-130.0, -50.0),
                motor_limits: Limits::new(-110.0, 100.0),
            },
            upper_arm: ScrewAxis {
                lead: 0.005,
                squared: 0.077_895_25,
                cosine: -0.044_1,
                sine: 0.051_24,
                length_at_home: 0.183_834_8,
                motor_at_home: -8.527,
                joint_limits: degrees(-25.0, 40.0),
                motor_limits: Limits::new(-80.0, 100.0),
            },
            pitch: GearAxis {
                ratio: -128.0,
                joint_at_home: 0.0,
                motor_at_home: 151.31,
                joint_limits: degrees(-90.0, 92.0),
                motor_limits: Limits::new(-70.0, 380.0),
            },
            // The bevel gear behind the harmonic drive of 128 multiplies the ratio by 0.6.
            roll: GearAxis {
                ratio: -76.8,
                joint_at_home: 0.0,
                motor_at_home: 435.25,
                joint_limits: Limits::new(-10.0, 10.0),
                motor_limits: Limits::new(-80.0, 490.0),
            },
        }
    }

    /// The first five axes of the drive train, after a check of every parameter.
    pub(super) fn axes(&self) -> Result<[TrainAxis; 5], ParameterError> {
        finite("shoulder_height", self.shoulder_height)?;
        for (name, length) in [
            ("lower_arm_length", self.lower_arm_length),
            ("upper_arm_length", self.upper_arm_length),
            ("wrist_length", self.wrist_length),
        ] {
            positive(name, length)?;
        }
        Ok([
            gear("column", &self.column)?,
            screw("lower_arm", &self.lower_arm)?,
            screw("upper_arm", &self.upper_arm)?,
            gear("pitch", &self.pitch)?,
            TrainAxis { carried_by: Some(PITCH), ..gear("roll", &self.roll)? },
        ])
    }
}

/// Reasons why a set of parameters describes no robot.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum ParameterError {
    #[error("{name} has a number that is not finite")]
    NotFinite { name: &'static str },
    #[error("{name} is {value}, not above zero")]
    NotPositive { name: &'static str, value: f64 },
    #[error("{name} has a ratio of zero")]
    NoRatio { name: &'static str },
    /// The lower limit is not below the upper limit.
    #[error("{name} has limits {low} .. {high}")]
    EmptyRange { name: &'static str, low: f64, high: f64 },
    /// A screw does not lengthen over the whole range of its joint, or its triangle collapses.
    #[error("{name} has a screw whose length does not determine the joint")]
    AmbiguousScrew { name: &'static str },
    /// A tilt at which a platform would hang beside its base.
    #[error("{name} tilts by {tilt:.6} rad, more than {limit} rad", limit = super::legs::STEEPEST)]
    TooSteep { name: &'static str, tilt: f64 },
    /// A leg is too short or too long for the geometry with alpha, beta and rho in the middle of their limits. Legs are
    /// counted from 0.
    #[error("leg {leg} is {length:.6} m long amid the workspace, outside its range {low} .. {high} m")]
    LegReach { leg: u8, length: f64, low: f64, high: f64 },
    /// The legs cannot have their home lengths at the same time. Legs are counted from 0.
    #[error("the legs do not close at home: leg {leg} misses its length by {residual:.6} m at the least")]
    OpenAtHome { leg: u8, residual: f64 },
    /// The description of a chain.
    #[error("{0}")]
    Chain(#[from] super::ChainError),
    /// The masses do not match the links.
    #[error("{0}")]
    Weight(super::WeightError),
    /// The legs do not determine the pose of the platform in the whole workspace.
    #[error("the legs lose hold of the platform before alpha {alpha:.6}, beta {beta:.6} rad, rho {rho:.6} m")]
    NoHold { alpha: f64, beta: f64, rho: f64 },
}

/// The axis of a gear, after a check of its parameters.
pub(super) fn gear(name: &'static str, gear: &GearAxis) -> Result<TrainAxis, ParameterError> {
    for value in [gear.ratio, gear.joint_at_home, gear.motor_at_home] {
        finite(name, value)?;
    }
    if gear.ratio == 0.0 {
        return Err(ParameterError::NoRatio { name });
    }
    if !gear.joint_limits.is_continuous() {
        room(name, gear.joint_limits)?;
    }
    room(name, gear.motor_limits)?;
    Ok(TrainAxis { transmission: Transmission::Gear(*gear), carried_by: None })
}

/// The axis of a screw, after a check of its parameters.
fn screw(name: &'static str, screw: &ScrewAxis) -> Result<TrainAxis, ParameterError> {
    let ScrewAxis { lead, squared, cosine, sine, length_at_home, motor_at_home, .. } = *screw;
    for value in [lead, squared, cosine, sine, length_at_home, motor_at_home] {
        finite(name, value)?;
    }
    if lead == 0.0 {
        return Err(ParameterError::NoRatio { name });
    }
    room(name, screw.joint_limits)?;
    room(name, screw.motor_limits)?;
    if !screw.is_unambiguous() {
        return Err(ParameterError::AmbiguousScrew { name });
    }
    Ok(TrainAxis { transmission: Transmission::Screw(*screw), carried_by: None })
}

pub(super) fn finite(name: &'static str, value: f64) -> Result<(), ParameterError> {
    if value.is_finite() { Ok(()) } else { Err(ParameterError::NotFinite { name }) }
}

pub(super) fn positive(name: &'static str, value: f64) -> Result<(), ParameterError> {
    finite(name, value)?;
    if value > 0.0 { Ok(()) } else { Err(ParameterError::NotPositive { name, value }) }
}

/// Refuses limits whose lower limit is not below the upper limit.
pub(super) fn room(name: &'static str, Limits { low, high }: Limits) -> Result<(), ParameterError> {
    finite(name, low)?;
    finite(name, high)?;
    if low < high { Ok(()) } else { Err(ParameterError::EmptyRange { name, low, high }) }
}

pub(super) const fn degrees(low: f64, high: f64) -> Limits {
    Limits::new(low.to_radians(), high.to_radians())
}

impl ArmParameters {
    /// The same with room for its five motors beside their homes.
    pub(super) fn with_room_at_home(self, motors: &[f64]) -> Self {
        let room = |axis| room::room(motors, axis);
        Self {
            column: self.column.with_room(room(0), 0.0),
            lower_arm: self.lower_arm.with_room(room(1)),
            upper_arm: self.upper_arm.with_room(room(2)),
            pitch: self.pitch.with_room(room(3), 0.0),
            roll: self.roll.with_room(room(4), room(3)),
            ..self
        }
    }
}
