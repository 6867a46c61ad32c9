//! The keys for the weight of a robot.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Model;
use controller::robot::{Mass, Robot, Weight, WeightError};

/// Masses of a robot's links. With this table in the cell file, the torques that hold the links in the commanded pose
/// are fed forward to the motors. Without the table, only the position loops hold the weight. An empty table uses the
/// nominal masses of the model.
///
/// The host must close the position loop of every axis, commanded by torque or current. Pulse width is possible if
/// `feed_forward` gives `weight`. Drives that close the loop hold the weight by themselves.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// The links from base to flange, as written by `mrroc urdf`; the nominal links of the model where absent.
    pub masses: Option<Vec<Mass>>,
    /// The load at the flange beyond the last link, with its centre in the flange's frame.
    pub load: Mass,
    /// The direction against gravity in the robot's base frame, of any length; the direction of the model where
    /// absent.
    pub up: Option<[f64; 3]>,
}

impl Weights {
    /// The weight of `robot`, whose model is `model`.
    pub(super) fn of(&self, model: Model, robot: &dyn Robot) -> Result<Weight, WeightError> {
        let masses = self.masses.as_deref().unwrap_or(model.masses());
        Weight::new(robot, masses, self.load, self.up.unwrap_or(model.up()))
    }
}
