//! The keys of emulated workpieces and of the tools that cut them.

use hil::scene::{Material, WorkpieceConfig};
use serde::{Deserialize, Serialize};

use super::Place;

/// A plate at rest that cutting tools carve.
///
/// The workpiece is a height field: each cell of the upper face has one height. Defaults are those of fibreboard.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedWorkpiece {
    /// Name of the workpiece.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Place of the centre of the upper face.
    pub place: Place,
    /// Lengths along x and y of the place, and thickness, m. The lengths are rounded to whole cells.
    pub size: [f64; 3],
    /// Width of a cell of the height field, m.
    #[serde(default = "cell_width")]
    pub cell_width: f64,
    /// Cutting force per area of the cut (width times depth), N/m².
    #[serde(default = "specific_force")]
    pub specific_force: f64,
    /// Cutting force per width of the cut, N/m.
    #[serde(default = "edge_force")]
    pub edge_force: f64,
    /// Force per penetration of a tool whose spindle stands, N/m.
    #[serde(default = "stiffness")]
    pub stiffness: f64,
    /// Force per velocity of that penetration, N·s/m.
    #[serde(default = "damping")]
    pub damping: f64,
    /// Largest ratio of friction force to normal force under a tool whose spindle stands.
    #[serde(default = "friction")]
    pub friction: f64,
}

/// A cutting tool: a cylinder whose flat end is at the origin of the robot's tool, and whose axis is the z axis of the tool.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedCutter {
    /// The robot.
    pub robot: String,
    /// Diameter, m.
    pub diameter: f64,
    /// The digital output that makes the spindle turn. Without this key, the spindle always turns.
    pub spindle: Option<String>,
}

impl EmulatedWorkpiece {
    /// The workpiece of the emulation.
    pub fn config(&self) -> WorkpieceConfig {
        let &Self { size, cell_width, specific_force, edge_force, stiffness, damping, friction, .. } = self;
        let material = Material { stiffness, damping, friction };
        WorkpieceConfig { pose: self.place.pose(), size, cell: cell_width, specific_force, edge_force, material }
    }
}

fn cell_width() -> f64 {
    1e-4
}

fn specific_force() -> f64 {
    WorkpieceConfig::FIBREBOARD_SPECIFIC_FORCE
}

fn edge_force() -> f64 {
    WorkpieceConfig::FIBREBOARD_EDGE_FORCE
}

fn stiffness() -> f64 {
    Material::NOMINAL.stiffness
}

fn damping() -> f64 {
    Material::NOMINAL.damping
}

fn friction() -> f64 {
    Material::NOMINAL.friction
}
