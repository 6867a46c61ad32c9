//! Kinematics of any serial arm, from a description of its joints.
//!
//! [`Chain`] has 1 to 8 joints: revolute, continuous or prismatic. Forward kinematics and the Jacobian follow from the
//! frames of the joints. Inverse kinematics is a closed form with all branches where the geometry has one
//! ([`ClosedForm`]), and otherwise a damped Newton's method with a bounded number of starts. The results depend only on
//! the arguments.
//!
//! | file | content |
//! |---|---|
//! | `parameters.rs` | the description and its refusals |
//! | `geometry.rs` | frames, forward kinematics, Jacobian |
//! | `drives.rs` | motors from joints, ranges |
//! | `pose_error.rs` | the error of a posture for a pose |
//! | `numeric.rs` | the solver for any chain |
//! | `forms.rs` | which closed form a chain has |
//! | `screws.rs`, `subproblems.rs` | axes of the chain at zero, and subproblems of one rotation |
//! | `wrist.rs`, `parallel.rs`, `gantry.rs` | the closed forms |
//! | `branches.rs` | branches made exact, checked against the limits, and sorted |

mod branches;
mod drives;
mod forms;
mod gantry;
mod geometry;
mod numbers;
mod numeric;
mod parallel;
mod parameters;
mod pose_error;
mod screws;
mod subproblems;
mod wrist;

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Unit, Vector3};
use servo::MAX_AXES;

use super::{Jacobian, Joints, KinematicsError, Limits, Link, Motors, ParameterError, Pose, Robot, Solutions, arm};
use drives::Drives;
use forms::Form;
use geometry::Geometry;
use numeric::{Cost, Starts};
use pose_error::Target;

pub use forms::ClosedForm;
pub use parameters::{ChainError, ChainJoint, ChainParameters, LinkBody};

/// A serial arm of 1 to 8 axes.
///
/// Order, signs and zeros of the joints are as in the description. The **base** frame is the frame before the first
/// joint.
///
/// An arm with more axes than the pose needs keeps its posture as near to `near` as the pose admits. An arm with fewer
/// than six axes reaches only some poses; [`Robot::inverse`] accepts a posture within 1e-6 m and 1e-6 rad of the pose,
/// and refuses other poses with [`KinematicsError::Missed`]. At a singular pose the axes that the pose leaves open stay
/// near `near`.
///
/// A chain with a [`ClosedForm`] has all branches of a pose. For any other chain, the numerical method returns one
/// solution. The method starts at `near`, and continues with other starts until it succeeds. It ends after at most 72
/// starts of at most 60 steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    geometry: Geometry,
    drives: Drives,
    /// Direction in the flange frame about which the tool may turn.
    free_axis: Option<Vector3<f64>>,
    form: Option<Form>,
    /// Whether the range of a joint allows at least a whole turn.
    turns: [bool; MAX_AXES],
    /// A fixed point of the base, and the greatest distance of the flange from this point, m.
    root: Vector3<f64>,
    reach: f64,
    /// Length that counts as much as one radian in the numerical solver, m.
    length: f64,
    /// Fractional steps from start to start of the numerical solver.
    recurrence: [f64; MAX_AXES],
    links: Vec<Link>,
    link_from_flange: Pose,
}

impl Chain {
    /// The arm with these numbers. Fails if a number is invalid.
    pub fn new(parameters: &ChainParameters) -> Result<Self, ParameterError> {
        let matrix = parameters.check()?;
        let drives = Drives::new(parameters, &matrix);
        let links = parameters.joints.iter().enumerate().map(|(axis, joint)| {
            let mut coupling = [0.0; MAX_AXES];
            coupling[axis] = 1.0;
            let along = parameters::direction(joint.axis).expect("the check refuses an axis without direction");
            Link {
                name: joint.name.clone().into(),
                kind: joint.kind,
                parent_from_link: joint.parent_from_joint,
                axis: Unit::new_unchecked(along),
                coupling,
                limits: drives.joint_limits[axis],
            }
        });
        let links = links.collect();
        let geometry = Geometry::new(parameters);
        let mut reach = geometry.length();
        let mut turns = [false; MAX_AXES];
        for (axis, &Limits { low, high }) in drives.joint_limits[..geometry.axes].iter().enumerate() {
            if geometry.is_prismatic(axis) {
                reach += low.abs().max(high.abs());
            } else {
                turns[axis] = high - low >= TAU;
            }
        }
        let free_axis = parameters.free_axis.and_then(parameters::direction);
        Ok(Self {
            form: if free_axis.is_none() { Form::find(&geometry) } else { None },
            free_axis,
            turns,
            root: geometry.root(),
            reach,
            length: numeric::characteristic_length(reach),
            recurrence: numeric::recurrence(geometry.axes),
            links,
            link_from_flange: parameters.link_from_flange,
            geometry,
            drives,
        })
    }

    /// The closed form of the inverse kinematics, if the geometry has one.
    pub fn closed_form(&self) -> Option<ClosedForm> {
        self.form.as_ref().map(Form::name)
    }

    fn target(&self, base_from_flange: &Isometry3<f64>) -> Result<Target, KinematicsError> {
        let (origin, rotation) = arm::parts(base_from_flange)?;
        Ok(Target { origin, rotation, free_axis: self.free_axis })
    }

    /// The result of the numerical solver alone, with its starts and steps.
    #[cfg(test)]
    pub(super) fn numerical(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &Joints,
    ) -> (Result<Solutions, KinematicsError>, usize, usize) {
        let mut cost = Cost::default();
        let near = near.counted(self.geometry.axes).unwrap();
        let found = self.search(&self.target(base_from_flange).unwrap(), near, Starts::ALL, &mut cost);
        (found, cost.starts, cost.steps)
    }
}

impl Robot for Chain {
    fn joint_limits(&self) -> &[Limits] {
        &self.drives.joint_limits[..self.geometry.axes]
    }

    fn motor_limits(&self) -> &[Limits] {
        &self.drives.motor_limits[..self.geometry.axes]
    }

    fn home(&self) -> Motors {
        Motors::from_padded(&self.drives.motors_at_home, self.geometry.axes)
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        let flange = self.geometry.frames(joints.counted(self.geometry.axes)?).flange();
        if flange.translation.vector.iter().all(|value| value.is_finite()) {
            Ok(flange)
        } else {
            Err(KinematicsError::NotFinite)
        }
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        let near = near.counted(self.geometry.axes)?;
        let target = self.target(base_from_flange)?;
        let mut starts = Starts::ALL;
        if let Some(form) = &self.form {
            if let Some(found) = self.branches(form, &target, near) {
                return found;
            }
            starts = Starts::FEW;
        }
        self.search(&target, near, starts, &mut Cost::default())
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        let axes = self.geometry.axes;
        Ok(Motors::from_padded(&self.drives.motors(joints.counted(axes)?)?, axes))
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        let axes = self.geometry.axes;
        Ok(Joints::from_padded(&self.drives.joints(motors.counted(axes)?)?, axes))
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let jacobian = self.geometry.jacobian(&self.geometry.frames(joints.counted(self.geometry.axes)?));
        if jacobian.iter().all(|value| value.is_finite()) { Ok(jacobian) } else { Err(KinematicsError::NotFinite) }
    }

    fn links(&self) -> Vec<Link> {
        self.links.clone()
    }

    fn link_from_flange(&self) -> Pose {
        self.link_from_flange
    }
}
