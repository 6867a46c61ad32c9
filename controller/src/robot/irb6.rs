//! Kinematics of the IRb-6.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3};
use serde::{Deserialize, Serialize};

use super::{
    ArmParameters, Jacobian, Joints, KinematicsError, Limits, Link, Mass, MotorRating, Motors, ParameterError, Robot,
    RobotParameters, Solutions,
    arm::{self, Facing, Posture, ROLL},
    drive_train::DriveTrain,
    parameters,
    solutions::Search,
};

const AXES: usize = 5;

/// Parameters of one IRb-6.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Irb6Parameters {
    /// The five axes. The wrist ends at the tool flange, whose z axis is the roll axis.
    pub arm: ArmParameters,
    /// Tolerance of the tool axis: the sine of the angle by which the axis may lean out of the arm's plane. The
    /// solution deviates from the requested pose by the same angle.
    pub tool_plane_tolerance: f64,
}

impl Irb6Parameters {
    /// The 5-axis set of the WUT robot on the pedestal, base frame on the floor under the column.
    ///
    /// From public code: the whole arm, with shoulder 0.7 m, flange 0.095 m and roll home 314.665 rad of the 5-axis
    /// model. The robot's maker gives 0.450, 0.670 and 0.200 m for its own arm and flange. Set the maker's values for
    /// a robot as delivered. Nominal: the tolerance.
    pub const fn irb6() -> Self {
        let mut arm = ArmParameters::nominal();
        arm.shoulder_height = 0.7;
        arm.wrist_length = 0.095;
        arm.roll.motor_at_home = 314.665;
        Self { arm, tool_plane_tolerance: 1e-6 }
    }
}

/// The ASEA IRb-6: the five axes of [`ArmParameters`], the tool on the roll axis.
///
/// Joints: th1 th2 th3 th4 th5. The first four are absolute angles, as the drives set them. The flange's z axis is
/// the roll axis. With th1 = th5 = 0 and a level wrist the flange's x axis points up.
///
/// Five axes reach only poses whose z axis lies in the vertical plane through the column axis and the flange. Other
/// poses are refused with [`KinematicsError::ToolPlane`]. A tool beside the roll axis turns with the flange like any
/// other tool. The caller must choose the poses of such a tool so that the flange stays in the plane. With the flange
/// origin on the column axis, th1 is [`KinematicsError::Singular`]. The arm has no other singularity within its
/// limits.
#[derive(Clone, Debug, PartialEq)]
pub struct Irb6 {
    parameters: Irb6Parameters,
    drive_train: DriveTrain<AXES>,
}

impl Irb6 {
    /// A robot with these parameters. Fails if a parameter is invalid.
    pub fn new(parameters: &Irb6Parameters) -> Result<Self, ParameterError> {
        let drive_train = DriveTrain::new(parameters.arm.axes()?);
        parameters::positive("tool_plane_tolerance", parameters.tool_plane_tolerance)?;
        Ok(Self { parameters: *parameters, drive_train })
    }
}

impl Robot for Irb6 {
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
        let &[th1, th2, th3, th4, th5] = joints.exactly()?;
        let posture = Posture::new(th1, th2, th3, th4);
        let (s5, c5) = th5.sin_cos();
        let wrist = posture.wrist();
        let (ahead, across, along) = (wrist.column(0), wrist.column(1), wrist.column(2));
        let axes = [ahead * c5 + across * s5, across * c5 - ahead * s5, along.into_owned()];
        Ok(arm::pose(self.parameters.arm.origin(&posture), Matrix3::from_columns(&axes)))
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        let near = near.exactly::<AXES>()?;
        let (origin, axes) = arm::parts(base_from_flange)?;
        let (normal, approach) = (axes.column(0), axes.column(2));
        let radius = arm::radius(&origin)?;
        let residual = (origin.x * approach.y - origin.y * approach.x) / radius;
        if residual.abs() > self.parameters.tool_plane_tolerance {
            return Err(KinematicsError::ToolPlane { residual });
        }
        Search::run(&self.drive_train, near, |search| {
            for facing in [1.0, -1.0] {
                let (s1, c1) = (facing * origin.y / radius, facing * origin.x / radius);
                let level = c1 * approach.x + s1 * approach.y;
                let in_plane = (level * level + approach.z * approach.z).sqrt();
                let pitch = (-approach.z / in_plane, level / in_plane);
                let at = Facing { th1: (s1, c1), pitch, reach: facing * radius, height: origin.z };
                let arm = &self.parameters.arm;
                arm.branches(search, &at, |search, joints, wrist| {
                    let roll = normal.dot(&wrist.column(1)).atan2(normal.dot(&wrist.column(0)));
                    search.turn(joints, ROLL, [roll]);
                });
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
        let &[th1, th2, th3, th4, _] = joints.exactly()?;
        Ok(self.parameters.arm.jacobian(&Posture::new(th1, th2, th3, th4)))
    }

    fn links(&self) -> Vec<Link> {
        self.parameters.arm.links(self.joint_limits())
    }

    fn lower_arm(&self) -> Option<usize> {
        Some(arm::SHOULDER)
    }
}

impl RobotParameters for Irb6Parameters {
    fn axes(&self) -> usize {
        5
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(Irb6::new(self)?))
    }

    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self { arm: self.arm.with_room_at_home(motors), ..self }
    }

    // With a gripper along the roll axis.
    fn masses(&self) -> Vec<Mass> {
        vec![
            Mass::new(45.0, [0.0; 3]),
            Mass::new(12.0, [0.20, 0.0, 0.0]),
            Mass::new(14.0, [0.25, 0.0, 0.0]),
            Mass::new(4.0, [0.0475, 0.0, 0.0]),
            Mass::new(1.35, [0.0, 0.0, 0.15]),
        ]
    }

    fn motors(&self) -> Vec<MotorRating> {
        MotorRating::IRP6[..AXES].to_vec()
    }
}
