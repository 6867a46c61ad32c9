use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    GearAxis, Jacobian, KinematicsError, Limits, ScrewAxis,
    drive_train::{Axis, Transmission},
    solutions::Search,
};

/// Below this sine of the angle between two axes they count as parallel, and below this distance, m,
/// a point counts as lying on an axis. A pose so close to a singularity is met within the same bound.
pub(super) const PARALLEL: f64 = 1e-10;

pub(super) const COLUMN: usize = 0;
pub(super) const SHOULDER: usize = 1;
pub(super) const ELBOW: usize = 2;
pub(super) const PITCH: usize = 3;
pub(super) const ROLL: usize = 4;

/// The arm that IRb-6 and IRp-6 share: column, lower arm, upper arm, wrist pitch, wrist roll.
///
/// Joints are absolute angles, as the drives set them: th1 turns the column about the vertical; th2,
/// th3 and th4 are the inclinations of lower arm, upper arm and wrist to the horizontal, positive
/// **down**, so that th2 = -90° is an upright lower arm and th3 = th4 = 0 a level upper arm and wrist;
/// th5 rolls the wrist. The upper arm keeps its inclination when the lower arm moves, and the wrist
/// keeps its own when either does, because parallelograms hold them; the roll motor sits before the
/// pitch and is carried by it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ArmParameters {
    /// Height of the shoulder axis above the base frame, m.
    #[doc(alias = "d1")]
    pub shoulder_height: f64,
    /// Shoulder axis to elbow axis, m.
    #[doc(alias = "a2")]
    pub lower_arm_length: f64,
    /// Elbow axis to pitch axis, m.
    #[doc(alias = "a3")]
    pub upper_arm_length: f64,
    /// Pitch axis to flange frame along the roll axis, m.
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
    /// The arm under the WUT robots on a pedestal, base frame at the shoulder.
    ///
    /// From public code: lengths, gears, screws, home positions and limits. There the limits of th3
    /// and th4 are applied to relative angles by the latest version and to the absolute ones by the
    /// mechanism and by versions before; here they are absolute.
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
                motor_limits: Limits {
                    low: -470.0,
                    high: 450.0,
                },
            },
            lower_arm: ScrewAxis {
                lead: 0.005,
                squared: 0.077_895_25,
                cosine: 0.060_902_55,
                sine: 0.029_346_68,
                length_at_home: 0.220_337_4,
                motor_at_home: -5.0,
                joint_limits: degrees(-130.0, -50.0),
                motor_limits: Limits {
                    low: -110.0,
                    high: 100.0,
                },
            },
            upper_arm: ScrewAxis {
                lead: 0.005,
                squared: 0.077_895_25,
                cosine: -0.044_1,
                sine: 0.051_24,
                length_at_home: 0.183_834_8,
                motor_at_home: -8.527,
                joint_limits: degrees(-25.0, 40.0),
                motor_limits: Limits {
                    low: -80.0,
                    high: 100.0,
                },
            },
            pitch: GearAxis {
                ratio: -128.0,
                joint_at_home: 0.0,
                motor_at_home: 151.31,
                joint_limits: degrees(-90.0, 92.0),
                motor_limits: Limits {
                    low: -70.0,
                    high: 380.0,
                },
            },
            // The bevel gear behind the harmonic drive of 128 multiplies it by 0.6.
            roll: GearAxis {
                ratio: -76.8,
                joint_at_home: 0.0,
                motor_at_home: 435.25,
                joint_limits: Limits {
                    low: -10.0,
                    high: 10.0,
                },
                motor_limits: Limits {
                    low: -80.0,
                    high: 490.0,
                },
            },
        }
    }

    /// The drive train's first five axes, once every parameter has been found sound.
    pub(super) fn axes(&self) -> Result<[Axis; 5], ParameterError> {
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
            Axis {
                carried_by: Some(PITCH),
                ..gear("roll", &self.roll)?
            },
        ])
    }
}

/// Why a set of parameters describes no robot.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ParameterError {
    /// A NaN or an infinity.
    #[error("{name} has a number that is not finite")]
    NotFinite {
        /// The parameter or the axis it belongs to.
        name: &'static str,
    },
    /// A length or a tolerance that must be above zero.
    #[error("{name} is {value}, not above zero")]
    NotPositive {
        /// The parameter.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// A gear or a screw that turns nothing.
    #[error("{name} has a ratio of zero")]
    NoRatio {
        /// The axis.
        name: &'static str,
    },
    /// Limits without room between them.
    #[error("{name} has limits {low} .. {high}")]
    EmptyRange {
        /// The axis.
        name: &'static str,
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// A screw that does not lengthen all over the range of its joint, or whose triangle collapses.
    #[error("{name} has a screw whose length does not determine the joint")]
    AmbiguousScrew {
        /// The axis.
        name: &'static str,
    },
}

/// A rotary axis found sound.
pub(super) fn gear(name: &'static str, gear: &GearAxis) -> Result<Axis, ParameterError> {
    for value in [gear.ratio, gear.joint_at_home, gear.motor_at_home] {
        finite(name, value)?;
    }
    if gear.ratio == 0.0 {
        return Err(ParameterError::NoRatio { name });
    }
    room(name, gear.joint_limits)?;
    room(name, gear.motor_limits)?;
    Ok(Axis {
        transmission: Transmission::Gear(*gear),
        carried_by: None,
    })
}

/// A screw axis found sound.
fn screw(name: &'static str, screw: &ScrewAxis) -> Result<Axis, ParameterError> {
    let ScrewAxis {
        lead,
        squared,
        cosine,
        sine,
        length_at_home,
        motor_at_home,
        ..
    } = *screw;
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
    Ok(Axis {
        transmission: Transmission::Screw(*screw),
        carried_by: None,
    })
}

fn finite(name: &'static str, value: f64) -> Result<(), ParameterError> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(ParameterError::NotFinite { name })
    }
}

/// Refuses what is not above zero.
pub(super) fn positive(name: &'static str, value: f64) -> Result<(), ParameterError> {
    finite(name, value)?;
    if value > 0.0 {
        Ok(())
    } else {
        Err(ParameterError::NotPositive { name, value })
    }
}

fn room(name: &'static str, Limits { low, high }: Limits) -> Result<(), ParameterError> {
    finite(name, low)?;
    finite(name, high)?;
    if low < high {
        Ok(())
    } else {
        Err(ParameterError::EmptyRange { name, low, high })
    }
}

const fn degrees(low: f64, high: f64) -> Limits {
    Limits {
        low: low.to_radians(),
        high: high.to_radians(),
    }
}

/// Sines and cosines of the column and of the three inclinations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Posture {
    sin: [f64; 4],
    cos: [f64; 4],
}

impl Posture {
    pub(super) fn new(th1: f64, th2: f64, th3: f64, th4: f64) -> Self {
        let both = [th1, th2, th3, th4].map(f64::sin_cos);
        Self {
            sin: both.map(|(sin, _)| sin),
            cos: both.map(|(_, cos)| cos),
        }
    }

    /// The wrist before its roll.
    pub(super) fn wrist(&self) -> Matrix3<f64> {
        wrist((self.sin[0], self.cos[0]), (self.sin[3], self.cos[3]))
    }
}

/// `base_from_wrist` before the roll, for the sine and cosine of column and pitch. Its z axis is the
/// roll axis; the column turns it by th1 about the vertical, the pitch by th4 about its own -y axis.
pub(super) fn wrist((s1, c1): (f64, f64), (s4, c4): (f64, f64)) -> Matrix3<f64> {
    Matrix3::new(
        c1 * s4,
        s1,
        c1 * c4, //
        s1 * s4,
        -c1,
        s1 * c4, //
        c4,
        0.0,
        -s4,
    )
}

/// A column angle and a pitch at which branches are sought, as (sine, cosine), and the flange's origin
/// in the vertical plane they face: `reach` m ahead, negative behind, and `height` m above the base.
pub(super) struct Facing {
    pub(super) th1: (f64, f64),
    pub(super) pitch: (f64, f64),
    pub(super) reach: f64,
    pub(super) height: f64,
}

/// Distance of the flange's origin from the column's axis, where th1 is determined, m.
pub(super) fn radius(origin: &Vector3<f64>) -> Result<f64, KinematicsError> {
    let radius = (origin.x * origin.x + origin.y * origin.y).sqrt();
    if radius < PARALLEL {
        return Err(KinematicsError::Singular { axis: COLUMN as u8 });
    }
    Ok(radius)
}

/// A pose given by the axes of its frame as columns.
pub(super) fn pose(origin: Vector3<f64>, axes: Matrix3<f64>) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(axes);
    Isometry3::from_parts(
        Translation3::from(origin),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// Origin and axes of a pose; refuses what is not finite.
pub(super) fn parts(
    pose: &Isometry3<f64>,
) -> Result<(Vector3<f64>, Matrix3<f64>), KinematicsError> {
    let finite = |value: &f64| value.is_finite();
    let (origin, rotation) = (&pose.translation.vector, &pose.rotation);
    if origin.iter().all(finite) && rotation.coords.iter().all(finite) {
        Ok((*origin, rotation.to_rotation_matrix().into_inner()))
    } else {
        Err(KinematicsError::NotFinite)
    }
}

impl ArmParameters {
    /// The flange's origin in the base frame.
    pub(super) fn origin(&self, Posture { sin, cos }: &Posture) -> Vector3<f64> {
        let lengths = [
            self.lower_arm_length,
            self.upper_arm_length,
            self.wrist_length,
        ];
        let (mut reach, mut drop) = (0.0, 0.0);
        for (index, length) in lengths.into_iter().enumerate() {
            reach += length * cos[index + 1];
            drop += length * sin[index + 1];
        }
        Vector3::new(cos[0] * reach, sin[0] * reach, self.shoulder_height - drop)
    }

    /// The Jacobian's columns of th1 .. th5; those behind stay zero.
    pub(super) fn jacobian(&self, posture: &Posture) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        let Posture { sin, cos } = posture;
        let origin = self.origin(posture);
        jacobian
            .fixed_view_mut::<3, 1>(0, 0)
            .copy_from(&Vector3::new(-origin.y, origin.x, 0.0));
        jacobian[(5, 0)] = 1.0;
        let lengths = [
            self.lower_arm_length,
            self.upper_arm_length,
            self.wrist_length,
        ];
        for (index, length) in (1..=PITCH).zip(lengths) {
            let (s, c) = (length * sin[index], length * cos[index]);
            let moved = Vector3::new(-cos[0] * s, -sin[0] * s, -c);
            jacobian.fixed_view_mut::<3, 1>(0, index).copy_from(&moved);
        }
        // Parallelograms keep the flange's orientation while lower and upper arm move.
        let wrist = posture.wrist();
        jacobian
            .fixed_view_mut::<3, 1>(3, PITCH)
            .copy_from(&-wrist.column(1));
        jacobian
            .fixed_view_mut::<3, 1>(3, PITCH + 1)
            .copy_from(&wrist.column(2));
        jacobian
    }

    /// Follows the branches of one column angle and one pitch. `set_wrist` sets the axes behind the
    /// pitch, given the wrist's frame before its roll.
    pub(super) fn branches<const N: usize>(
        &self,
        search: &mut Search<'_, N>,
        at: &Facing,
        set_wrist: impl Fn(&Search<'_, N>, &mut [f64; N], &Matrix3<f64>),
    ) {
        let (s4, c4) = at.pitch;
        let mut joints = *search.near();
        search.turn(&mut joints, PITCH, s4.atan2(c4));
        if !search.follow(&joints, &[PITCH]) {
            return;
        }
        let (s1, c1) = at.th1;
        search.turn(&mut joints, COLUMN, s1.atan2(c1));
        let reach = at.reach - self.wrist_length * c4;
        let drop = self.shoulder_height - at.height - self.wrist_length * s4;
        let shoulders = match self.shoulders(reach, drop) {
            Ok(shoulders) => shoulders,
            Err(margin) => {
                let error = KinematicsError::Unreachable { margin };
                return search.refuse(&joints, &[COLUMN, PITCH], error);
            }
        };
        for (s2, c2) in shoulders {
            joints[SHOULDER] = s2.atan2(c2);
            if !search.follow(&joints, &[COLUMN, SHOULDER, PITCH]) {
                continue;
            }
            let lower = self.lower_arm_length;
            joints[ELBOW] = (drop - lower * s2).atan2(reach - lower * c2);
            set_wrist(search, &mut joints, &wrist(at.th1, at.pitch));
            search.offer(joints);
        }
    }

    /// Sine and cosine of the two th2 that let the pitch axis stand `reach` m ahead of the shoulder and
    /// `drop` m below it, or how much the arm lacks, m.
    fn shoulders(&self, reach: f64, drop: f64) -> Result<[(f64, f64); 2], f64> {
        let (lower, upper) = (self.lower_arm_length, self.upper_arm_length);
        let square = reach * reach + drop * drop;
        let span = square.sqrt();
        let margin = (span - (lower + upper)).max((lower - upper).abs() - span);
        if margin > 0.0 || span == 0.0 {
            return Err(margin);
        }
        // The angle at the shoulder between the lower arm and the line to the pitch axis.
        let cos = (square + lower * lower - upper * upper) / (2.0 * lower * span);
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let th2 = |sin: f64| {
            (
                (drop * cos + reach * sin) / span,
                (reach * cos - drop * sin) / span,
            )
        };
        Ok([th2(sin), th2(-sin)])
    }
}
