//! Kinematics of the IRp-6.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::room::room;
use super::{
    ArmParameters, GearAxis, Jacobian, Joints, KinematicsError, Limits, Link, Mass, MotorRating, Motors,
    ParameterError, Robot, RobotParameters, Solutions,
    arm::{self, Facing, INDISTINCT, PITCH, Posture, ROLL},
    drive_train::DriveTrain,
    parameters,
    solutions::Search,
};

const AXES: usize = 6;
const HAND: usize = 5;

/// Parameters of one IRp-6.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Irp6Parameters {
    /// The five axes of the arm. The wrist ends at the intersection of the hand axis and the roll axis.
    pub arm: ArmParameters,
    /// Drive of th6, the hand axis N.
    pub hand: GearAxis,
}

impl Irp6Parameters {
    /// The robot on the pedestal with the parameters of its original controller (public code). The base frame lies at
    /// the shoulder. Later versions of that code have the roll's home at 432.25 rad. The pitch ends at 90° here, not
    /// at 92° as in the code: in those two degrees some poses have a second branch.
    pub const fn irp6p() -> Self {
        let mut arm = ArmParameters::nominal();
        arm.pitch.joint_limits.high = std::f64::consts::FRAC_PI_2;
        Self {
            arm,
            hand: GearAxis {
                ratio: 288.8845,
                joint_at_home: 0.0,
                motor_at_home: 791.0,
                joint_limits: Limits::new(-2.88, 2.93),
                motor_limits: Limits::new(-1000.0, 3000.0),
            },
        }
    }

    /// The same robot as calibrated in February 2007 (public code). The home positions belong to the state of the
    /// machine at that time. The two sets of parameters must not be mixed. Limits and gears are the nominal ones.
    /// Home differs slightly from the upright posture: lower arm at -91.0°, upper arm at -0.3° (derived).
    pub const fn irp6p_calibrated() -> Self {
        let mut robot = Self::irp6p();
        let arm = &mut robot.arm;
        arm.lower_arm_length = 0.4596;
        arm.upper_arm_length = 0.6729;
        arm.wrist_length = 0.1903;
        arm.column.joint_at_home = 0.0111;
        arm.column.motor_at_home = -7.7597;
        arm.lower_arm.squared = 0.078_379_438_8;
        arm.lower_arm.cosine = 0.060_059_331_1;
        arm.lower_arm.sine = 0.032_453_098_3;
        arm.lower_arm.length_at_home = 0.211_810_8;
        arm.lower_arm.motor_at_home = -8.7537;
        arm.upper_arm.squared = 0.078_379_438_8;
        arm.upper_arm.cosine = -0.042_863_817_7;
        arm.upper_arm.sine = 0.053_294_476_2;
        arm.upper_arm.length_at_home = 0.187_652_9;
        arm.upper_arm.motor_at_home = -7.5355;
        arm.pitch.motor_at_home = 153.1366;
        arm.roll.joint_at_home = 0.0903;
        arm.roll.motor_at_home = 309.5910;
        robot.hand.joint_at_home = 0.0209;
        robot.hand.motor_at_home = 796.0265;
        robot
    }
}

/// The WUT IRp-6: the arm of [`ArmParameters`] with a hand axis across the roll axis.
///
/// Joints: th1 to th6. th2 to th4 are inclinations to the horizontal, as the drives set them. The flange's z axis
/// is the hand axis N. The flange origin is the intersection of the hand axis and the roll axis.
///
/// A pose has up to eight branches. Within the limits of the real robot one branch remains, apart from whole turns of
/// the roll, so that a pose needs no configuration flags. If the hand axis is normal to the arm's plane (sin th5 =
/// 0, within 1e-8), the pitch and hand axes are parallel. [`Robot::inverse`] then keeps the pitch of `near`. A
/// flange origin on the column axis gives [`KinematicsError::Singular`].
#[derive(Clone, Debug, PartialEq)]
pub struct Irp6 {
    arm: ArmParameters,
    drive_train: DriveTrain<AXES>,
}

impl Irp6 {
    /// A robot with these parameters. Fails if a parameter is invalid.
    pub fn new(parameters: &Irp6Parameters) -> Result<Self, ParameterError> {
        let [column, lower_arm, upper_arm, pitch, roll] = parameters.arm.axes()?;
        let hand = parameters::gear("hand", &parameters.hand)?;
        let axes = [column, lower_arm, upper_arm, pitch, roll, hand];
        Ok(Self { arm: parameters.arm, drive_train: DriveTrain::new(axes) })
    }
}

impl Robot for Irp6 {
    fn joint_limits(&self) -> &[Limits] {
        &self.drive_train.joint_limits
    }

    fn motor_limits(&self) -> &[Limits] {
        &self.drive_train.motor_limits
    }

    fn home(&self) -> Motors {
        self.drive_train.home()
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        let &[th1, th2, th3, th4, th5, th6] = joints.exactly()?;
        let posture = Posture::new(th1, th2, th3, th4);
        let ((s5, c5), (s6, c6)) = (th5.sin_cos(), th6.sin_cos());
        let wrist = posture.wrist();
        let (ahead, across, along) = (wrist.column(0), wrist.column(1), wrist.column(2));
        let rolled = ahead * c5 + across * s5;
        let axes = [rolled * c6 + along * s6, along * c6 - rolled * s6, ahead * s5 - across * c5];
        Ok(arm::pose(self.arm.origin(&posture), Matrix3::from_columns(&axes)))
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        let near = near.exactly::<AXES>()?;
        let (origin, axes) = arm::parts(base_from_flange)?;
        let (normal, orientation, approach) = (axes.column(0), axes.column(1), axes.column(2));
        let radius = arm::radius(&origin)?;
        Search::run(&self.drive_train, near, |search| {
            for facing in [1.0, -1.0] {
                let (s1, c1) = (facing * origin.y / radius, facing * origin.x / radius);
                // The approach axis, projected on the arm's plane, is parallel to the wrist's x axis.
                let level = c1 * approach.x + s1 * approach.y;
                let in_plane = (level * level + approach.z * approach.z).sqrt();
                let pitches = if in_plane < INDISTINCT {
                    [Some(near[PITCH].sin_cos()), None]
                } else {
                    let (s4, c4) = (level / in_plane, approach.z / in_plane);
                    [Some((s4, c4)), Some((-s4, -c4))]
                };
                for pitch in pitches.into_iter().flatten() {
                    let at = Facing { th1: (s1, c1), pitch, reach: facing * radius, height: origin.z };
                    // Roll and hand follow from the chosen pitch. The three angles therefore belong to one branch,
                    // and near the singularity their errors cancel.
                    self.arm.branches(search, &at, |search, joints, wrist| {
                        let (ahead, across, along) = (wrist.column(0), wrist.column(1), wrist.column(2));
                        let roll = approach.dot(&ahead).atan2(-approach.dot(&across));
                        let hand = normal.dot(&along).atan2(orientation.dot(&along));
                        search.turn(joints, ROLL, [roll, hand]);
                    });
                }
            }
        })
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        self.drive_train.motors_from_joints(joints.exactly()?)
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        self.drive_train.joints_from_motors(motors.exactly()?)
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let &[th1, th2, th3, th4, th5, _] = joints.exactly()?;
        let posture = Posture::new(th1, th2, th3, th4);
        let mut jacobian = self.arm.jacobian(&posture);
        let (wrist, (s5, c5)) = (posture.wrist(), th5.sin_cos());
        let approach = wrist.column(0) * s5 - wrist.column(1) * c5;
        jacobian.fixed_view_mut::<3, 1>(3, HAND).copy_from(&approach);
        Ok(jacobian)
    }

    fn links(&self) -> Vec<Link> {
        let limits = self.joint_limits();
        let mut links = self.arm.links(limits);
        let across = Isometry3::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2);
        links.push(Link::turning("hand", across, &[(HAND, 1.0)], limits));
        links
    }

    fn lower_arm(&self) -> Option<usize> {
        Some(arm::SHOULDER)
    }
}

impl Mass {
    /// Nominal masses of the links of [`Irp6`](Irp6) with its gripper along the hand axis.
    pub const IRP6: [Self; 6] = [
        Self::new(45.0, [0.0; 3]),
        Self::new(12.0, [0.20, 0.0, 0.0]),
        Self::new(14.0, [0.25, 0.0, 0.0]),
        Self::new(4.0, [0.095, 0.0, 0.0]),
        Self::new(0.0, [0.0; 3]),
        Self::new(1.35, [0.0, 0.0, 0.15]),
    ];
}

impl RobotParameters for Irp6Parameters {
    fn axes(&self) -> usize {
        6
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(Irp6::new(self)?))
    }

    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self { arm: self.arm.with_room_at_home(motors), hand: self.hand.with_room(room(motors, 5), 0.0) }
    }

    fn masses(&self) -> Vec<Mass> {
        Mass::IRP6.to_vec()
    }

    fn motors(&self) -> Vec<MotorRating> {
        MotorRating::IRP6.to_vec()
    }
}
