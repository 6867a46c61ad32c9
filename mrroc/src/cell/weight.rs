//! The keys of what a robot weighs.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Model;
use controller::robot::{Mass, Robot, Weight, WeightError};

/// What a robot's links weigh. With this table in the cell file, the torques that hold them in the pose commanded are
/// fed forward to its motors; without it they are left to the loops. An empty one takes the model's nominal masses.
///
/// Every axis has its loop closed by the host, and is commanded by torque or current; or by pulse width, with the
/// `weight` of its `feed_forward` given. Drives that close the loop hold the weight by themselves.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// The links from base to flange as `mrroc urdf` writes them; the model's nominal ones where absent.
    pub masses: Option<Vec<Mass>>,
    /// What the flange carries beyond the last link, its centre in the flange's frame.
    pub load: Mass,
    /// Against gravity, in the robot's base frame, of any length; the model's own where absent.
    pub up: Option<[f64; 3]>,
}

impl Weights {
    /// Of `robot`, which is a `model`.
    pub(super) fn of(&self, model: Model, robot: &dyn Robot) -> Result<Weight, WeightError> {
        let masses = self.masses.as_deref().unwrap_or(model.masses());
        Weight::new(robot, masses, self.load, self.up.unwrap_or(model.up()))
    }
}
