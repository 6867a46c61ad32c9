//! Kinematics of the IRp-6 on its track.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

use super::room::room;
use super::{
    GearAxis, Irp6, Irp6Parameters, Jacobian, Joints, KinematicsError, Limits, Link, LinkKind, Mass, MotorRating,
    Motors, ParameterError, Robot, RobotParameters, Solutions,
    drive_train::DriveTrain,
    free_parameter::{self, Ring},
    parameters,
};

const AXES: usize = 7;
const ARM: usize = 6;

/// Distances of the flange from the column axis between which the carriage stays at its position, m.
const COMFORT: (f64, f64) = (0.6, 0.95);
/// Tangent of 40°: half the angle of the sector behind the robot in which the column should not work.
const BEHIND: f64 = 0.839_099_631_177_280;
/// Distance from a comfortable position, m, within which the carriage moves more and more slowly.
const BAND: f64 = 0.1;
/// Lever that converts a rotation of the flange to a distance, m.
const LEVER: f64 = 0.25;

/// First detour of the carriage if the arm cannot take the pose from its present position, m. Each further detour is
/// half as long again, up to 1.1 m.
const DETOUR: f64 = 0.000_1;
const DETOURS: i32 = 24;

/// Number of evenly spaced positions along the track that are tried last.
const PLACES: u32 = 64;

/// Parameters of one IRp-6 on its track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Irp6TrackParameters {
    /// Drive of d0, the carriage. Lengths are in m where `GearAxis` says rad.
    pub track: GearAxis,
    /// The robot on the carriage.
    pub robot: Irp6Parameters,
}

impl Irp6TrackParameters {
    /// The robot of the WUT with the parameters of its original controller (public code). The arm is that of the
    /// robot on the pedestal with other home positions. The ratio of the track is derived from a screw of 8 mm behind
    /// a belt of 2:1. Later versions of that code have the column's home at -16.5 rad.
    pub const fn irp6ot() -> Self {
        let mut robot = Irp6Parameters::irp6p();
        robot.arm.column.motor_at_home = -10.819;
        robot.arm.lower_arm.motor_at_home = -4.012;
        robot.arm.upper_arm.motor_at_home = -6.219;
        robot.arm.pitch.motor_at_home = 158.997;
        robot.arm.roll.motor_at_home = 479.5;
        robot.hand.motor_at_home = 769.7;
        Self {
            track: GearAxis {
                ratio: 500.0 * std::f64::consts::PI,
                joint_at_home: 0.0,
                motor_at_home: 0.0,
                joint_limits: Limits::new(-0.125, 1.21),
                motor_limits: Limits::new(-200.0, 1900.0),
            },
            robot,
        }
    }

    /// The same robot as calibrated in February 2007 (public code). The home positions belong to the state of the
    /// machine at that time. The two sets of parameters must not be mixed. Limits and gears are the nominal ones.
    /// Home differs from the upright posture: lower arm at -96.3°, upper arm at 0.7° (derived).
    pub const fn irp6ot_calibrated() -> Self {
        let mut parameters = Self::irp6ot();
        parameters.track.motor_at_home = -0.0117;
        let robot = &mut parameters.robot;
        let arm = &mut robot.arm;
        arm.lower_arm_length = 0.4647;
        arm.upper_arm_length = 0.6748;
        arm.wrist_length = 0.1967;
        arm.column.joint_at_home = 0.004_989;
        arm.column.motor_at_home = -7.185;
        arm.lower_arm.squared = 0.079_744_63;
        arm.lower_arm.cosine = 0.065_788_63;
        arm.lower_arm.sine = 0.022_524_88;
        arm.lower_arm.length_at_home = 0.223_976_5;
        arm.lower_arm.motor_at_home = -23.7333;
        arm.upper_arm.squared = 0.079_744_63;
        arm.upper_arm.cosine = -0.044_612_77;
        arm.upper_arm.sine = 0.052_925_22;
        arm.upper_arm.length_at_home = 0.189_112_3;
        arm.upper_arm.motor_at_home = -4.0065;
        arm.pitch.motor_at_home = 153.6764;
        arm.roll.joint_at_home = 0.000_898;
        arm.roll.motor_at_home = 356.0929;
        robot.hand.joint_at_home = 0.005_605;
        robot.hand.motor_at_home = 791.4409;
        parameters
    }
}

/// The WUT IRp-6 on a carriage that slides along the base frame's y axis.
///
/// Joints: d0, m, then th1 .. th6 of [`Irp6`]. The base frame is that of the robot with the carriage at zero.
///
/// A pose leaves d0 open. [`Robot::inverse`] keeps the carriage position of `near` if the flange is 0.6 to 0.95 m
/// from the column axis and outside a sector of ±40° straight behind the column. Otherwise the carriage moves towards
/// the nearest position that meets both conditions. The displacement of the carriage is at most twice the distance
/// moved by the flange, so that a pose far from `near` gets the full displacement.
///
/// If the arm cannot take the pose from the resulting position, other positions are tried. First comes the position
/// of `near`, then positions at growing distances, and finally positions along the whole track. For each position one
/// branch remains within the limits, as for [`Irp6`].
#[derive(Clone, Debug, PartialEq)]
pub struct Irp6Track {
    robot: Irp6,
    track: DriveTrain<1>,
    joint_limits: [Limits; AXES],
    motor_limits: [Limits; AXES],
}

impl Irp6Track {
    /// A robot with these parameters. Fails if a parameter is invalid.
    pub fn new(parameters: &Irp6TrackParameters) -> Result<Self, ParameterError> {
        let robot = Irp6::new(&parameters.robot)?;
        let track = DriveTrain::new([parameters::gear("track", &parameters.track)?]);
        let both = |track: &[Limits; 1], robot: &[Limits]| {
            std::array::from_fn(|axis| if axis == 0 { track[0] } else { robot[axis - 1] })
        };
        Ok(Self {
            joint_limits: both(&track.joint_limits, robot.joint_limits()),
            motor_limits: both(&track.motor_limits, robot.motor_limits()),
            robot,
            track,
        })
    }

    /// The solutions for a given position of the carriage, m, nearest to `near` first.
    pub fn inverse_at(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &Joints,
        carriage: f64,
    ) -> Result<Solutions, KinematicsError> {
        let (_, arm) = parted(near)?;
        if !carriage.is_finite() {
            return Err(KinematicsError::NotFinite);
        }
        self.track.motors_from_joints(&[carriage])?;
        let carriage_from_flange = Translation3::new(0.0, -carriage, 0.0) * base_from_flange;
        self.robot
            .inverse(&carriage_from_flange, &arm)
            .map(|solutions| solutions.map(|arm| joined(carriage, arm)))
            .map_err(on_carriage)
    }

    /// Range of the carriage that joint and motor both allow, m.
    fn travel(&self) -> Limits {
        let joint = |motor| self.track.joints_from_motors(&[motor]).map_or(0.0, |joints| joints[0]);
        self.joint_limits[0].within(self.motor_limits[0].map(joint))
    }

    /// The most comfortable position of the carriage for a pose, m.
    fn comfort(&self, flange: &Vector3<f64>, carriage: f64) -> f64 {
        let Limits { low, high } = self.travel();
        let (near, far) = COMFORT;
        let beside = |radius: f64| (radius * radius - flange.x * flange.x).max(0.0).sqrt();
        let inner = beside(near).max(-flange.x * BEHIND);
        let ring = Ring { centre: flange.y, inner, outer: beside(far).max(inner), low, high };
        let anywhere = Ring { low: f64::NEG_INFINITY, high: f64::INFINITY, ..ring };
        ring.nearest(carriage).or_else(|_| anywhere.nearest(carriage)).unwrap_or(carriage).clamp(low, high)
    }
}

impl Robot for Irp6Track {
    fn joint_limits(&self) -> &[Limits] {
        &self.joint_limits
    }

    fn motor_limits(&self) -> &[Limits] {
        &self.motor_limits
    }

    fn home(&self) -> Motors {
        joined(self.track.home()[0], &self.robot.home())
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        let (carriage, arm) = parted(joints)?;
        Ok(Translation3::new(0.0, carriage, 0.0) * self.robot.forward(&arm)?)
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        let here = self.forward(near)?;
        let (carriage, _) = parted(near)?;
        let flange = base_from_flange.translation.vector;
        if !flange.iter().all(|value| value.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        let way =
            (flange - here.translation.vector).norm() + LEVER * here.rotation.angle_to(&base_from_flange.rotation);
        let comfort = self.comfort(&flange, carriage);
        let place = free_parameter::drift(carriage, comfort, way, BAND);
        let at = |place| self.inverse_at(base_from_flange, near, place);
        let refusal = match at(place) {
            Err(KinematicsError::NotFinite) => return Err(KinematicsError::NotFinite),
            Err(refusal) => refusal,
            found => return found,
        };
        let detours = (0..DETOURS).flat_map(|detour| {
            let detour = DETOUR * 1.5_f64.powi(detour);
            [carriage - detour, carriage + detour]
        });
        let Limits { low, high } = self.travel();
        let pitch = (high - low) / f64::from(PLACES);
        let everywhere = (0..=PLACES).map(|place| low + pitch * f64::from(place));
        [carriage]
            .into_iter()
            .chain(detours)
            .chain([comfort, flange.y])
            .chain(everywhere)
            .filter(|place| *place >= low && *place <= high)
            .find_map(|place| at(place).ok())
            .ok_or(refusal)
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        let (carriage, arm) = parted(joints)?;
        let track = self.track.motors_from_joints(&[carriage])?;
        let motors = self.robot.motors_from_joints(&arm).map_err(on_carriage)?;
        Ok(joined(track[0], &motors))
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        let (track, arm) = parted(motors)?;
        let carriage = self.track.joints_from_motors(&[track])?;
        let joints = self.robot.joints_from_motors(&arm).map_err(on_carriage)?;
        Ok(joined(carriage[0], &joints))
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let (_, arm) = parted(joints)?;
        let arm = self.robot.jacobian(&arm)?;
        let mut jacobian = Jacobian::zeros();
        jacobian[(1, 0)] = 1.0;
        jacobian.fixed_columns_mut::<ARM>(1).copy_from(&arm.fixed_columns::<ARM>(0));
        Ok(jacobian)
    }

    fn links(&self) -> Vec<Link> {
        let mut links = self.robot.links();
        for link in &mut links {
            link.coupling.rotate_right(1);
        }
        let mut coupling = [0.0; servo::MAX_AXES];
        coupling[0] = 1.0;
        let track = Link {
            name: "track".into(),
            kind: LinkKind::Prismatic,
            parent_from_link: Isometry3::identity(),
            axis: Vector3::y_axis(),
            coupling,
            limits: self.joint_limits[0],
        };
        links.insert(0, track);
        links
    }

    fn lower_arm(&self) -> Option<usize> {
        self.robot.lower_arm().map(|axis| axis + 1)
    }
}

fn parted<S>(all: &super::Vector<S>) -> Result<(f64, super::Vector<S>), KinematicsError> {
    let &[carriage, ref arm @ ..] = all.exactly::<AXES>()?;
    Ok((carriage, super::Vector::from(*arm)))
}

/// Joins the carriage's position and the arm's positions. The inverse of [`parted`].
fn joined<S>(carriage: f64, arm: &super::Vector<S>) -> super::Vector<S> {
    let mut all = [carriage; AXES];
    all[1..].copy_from_slice(arm);
    super::Vector::from(all)
}

/// An error of the arm, with its axis counted from the track.
fn on_carriage(mut error: KinematicsError) -> KinematicsError {
    use KinematicsError::{BeyondLimit, Singular};
    if let Singular { axis, .. } | BeyondLimit { axis, .. } = &mut error {
        *axis += 1;
    }
    error
}

impl RobotParameters for Irp6TrackParameters {
    fn axes(&self) -> usize {
        7
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(Irp6Track::new(self)?))
    }

    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self {
            track: self.track.with_room(room(motors, 0), 0.0),
            robot: self.robot.with_room_at_home(motors.get(1..).unwrap_or(&[])),
        }
    }

    fn masses(&self) -> Vec<Mass> {
        let [column, lower_arm, upper_arm, pitch, roll, hand] = Mass::IRP6;
        let carriage = Mass::new(60.0, [0.0; 3]);
        vec![carriage, column, lower_arm, upper_arm, pitch, roll, hand]
    }

    // The track has the motor of the column.
    fn motors(&self) -> Vec<MotorRating> {
        let [column, lower_arm, upper_arm, pitch, roll, hand] = MotorRating::IRP6;
        vec![column, column, lower_arm, upper_arm, pitch, roll, hand]
    }
}
