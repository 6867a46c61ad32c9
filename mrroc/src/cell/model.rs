//! The robot models that a cell can name, and their parameters.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use controller::robot::{
    Conveyor, ConveyorParameters, Gripper, GripperParameters, Irb6, Irb6Parameters, Irp6,
    Irp6Parameters, Irp6Track, Irp6TrackParameters, ParameterError, Polycrank, PolycrankParameters,
    Rnt, RntParameters, Room,
};

/// The models with known parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
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
}

/// The parameters of one robot.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
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
}

impl Parameters {
    /// The key of the parameters in cell files.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Irb6(_) => "irb6",
            Self::Irp6(_) => "irp6",
            Self::Irp6Track(_) => "irp6-track",
            Self::Rnt(_) => "rnt",
            Self::Polycrank(_) => "polycrank",
            Self::Gripper(_) => "gripper",
            Self::Conveyor(_) => "conveyor",
        }
    }

    /// The kinematics of a robot with these parameters, or the error in them.
    pub fn kinematics(&self) -> Result<Arc<dyn controller::robot::Robot>, ParameterError> {
        Ok(match self {
            Self::Irb6(parameters) => Arc::new(Irb6::new(parameters)?),
            Self::Irp6(parameters) => Arc::new(Irp6::new(parameters)?),
            Self::Irp6Track(parameters) => Arc::new(Irp6Track::new(parameters)?),
            Self::Rnt(parameters) => Arc::new(Rnt::new(parameters)?),
            Self::Polycrank(parameters) => Arc::new(Polycrank::new(parameters)?),
            Self::Gripper(parameters) => Arc::new(Gripper::new(parameters)?),
            Self::Conveyor(parameters) => Arc::new(Conveyor::new(parameters)?),
        })
    }
}

impl Room for Parameters {
    fn with_room_at_home(self, motors: &[f64]) -> Self {
        match self {
            Self::Irb6(it) => Self::Irb6(it.with_room_at_home(motors)),
            Self::Irp6(it) => Self::Irp6(it.with_room_at_home(motors)),
            Self::Irp6Track(it) => Self::Irp6Track(it.with_room_at_home(motors)),
            Self::Rnt(it) => Self::Rnt(it.with_room_at_home(motors)),
            Self::Polycrank(it) => Self::Polycrank(it.with_room_at_home(motors)),
            Self::Gripper(it) => Self::Gripper(it.with_room_at_home(motors)),
            Self::Conveyor(it) => Self::Conveyor(it.with_room_at_home(motors)),
        }
    }
}

impl Model {
    /// All models.
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
        }
    }

    /// The parameters of the model.
    pub const fn parameters(self) -> Parameters {
        match self {
            Self::Irb6 => Parameters::Irb6(Irb6Parameters::irb6()),
            Self::Irp6 => Parameters::Irp6(Irp6Parameters::irp6p()),
            Self::Irp6Calibrated => Parameters::Irp6(Irp6Parameters::irp6p_calibrated()),
            Self::Irp6Track => Parameters::Irp6Track(Irp6TrackParameters::irp6ot()),
            Self::Irp6TrackCalibrated => {
                Parameters::Irp6Track(Irp6TrackParameters::irp6ot_calibrated())
            }
            Self::Rnt => Parameters::Rnt(RntParameters::nominal()),
            Self::Polycrank => Parameters::Polycrank(PolycrankParameters::polycrank()),
            Self::Gripper => Parameters::Gripper(GripperParameters::two_finger()),
            Self::Conveyor => Parameters::Conveyor(ConveyorParameters::belt()),
        }
    }

    /// Whether the model is an arm on a pedestal.
    pub const fn is_on_pedestal(self) -> bool {
        matches!(self, Self::Irb6 | Self::Irp6 | Self::Irp6Calibrated)
    }

    /// Whether it carries a tool; a gripper and a conveyor are devices of one axis.
    pub const fn has_tool(self) -> bool {
        !matches!(self, Self::Gripper | Self::Conveyor)
    }

    /// How many axes it has.
    pub const fn axes(self) -> usize {
        match self {
            Self::Irb6 => 5,
            Self::Irp6 | Self::Irp6Calibrated | Self::Rnt => 6,
            Self::Irp6Track | Self::Irp6TrackCalibrated | Self::Polycrank => 7,
            Self::Gripper | Self::Conveyor => 1,
        }
    }
}
