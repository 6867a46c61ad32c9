//! The keys of emulated conveyors, of objects on them, and of light gates.

use std::time::Duration;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A belt conveyor with a horizontal surface.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedConveyor {
    /// Centre of the surface, m.
    pub position: [f64; 3],
    /// Length and width of the surface, m.
    pub size: [f64; 2],
    /// Direction of travel at positive speed, horizontal, of any length.
    pub direction: [f64; 3],
    /// Mean speed of the surface, m/s. Below zero, the belt runs against `direction`.
    pub speed: f64,
    /// Greatest deviation of the speed, as a share of `speed`. The deviation is a sine of time.
    #[serde(default)]
    pub drift: f64,
    /// Period of the deviation, s.
    #[serde(default = "period")]
    pub drift_period_s: f64,
    /// Largest ratio of friction force to normal force.
    #[serde(default = "friction")]
    pub friction: f64,
    /// Force per penetration at each corner of an object, N/m.
    #[serde(default = "stiffness")]
    pub stiffness: f64,
    /// Force per velocity of penetration at each corner of an object, N·s/m.
    #[serde(default = "damping")]
    pub damping: f64,
}

/// A box that is placed on a conveyor at a given time, at rest. Only the corners of the box touch the surface: the box
/// tips over the end of the conveyor as soon as its front is beyond the end.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedObject {
    /// Number of the conveyor, from 0, in the order of the file.
    #[serde(default)]
    pub conveyor: usize,
    /// Edges of the box along the direction of travel, across, and upward, m.
    pub size: [f64; 3],
    /// Mass, kg.
    pub mass: f64,
    /// Place of the centre of the box along the direction of travel, m from the centre of the surface.
    pub along: f64,
    /// Place of the centre of the box across the direction of travel, m from the centre of the surface, positive to the
    /// left.
    #[serde(default)]
    pub across: f64,
    /// Time at which the box is placed, s since the emulated devices were switched on.
    #[serde(default)]
    pub at_s: f64,
}

/// A light gate. The terminal of its input is high while an object breaks the beam.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedGate {
    /// Name of the input of an I/O node.
    pub input: String,
    /// Sender, m.
    pub from: [f64; 3],
    /// Receiver, m.
    pub to: [f64; 3],
    /// Response time: delay from the beam to the terminal, µs.
    #[serde(default = "response")]
    pub response_us: u32,
    /// Longest further delay of an edge, µs. The delay of each edge is random, from zero to this value.
    #[serde(default)]
    pub jitter_us: u32,
}

impl EmulatedConveyor {
    /// The frame of the surface: origin in its centre, x along the direction of travel, and z upward.
    pub fn frame(&self) -> Isometry3<f64> {
        let [x, y, _] = self.direction;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), y.atan2(x));
        Isometry3::from_parts(self.position.into(), turn)
    }
}

impl EmulatedGate {
    /// Response time.
    pub fn response(&self) -> Duration {
        Duration::from_micros(self.response_us.into())
    }

    /// Longest further delay of an edge.
    pub fn jitter(&self) -> Duration {
        Duration::from_micros(self.jitter_us.into())
    }
}

fn period() -> f64 {
    10.0
}

fn friction() -> f64 {
    0.8
}

fn stiffness() -> f64 {
    1e5
}

fn damping() -> f64 {
    200.0
}

fn response() -> u32 {
    500
}
