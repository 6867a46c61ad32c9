//! The keys of the emulated surroundings of the robots.

use hil::scene::GripConfig;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::conveyor::{EmulatedConveyor, EmulatedGate, EmulatedObject};
use super::touch::EmulatedTouchProbe;
use super::{EmulatedCutter, EmulatedWorkpiece};

/// The surroundings of the emulated robots. Real robots ignore this table.
///
/// All places are in the frame of the cell, whose z axis points upward. A robot without `base` has its base at the origin
/// of this frame.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedScene {
    /// A robot that touches surfaces with the tip of its tool, a sphere at the origin of the tool.
    pub robot: Option<String>,
    /// Radius of the tip of `robot`, m.
    #[serde(default)]
    pub tip_radius: f64,
    /// Tips of the tools of further robots.
    #[serde(default)]
    pub tip: Vec<EmulatedTip>,
    /// The planes.
    #[serde(default)]
    pub plane: Vec<EmulatedPlane>,
    /// The blocks.
    #[serde(default)]
    pub block: Vec<EmulatedBlock>,
    /// The bars, which move freely.
    #[serde(default)]
    pub bar: Vec<EmulatedBar>,
    /// The grippers.
    #[serde(default)]
    pub gripper: Vec<EmulatedGripper>,
    /// The conveyors.
    #[serde(default)]
    pub conveyor: Vec<EmulatedConveyor>,
    /// The objects that are placed on conveyors.
    #[serde(default)]
    pub object: Vec<EmulatedObject>,
    /// The light gates.
    #[serde(default)]
    pub gate: Vec<EmulatedGate>,
    /// The touch probes.
    #[serde(default)]
    pub touch_probe: Vec<EmulatedTouchProbe>,
    /// The workpieces, which cutting tools carve.
    #[serde(default)]
    pub workpiece: Vec<EmulatedWorkpiece>,
    /// The cutting tools.
    #[serde(default)]
    pub cutter: Vec<EmulatedCutter>,
}

/// A sphere at the origin of a tool.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedTip {
    /// The robot.
    pub robot: String,
    /// Radius, m.
    #[serde(default)]
    pub radius: f64,
}

/// A plane with the solid half-space behind it.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

/// A rigid bar of uniform density and square section. Its x axis is its length.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedBar {
    /// Name of the bar.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Mass, kg.
    pub mass: f64,
    /// Length, m.
    pub length: f64,
    /// Width and height, m.
    pub width: f64,
    /// Place of the centre at the start.
    pub place: Place,
}

/// A gripper at the origin of a robot's tool, which a digital output drives.
///
/// The gripper closes when the output becomes true. It then holds the bar that its jaws reach, in the pose in which the
/// jaws find the bar. Jaws take no time to close.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedGripper {
    /// The robot.
    pub robot: String,
    /// The digital output that closes the gripper.
    pub output: String,
    /// Greatest distance of a bar that the gripper holds, m.
    #[serde(default = "reach")]
    pub reach: f64,
    /// Force per displacement of the bar in the jaws, N/m.
    #[serde(default = "stiffness")]
    pub stiffness: f64,
    /// Force per velocity of the bar in the jaws, N·s/m.
    #[serde(default = "damping")]
    pub damping: f64,
    /// Torque per angle of the bar in the jaws, N·m/rad.
    #[serde(default = "turning_stiffness")]
    pub turning_stiffness: f64,
    /// Torque per angular velocity of the bar in the jaws, N·m·s/rad.
    #[serde(default = "turning_damping")]
    pub turning_damping: f64,
}

/// An upright place: position, and rotation about the vertical axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Position, m.
    pub position: [f64; 3],
    /// Rotation about the vertical axis, rad.
    #[serde(default)]
    pub yaw: f64,
}

impl Place {
    /// The place as a transformation from its own frame.
    pub fn pose(&self) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw);
        Isometry3::from_parts(Translation3::from(self.position), turn)
    }
}

impl EmulatedGripper {
    /// Springs and dampers of the closed gripper.
    pub fn grip(&self) -> GripConfig {
        let &Self { stiffness, damping, turning_stiffness, turning_damping, .. } = self;
        GripConfig { stiffness, damping, turning_stiffness, turning_damping }
    }
}

impl EmulatedScene {
    /// The tips of all robots: name of the robot and radius, m.
    pub fn tips(&self) -> impl Iterator<Item = (&str, f64)> {
        let first = self.robot.iter().map(|robot| (robot.as_str(), self.tip_radius));
        first.chain(self.tip.iter().map(|tip| (tip.robot.as_str(), tip.radius)))
    }
}

fn upward() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

fn reach() -> f64 {
    5e-3
}

fn stiffness() -> f64 {
    GripConfig::NOMINAL.stiffness
}

fn damping() -> f64 {
    GripConfig::NOMINAL.damping
}

fn turning_stiffness() -> f64 {
    GripConfig::NOMINAL.turning_stiffness
}

fn turning_damping() -> f64 {
    GripConfig::NOMINAL.turning_damping
}
