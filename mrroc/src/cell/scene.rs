//! The keys of the emulated surroundings of the robots.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::conveyor::{EmulatedConveyor, EmulatedGate, EmulatedObject};

/// The surroundings of the emulated robots. Real robots ignore this table.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmulatedScene {
    /// The robot that touches the surfaces with the tip of its tool, a sphere at the origin of the tool. The surfaces are
    /// given in the base frame of this robot.
    pub robot: String,
    /// Radius of the tip, m.
    #[serde(default)]
    pub tip_radius: f64,
    /// The planes.
    #[serde(default)]
    pub plane: Vec<EmulatedPlane>,
    /// The conveyors.
    #[serde(default)]
    pub conveyor: Vec<EmulatedConveyor>,
    /// The objects that are placed on conveyors.
    #[serde(default)]
    pub object: Vec<EmulatedObject>,
    /// The light gates.
    #[serde(default)]
    pub gate: Vec<EmulatedGate>,
}

/// A plane with the solid half-space behind it.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmulatedPlane {
    /// Direction out of the solid, of any length; upward where absent.
    #[serde(default = "upward")]
    pub normal: [f64; 3],
    /// Distance of the plane from the origin along the normal, m.
    pub height: f64,
    /// Force per penetration, N/m.
    pub stiffness: f64,
    /// Force per velocity of penetration, N·s/m.
    pub damping: f64,
    /// Largest ratio of friction force to normal force.
    #[serde(default)]
    pub friction: f64,
}

fn upward() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}
