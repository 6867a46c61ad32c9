//! The keys of the emulated surroundings of the robots.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::touch::EmulatedTouchProbe;

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
    /// The blocks.
    #[serde(default)]
    pub block: Vec<EmulatedBlock>,
    /// The touch probes.
    #[serde(default)]
    pub touch_probe: Vec<EmulatedTouchProbe>,
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

/// A box that stands still, with its edges along the axes of the frame.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmulatedBlock {
    /// Centre of the box, m.
    pub centre: [f64; 3],
    /// Lengths of the edges, m.
    pub size: [f64; 3],
    /// Force per penetration, N/m.
    pub stiffness: f64,
    /// Force per velocity of penetration, N·s/m.
    #[serde(default)]
    pub damping: f64,
    /// Largest ratio of friction force to normal force.
    #[serde(default)]
    pub friction: f64,
}

fn upward() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}
