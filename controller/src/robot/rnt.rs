//! Kinematics of the RNT, serial-parallel.

use std::{f64::consts::TAU, sync::Arc};

use nalgebra::{Isometry3, Rotation3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::room::room;
use super::{
    GearAxis, Jacobian, Joints, KinematicsError, Limits, Link, LinkKind, Mass, MotorRating, Motors, ParameterError,
    Robot, RobotParameters, Solutions, Space,
    arm::{self, INDISTINCT, PARALLEL},
    drive_train::{DriveTrain, TrainAxis},
    legs::{self, Legs, Posture},
    parameters,
    solutions::Search,
};

const AXES: usize = 6;
const ALPHA: usize = 0;
const BETA: usize = 1;
const RHO: usize = 2;
const ROLL: usize = 3;
const PITCH: usize = 4;
const SPIN: usize = 5;

/// One leg: a ball screw that the motor drives directly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LegAxis {
    /// Leg travel per motor turn, m, positive if the leg lengthens as the motor turns forward.
    pub lead: f64,
    /// Leg length at home, m.
    pub length_at_home: f64,
    /// Motor position at home, rad.
    pub motor_at_home: f64,
    /// Range of the leg's length, m. The range of its motor follows from the lengths.
    pub length_limits: Limits,
}

/// Parameters of one RNT.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RntParameters {
    /// Radius of the circle of the legs' joints on the base, m.
    pub base_radius: f64,
    /// Radius of the circle of the legs' joints on the platform, m.
    pub platform_radius: f64,
    /// Distance from the platform to the wrist centre along the central leg, m.
    pub wrist_offset: f64,
    /// The legs at 0°, 120° and 240° from the base's x axis.
    pub legs: [LegAxis; 3],
    /// Range of alpha, the tilt of the central leg about the base's x axis, rad; within ±80°.
    pub alpha: Limits,
    /// Range of beta, the tilt of the central leg about its own y axis, rad; within ±80°.
    pub beta: Limits,
    /// Range of rho, the distance from base to platform, m; above zero.
    pub extension: Limits,
    /// The wrist's first axis, along the central leg.
    pub roll: GearAxis,
    /// The wrist's second axis, across the first.
    pub pitch: GearAxis,
    /// The wrist's third axis, the flange's z axis.
    pub spin: GearAxis,
}

impl RntParameters {
    /// A substitute for the RNT: **every number is nominal**, none was measured or published. The model has the size
    /// of a tripod with a 0.70 m base, directly driven ball screws of 5 mm, and harmonic drives of 100:1 in the
    /// wrist. The data of the real machine are to be set in the cell file.
    pub const fn nominal() -> Self {
        let leg =
            LegAxis { lead: 0.005, length_at_home: 0.75, motor_at_home: 0.0, length_limits: Limits::new(0.55, 1.38) };
        let tilt = parameters::degrees(-30.0, 30.0);
        Self {
            base_radius: 0.350,
            platform_radius: 0.160,
            wrist_offset: 0.200,
            legs: [leg; 3],
            alpha: tilt,
            beta: tilt,
            extension: Limits::new(0.70, 1.20),
            roll: wrist(180.0),
            pitch: wrist(110.0),
            spin: wrist(180.0),
        }
    }

    /// End points of each leg, in the base frame and in the platform's frame, m.
    pub fn leg_ends(&self) -> [[Vector3<f64>; 2]; 3] {
        self.geometry().ends()
    }

    fn geometry(&self) -> Legs {
        Legs::new(self.base_radius, self.platform_radius)
    }
}

/// A wrist axis of ± `range` degrees.
const fn wrist(range: f64) -> GearAxis {
    const RATIO: f64 = 100.0;
    let limits = parameters::degrees(-range, range);
    GearAxis {
        ratio: RATIO,
        joint_at_home: 0.0,
        motor_at_home: 0.0,
        joint_limits: limits,
        motor_limits: Limits::new(RATIO * limits.low, RATIO * limits.high),
    }
}

/// The RNT, a serial-parallel robot. Three driven legs around a passive central leg carry a platform (joints alpha,
/// beta and rho). A wrist of three axes stands on the platform. The wrist axes meet on the line of the central leg.
///
/// The geometry is a substitute by this project, see [`RntParameters::nominal`]. Joints: alpha, beta, rho, roll,
/// pitch, spin. Motors: the three legs, then the three axes of the wrist. The base frame lies in the universal joint
/// of the central leg. The flange origin is the wrist centre. The flange orientation is
/// Rx(alpha)·Ry(beta)·Rz(roll)·Ry(pitch)·Rz(spin). At pitch 0 the tool continues the line of the central leg.
///
/// A pose has two branches, with positive and with negative pitch. With a straight wrist, roll and spin turn about
/// the same line. If the sine of the pitch is below 1e-8, [`Robot::inverse`] keeps the roll of `near`, and returns one
/// branch.
#[derive(Clone, Debug, PartialEq)]
pub struct Rnt {
    parameters: RntParameters,
    pub(super) legs: Legs,
    /// Drive train between the motors, and leg lengths and wrist angles.
    drive_train: DriveTrain<AXES>,
    joint_limits: [Limits; AXES],
}

impl Rnt {
    /// A robot with these parameters. Fails if a parameter is invalid.
    pub fn new(parameters: &RntParameters) -> Result<Self, ParameterError> {
        parameters::positive("base_radius", parameters.base_radius)?;
        parameters::positive("platform_radius", parameters.platform_radius)?;
        parameters::finite("wrist_offset", parameters.wrist_offset)?;
        for (name, range) in [("alpha", parameters.alpha), ("beta", parameters.beta)] {
            parameters::room(name, range)?;
            let tilt = range.high.max(-range.low);
            if tilt > legs::STEEPEST {
                return Err(ParameterError::TooSteep { name, tilt });
            }
        }
        let extension = parameters.extension;
        parameters::room("extension", extension)?;
        parameters::positive("extension", extension.low)?;
        parameters::positive("extension with wrist_offset", extension.low + parameters.wrist_offset)?;
        let [first, second, third] = parameters.legs;
        let axes = [
            first.axis()?,
            second.axis()?,
            third.axis()?,
            parameters::gear("roll", &parameters.roll)?,
            parameters::gear("pitch", &parameters.pitch)?,
            parameters::gear("spin", &parameters.spin)?,
        ];
        let drive_train = DriveTrain::new(axes);
        let mut joint_limits = drive_train.joint_limits;
        joint_limits[..3].copy_from_slice(&[parameters.alpha, parameters.beta, extension]);
        let robot = Self { parameters: *parameters, legs: parameters.geometry(), drive_train, joint_limits };
        robot.closes()?;
        Ok(robot)
    }

    /// Checks that the legs close in the middle of the workspace and at home. Checks also that the legs do not become
    /// singular in the workspace: the determinant of their Jacobian would change its sign there.
    fn closes(&self) -> Result<(), ParameterError> {
        let middle = self.middle();
        for (leg, (length, axis)) in self.legs.lengths(&middle).into_iter().zip(&self.parameters.legs).enumerate() {
            let Limits { low, high } = axis.length_limits;
            if axis.length_limits.exceeded_by(length).is_some() {
                return Err(ParameterError::LegReach { leg: leg as u8, length, low, high });
            }
        }
        let home = self.parameters.legs.map(|leg| leg.length_at_home);
        self.legs.close(&home, &middle).map_err(|(leg, residual)| ParameterError::OpenAtHome { leg, residual })?;
        let [alpha, beta, rho] = [ALPHA, BETA, RHO].map(|axis| {
            let Limits { low, high } = self.joint_limits[axis];
            [low, (low + high) / 2.0, high]
        });
        let hold = |posture: &Posture| self.legs.jacobian(posture).0.determinant();
        let sign = hold(&middle).signum();
        for alpha in alpha {
            for beta in beta {
                for rho in rho {
                    if hold(&[alpha, beta, rho]) * sign <= 0.0 {
                        return Err(ParameterError::NoHold { alpha, beta, rho });
                    }
                }
            }
        }
        Ok(())
    }

    /// Lengths of the three legs at these joints, m. No limit is checked.
    pub fn leg_lengths(&self, joints: &Joints) -> Result<[f64; 3], KinematicsError> {
        let &[alpha, beta, rho, ..] = joints.exactly::<AXES>()?;
        Ok(self.legs.lengths(&[alpha, beta, rho]))
    }

    /// Alpha, beta and rho in the middle of their limits.
    fn middle(&self) -> Posture {
        std::array::from_fn(|axis| {
            let Limits { low, high } = self.joint_limits[axis];
            (low + high) / 2.0
        })
    }

    /// Leg lengths and wrist angles, which the drive train moves. Checks alpha, beta, rho and the legs against their
    /// limits.
    fn driven(&self, joints: &[f64; AXES]) -> Result<[f64; AXES], KinematicsError> {
        let mut driven = *joints;
        for (axis, &joint) in joints.iter().enumerate().take(3) {
            self.joint_limits[axis].check(Space::Joint, axis, joint)?;
        }
        let [alpha, beta, rho, ..] = *joints;
        let lengths = self.legs.lengths(&[alpha, beta, rho]);
        for (leg, (&length, axis)) in lengths.iter().zip(&self.parameters.legs).enumerate() {
            if let Some(limit) = axis.length_limits.exceeded_by(length) {
                return Err(KinematicsError::LegLimit { leg: leg as u8, length, limit });
            }
        }
        driven[..3].copy_from_slice(&lengths);
        Ok(driven)
    }

    fn motors(&self, joints: &[f64; AXES]) -> Result<Motors, KinematicsError> {
        self.drive_train.motors_from_joints(&self.driven(joints)?)
    }

    fn wrist_centre(&self, joints: &[f64; AXES]) -> Vector3<f64> {
        let reach = joints[RHO] + self.parameters.wrist_offset;
        legs::central(joints[0], joints[1]) * (Vector3::z() * reach)
    }
}

impl Robot for Rnt {
    fn joint_limits(&self) -> &[Limits] {
        &self.joint_limits
    }

    fn motor_limits(&self) -> &[Limits] {
        &self.drive_train.motor_limits
    }

    fn home(&self) -> Motors {
        self.drive_train.home()
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        let joints = joints.exactly()?;
        let &[alpha, beta, _, roll, pitch, spin] = joints;
        let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
        let base_from_flange = legs::central(alpha, beta)
            * about(Vector3::z_axis(), roll)
            * about(Vector3::y_axis(), pitch)
            * about(Vector3::z_axis(), spin);
        Ok(arm::pose(self.wrist_centre(joints), base_from_flange.into_inner()))
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        let near = near.exactly::<AXES>()?;
        let (centre, axes) = arm::parts(base_from_flange)?;
        let reach = centre.norm();
        arm::regular(ALPHA, reach, PARALLEL)?;
        let alpha = (-centre.y).atan2(centre.z);
        let beta = (centre.x / reach).asin();
        let rho = reach - self.parameters.wrist_offset;
        let posture = [alpha, beta, rho, 0.0, 0.0, 0.0];
        // Both branches have the same leg lengths, which are checked before the wrist.
        self.driven(&posture)?;
        let wrist = legs::central(alpha, beta).transpose() * axes;
        let lean = Vector2::new(wrist[(0, 2)], wrist[(1, 2)]).norm();
        let straight = lean < INDISTINCT;
        let sides: &[f64] = if straight { &[1.0] } else { &[1.0, -1.0] };
        Search::run(&self.drive_train, near, |search| {
            for side in sides {
                let mut joints = posture;
                let (sin, cos) = match straight {
                    true => near[ROLL].sin_cos(),
                    false => (side * wrist[(1, 2)] / lean, side * wrist[(0, 2)] / lean),
                };
                // For a straight wrist, the pitch is the component of the lean across its axis.
                let lean = if straight { cos * wrist[(0, 2)] + sin * wrist[(1, 2)] } else { side * lean };
                let pitch = lean.atan2(wrist[(2, 2)]);
                // Spin follows from the chosen roll, so that their errors cancel near the singularity.
                let across = |column| cos * wrist[(1, column)] - sin * wrist[(0, column)];
                let spin = across(0).atan2(across(1));
                search.turn(&mut joints, ROLL, [sin.atan2(cos), pitch, spin]);
                search.take(joints, self.motors(&joints).err());
            }
        })
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        self.motors(joints.exactly()?)
    }

    /// Legs that cannot close are [`KinematicsError::Open`]. Newton's method starts in the middle of the workspace and
    /// takes 3 to 5 steps, 20 steps at most.
    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        let mut joints = self.drive_train.joints_from_motors(motors.exactly()?)?;
        let lengths = [joints[0], joints[1], joints[2]];
        let open = |(leg, residual)| KinematicsError::Open { leg, residual };
        let (posture, _) = self.legs.close(&lengths, &self.middle()).map_err(open)?;
        joints[..3].copy_from_slice(&posture);
        Ok(joints)
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let joints = joints.exactly()?;
        let &[alpha, beta, _, roll, pitch, _] = joints;
        let centre = self.wrist_centre(joints);
        let base_from_central = legs::central(alpha, beta);
        let base_from_roll = base_from_central * Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
        let (sin, cos) = pitch.sin_cos();
        let central = base_from_central * Vector3::z();
        let mut jacobian = Jacobian::zeros();
        let turning = [
            (ALPHA, Vector3::x()),
            (BETA, base_from_central * Vector3::y()),
            (ROLL, central),
            (PITCH, base_from_roll * Vector3::y()),
            (SPIN, base_from_roll * Vector3::new(sin, 0.0, cos)),
        ];
        for (column, axis) in turning {
            // The wrist axes meet in the flange origin and do not move it.
            if column < RHO {
                jacobian.fixed_view_mut::<3, 1>(0, column).copy_from(&axis.cross(&centre));
            }
            jacobian.fixed_view_mut::<3, 1>(3, column).copy_from(&axis);
        }
        jacobian.fixed_view_mut::<3, 1>(0, RHO).copy_from(&central);
        Ok(jacobian)
    }

    /// The passive central leg and the wrist. The driven legs are not part of a serial chain.
    fn links(&self) -> Vec<Link> {
        let (x, y, z) = (Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis());
        let link = |name, axis, index, offset| Link {
            axis,
            kind: if index == RHO { LinkKind::Prismatic } else { LinkKind::Revolute },
            ..Link::turning(name, Isometry3::translation(0.0, 0.0, offset), &[(index, 1.0)], &self.joint_limits)
        };
        vec![
            link("alpha", x, ALPHA, 0.0),
            link("beta", y, BETA, 0.0),
            link("rho", z, RHO, 0.0),
            link("roll", z, ROLL, self.parameters.wrist_offset),
            link("pitch", y, PITCH, 0.0),
            link("spin", z, SPIN, 0.0),
        ]
    }
}

impl LegAxis {
    /// Motor position, rad, at a leg length, m. No limit is checked.
    pub fn motor(&self, length: f64) -> f64 {
        self.motor_at_home + TAU / self.lead * (length - self.length_at_home)
    }

    /// The leg as an axis whose joint is its length.
    fn axis(&self) -> Result<TrainAxis, ParameterError> {
        parameters::positive("length_limits of the legs", self.length_limits.low)?;
        if self.lead == 0.0 {
            return Err(ParameterError::NoRatio { name: "legs" });
        }
        let gear = GearAxis {
            ratio: TAU / self.lead,
            joint_at_home: self.length_at_home,
            motor_at_home: self.motor_at_home,
            joint_limits: self.length_limits,
            motor_limits: self.length_limits.map(|length| self.motor(length)),
        };
        parameters::gear("legs", &gear)
    }
}

impl RobotParameters for RntParameters {
    fn axes(&self) -> usize {
        6
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(Rnt::new(self)?))
    }

    // The ranges of alpha, beta and rho stay as they are: no home position of theirs is a parameter.
    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        for (axis, leg) in self.legs.iter_mut().enumerate() {
            let length = room(motors, axis) * leg.lead.abs() / TAU;
            leg.length_limits = leg.length_limits.with_room(leg.length_at_home, length);
        }
        Self {
            roll: self.roll.with_room(room(motors, 3), 0.0),
            pitch: self.pitch.with_room(room(motors, 4), 0.0),
            spin: self.spin.with_room(room(motors, 5), 0.0),
            ..self
        }
    }

    // The platform with its share of the legs, then the wrist. The frames of alpha and beta stand.
    fn masses(&self) -> Vec<Mass> {
        vec![
            Mass::new(0.0, [0.0; 3]),
            Mass::new(0.0, [0.0; 3]),
            Mass::new(30.0, [0.0; 3]),
            Mass::new(5.0, [0.0; 3]),
            Mass::new(4.0, [0.0, 0.0, 0.05]),
            Mass::new(3.0, [0.0, 0.0, 0.175]),
        ]
    }

    // It hangs.
    fn up(&self) -> [f64; 3] {
        [0.0, 0.0, -1.0]
    }

    // Legs at 15 A, wrist at 8 A, 0.105 N·m/A.
    fn motors(&self) -> Vec<MotorRating> {
        let (leg, wrist) = (MotorRating::new(200.0, 1.575), MotorRating::new(200.0, 0.84));
        vec![leg, leg, leg, wrist, wrist, wrist]
    }
}
