//! The list of robots that a cell can name: their models, their numbers and their emulation.
//!
//! A robot of this project keeps [`RobotParameters`] in a file of its own in `controller`. CONTRIBUTING.md has the recipe.
//! A robot of another crate implements [`OwnRobot`], and the program registers it: [`Extension`](crate::Extension).

mod chain;
mod examination;
mod names;
mod own;

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use controller::robot::{
    ChainParameters, ConveyorParameters, GripperParameters, Irb6Parameters, Irp6Parameters, Irp6TrackParameters,
    PolycrankParameters, RntParameters,
};
pub use controller::robot::{
    Jacobian, Joints, KinematicsError, Limits, Link, LinkKind, Mass, MotorRating, Motors, ParameterError, Pose, Robot,
    RobotParameters, Singularity, Solutions, Space,
};
use hil::plant::Switch;
use hil::{AxisConfig, Irp6Axis, MechanismConfig};

use crate::cell::Plant;
pub use examination::examine;
use own::OwnModel;
pub(crate) use own::check as check_own;
pub use own::{EmulatedJoint, EmulatedLink, Keys, OwnParameters, OwnRobot, register};

/// Evaluates an expression on the numbers of a robot, whichever robot: `each_robot!(parameters, it => it.masses())`.
#[macro_export]
macro_rules! each_robot {
    ($parameters:expr, $it:ident => $value:expr) => {
        match $parameters {
            $crate::cell::Parameters::Irb6($it) => $value,
            $crate::cell::Parameters::Irp6($it) => $value,
            $crate::cell::Parameters::Irp6Track($it) => $value,
            $crate::cell::Parameters::Rnt($it) => $value,
            $crate::cell::Parameters::Polycrank($it) => $value,
            $crate::cell::Parameters::Gripper($it) => $value,
            $crate::cell::Parameters::Conveyor($it) => $value,
            $crate::cell::Parameters::Chain($it) => $value,
            $crate::cell::Parameters::Own($it) => $value,
        }
    };
}

/// The models with known parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename_all = "kebab-case"))]
pub enum Model {
    /// ASEA IRb-6, five axes.
    Irb6,
    /// WUT IRp-6 on its pedestal, six axes.
    Irp6,
    /// WUT IRp-6 on its pedestal, as calibrated in February 2007.
    Irp6Calibrated,
    /// WUT IRp-6 on its track, seven axes.
    Irp6Track,
    /// WUT IRp-6 on its track, as calibrated in February 2007.
    Irp6TrackCalibrated,
    /// WUT RNT, three legs and a wrist. All parameters are nominal, not measured.
    Rnt,
    /// WUT Polycrank, seven axes without end. The geometry is that of the robot; the drives are nominal.
    Polycrank,
    /// Two-finger gripper of the WUT robots, one axis: opening of the jaws, m.
    Gripper,
    /// Conveyor of the WUT laboratory, one axis without end: position of the belt, m.
    Conveyor,
    /// An [`OwnRobot`] that the program has registered.
    #[cfg_attr(feature = "schema", schemars(skip))]
    Own(OwnModel),
}

/// The parameters of one robot.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename_all = "kebab-case"))]
pub enum Parameters {
    /// For `model = "irb6"`.
    Irb6(Irb6Parameters),
    /// For `model = "irp6"`.
    Irp6(Irp6Parameters),
    /// For `model = "irp6-track"`.
    Irp6Track(Irp6TrackParameters),
    /// For `model = "rnt"`.
    Rnt(RntParameters),
    /// For `model = "polycrank"`.
    Polycrank(PolycrankParameters),
    /// For `model = "gripper"`.
    Gripper(GripperParameters),
    /// For `model = "conveyor"`.
    Conveyor(ConveyorParameters),
    /// For the key `chain`, which states these parameters.
    #[cfg_attr(feature = "schema", schemars(skip))]
    Chain(ChainParameters),
    /// For the model of an [`OwnRobot`] that the program has registered.
    #[cfg_attr(feature = "schema", schemars(skip))]
    Own(OwnParameters),
}

impl Parameters {
    /// The key of the parameters in cell files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Irb6(_) => "irb6",
            Self::Irp6(_) => "irp6",
            Self::Irp6Track(_) => "irp6-track",
            Self::Rnt(_) => "rnt",
            Self::Polycrank(_) => "polycrank",
            Self::Gripper(_) => "gripper",
            Self::Conveyor(_) => "conveyor",
            Self::Chain(_) => "chain",
            Self::Own(given) => given.model(),
        }
    }

    /// The robot of these numbers, or what is wrong with them.
    pub fn kinematics(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        each_robot!(self, it => it.robot())
    }

    /// The same numbers with room at home: [`RobotParameters::with_room_at_home`].
    #[must_use]
    pub fn with_room_at_home(self, motors: &[f64]) -> Self {
        match self {
            Self::Irb6(it) => Self::Irb6(it.with_room_at_home(motors)),
            Self::Irp6(it) => Self::Irp6(it.with_room_at_home(motors)),
            Self::Irp6Track(it) => Self::Irp6Track(it.with_room_at_home(motors)),
            Self::Rnt(it) => Self::Rnt(it.with_room_at_home(motors)),
            Self::Polycrank(it) => Self::Polycrank(it.with_room_at_home(motors)),
            Self::Gripper(it) => Self::Gripper(it.with_room_at_home(motors)),
            Self::Conveyor(it) => Self::Conveyor(it.with_room_at_home(motors)),
            Self::Chain(it) => Self::Chain(it.with_room_at_home(motors)),
            Self::Own(it) => Self::Own(it.with_room_at_home(motors)),
        }
    }

    /// Nominal masses of its links.
    pub fn masses(&self) -> Vec<Mass> {
        each_robot!(self, it => it.masses())
    }

    /// The direction against gravity in its base frame.
    pub fn up(&self) -> [f64; 3] {
        each_robot!(self, it => it.up())
    }

    /// The rotation from the base to axes whose z points upward.
    pub(crate) fn upright_from_base(&self) -> UnitQuaternion<f64> {
        let turned = UnitQuaternion::rotation_between(&self.up().into(), &Vector3::z());
        turned.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI))
    }

    /// Whether joint `axis` is linear: its position is in m.
    pub fn is_linear(&self, axis: usize) -> bool {
        match self {
            Self::Gripper(_) | Self::Conveyor(_) => true,
            Self::Irp6Track(_) => axis == 0,
            // The extension of the central leg.
            Self::Rnt(_) => axis == 2,
            Self::Irb6(_) | Self::Irp6(_) | Self::Polycrank(_) => false,
            Self::Chain(given) => given.joints.get(axis).is_some_and(|joint| joint.kind == LinkKind::Prismatic),
            Self::Own(given) => given.is_linear(axis),
        }
    }

    /// How many axes the robot has.
    pub fn axes(&self) -> usize {
        each_robot!(self, it => it.axes())
    }

    /// Plants that its axes can have.
    pub fn plants(&self) -> &'static [Plant] {
        match self {
            Self::Irb6(_) | Self::Irp6(_) => &[Plant::Physical, Plant::Wut],
            Self::Irp6Track(_)
            | Self::Rnt(_)
            | Self::Polycrank(_)
            | Self::Gripper(_)
            | Self::Conveyor(_)
            | Self::Chain(_)
            | Self::Own(_) => &[Plant::Physical],
        }
    }

    /// Coupled dynamics of its motors; `None` where each axis moves a load of its own.
    pub fn mechanism(&self) -> Option<MechanismConfig> {
        Some(match self {
            Self::Irb6(_) => MechanismConfig::Irb6,
            Self::Irp6(_) => MechanismConfig::Irp6,
            Self::Irp6Track(_) => MechanismConfig::Irp6OnTrack,
            Self::Rnt(given) => MechanismConfig::Rnt { home_lengths: given.legs.map(|leg| leg.length_at_home) },
            Self::Polycrank(given) => MechanismConfig::Polycrank {
                coupled: given.coupled,
                at_home: given.axes.map(|axis| axis.joint_at_home),
            },
            Self::Chain(given) => return chain::mechanism(given).expect("a parsed chain has sound bodies"),
            Self::Own(given) => return given.mechanism().expect("a parsed robot has sound links"),
            Self::Gripper(_) | Self::Conveyor(_) => return None,
        })
    }

    /// Refuses numbers that the emulated mechanism or its motors cannot have.
    pub(crate) fn check_mechanism(&self) -> Result<(), String> {
        match self {
            Self::Chain(given) => chain::mechanism(given).map(drop).map_err(|error| error.to_string()),
            Self::Own(given) => given.check(),
            _ => Ok(()),
        }
    }

    /// Frames of the emulated mechanism in those of the robot: the mechanism's base in the base, and the mechanism's flange
    /// in the flange.
    pub fn mechanism_frames(&self) -> (Pose, Pose) {
        let along_z = |length| Pose::translation(0.0, 0.0, length);
        match self {
            // The mechanism has its base at the shoulder.
            Self::Irb6(given) => (along_z(given.arm.shoulder_height), Pose::identity()),
            Self::Irp6(given) => (along_z(given.arm.shoulder_height), Pose::identity()),
            Self::Irp6Track(given) => (along_z(given.robot.arm.shoulder_height), Pose::identity()),
            // The mechanism has its flange beyond the centre of the wrist.
            Self::Rnt(_) => (Pose::identity(), along_z(0.1)),
            Self::Polycrank(_) | Self::Gripper(_) | Self::Conveyor(_) | Self::Chain(_) | Self::Own(_) => {
                (Pose::identity(), Pose::identity())
            }
        }
    }

    /// Motor, load, sensors and switches of axis `number`, whose home position is `home`, rad.
    pub fn plant(&self, plant: Plant, number: usize, home: f64) -> AxisConfig {
        let preset = match self {
            Self::Irb6(_) | Self::Irp6(_) => return on_pedestal(plant, number, home),
            Self::Irp6Track(_) => AxisConfig::irp6_track(number).expect(AS_MANY),
            Self::Rnt(_) => AxisConfig::rnt(number).expect(AS_MANY),
            Self::Polycrank(_) => AxisConfig::polycrank(number).expect(AS_MANY),
            Self::Gripper(_) => AxisConfig::gripper(),
            Self::Conveyor(_) => AxisConfig::conveyor(),
            Self::Chain(given) => chain::plant(given, number),
            Self::Own(given) => given.plant(number).expect("the numbers of a parsed robot are sound"),
        };
        preset.with_home(home)
    }
}

impl Model {
    /// All built-in models.
    pub const ALL: [Self; 9] = [
        Self::Irb6,
        Self::Irp6,
        Self::Irp6Calibrated,
        Self::Irp6Track,
        Self::Irp6TrackCalibrated,
        Self::Rnt,
        Self::Polycrank,
        Self::Gripper,
        Self::Conveyor,
    ];

    /// All models: the built-in models, then the models that the program has registered.
    pub fn all() -> Vec<Self> {
        Self::ALL.into_iter().chain(OwnModel::all().into_iter().map(Self::Own)).collect()
    }

    /// The model of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|model| model.name() == name)
    }

    /// The name in cell files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Irb6 => "irb6",
            Self::Irp6 => "irp6",
            Self::Irp6Calibrated => "irp6-calibrated",
            Self::Irp6Track => "irp6-track",
            Self::Irp6TrackCalibrated => "irp6-track-calibrated",
            Self::Rnt => "rnt",
            Self::Polycrank => "polycrank",
            Self::Gripper => "gripper",
            Self::Conveyor => "conveyor",
            Self::Own(own) => own.name(),
        }
    }

    /// The parameters of the model.
    pub fn parameters(self) -> Parameters {
        match self {
            Self::Irb6 => Parameters::Irb6(Irb6Parameters::irb6()),
            Self::Irp6 => Parameters::Irp6(Irp6Parameters::irp6p()),
            Self::Irp6Calibrated => Parameters::Irp6(Irp6Parameters::irp6p_calibrated()),
            Self::Irp6Track => Parameters::Irp6Track(Irp6TrackParameters::irp6ot()),
            Self::Irp6TrackCalibrated => Parameters::Irp6Track(Irp6TrackParameters::irp6ot_calibrated()),
            Self::Rnt => Parameters::Rnt(RntParameters::nominal()),
            Self::Polycrank => Parameters::Polycrank(PolycrankParameters::polycrank()),
            Self::Gripper => Parameters::Gripper(GripperParameters::two_finger()),
            Self::Conveyor => Parameters::Conveyor(ConveyorParameters::belt()),
            Self::Own(own) => Parameters::Own(own.parameters()),
        }
    }
}

const AS_MANY: &str = "a parsed robot has as many axes as its model";

/// An axis of the IRb-6, or of the IRp-6 on its pedestal.
fn on_pedestal(plant: Plant, number: usize, home: f64) -> AxisConfig {
    let axis = Irp6Axis::ALL[number];
    let preset = match plant {
        Plant::Physical => AxisConfig::irp6(axis),
        Plant::Wut => AxisConfig::wut(axis),
    };
    AxisConfig {
        index_angle: home,
        start_angle: home + 20.0,
        home_switch: Some(Switch { from: home - 20.0, to: home - 2.0, bounce: 0 }),
        ..preset
    }
}

#[cfg(test)]
mod tests {
    //! Ratings of the motors.

    use hil::plant::PlantConfig;

    use super::*;

    #[test]
    fn the_motors_of_a_model_have_the_torques_of_its_emulated_motors() {
        for model in Model::ALL {
            let parameters = model.parameters();
            let ratings = each_robot!(&parameters, it => it.motors());
            if matches!(model, Model::Gripper | Model::Conveyor) {
                assert!(ratings.is_empty(), "{model:?} has no links");
                continue;
            }
            assert_eq!(ratings.len(), parameters.axes(), "{model:?}");
            for (number, rating) in ratings.iter().enumerate() {
                let emulated = parameters.plant(Plant::Physical, number, 0.0);
                let PlantConfig::Physical(motor) = emulated.plant else { panic!("a physical plant") };
                let torque = motor.torque_constant * emulated.amplifier.max_current;
                assert!((rating.torque - torque).abs() < 1e-12, "{model:?} {number}: {torque}");
            }
        }
    }
}
