//! Refusals of parts of a scene.

use std::time::Duration;

use thiserror::Error;

use super::{MOST_CELLS, SHORTEST_RESPONSE};

/// Why a part cannot be added to a scene.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SceneError {
    /// The damping or the friction would add energy, or the stiffness is not above zero.
    #[error(
        "a surface with {stiffness} N/m, {damping} N·s/m and friction {friction} is not passive: use a stiffness above \
         zero, and neither damping nor friction below zero"
    )]
    Surface {
        /// Stiffness, N/m.
        stiffness: f64,
        /// Damping, N·s/m.
        damping: f64,
        /// Friction.
        friction: f64,
    },
    /// A stiffness or a damping below zero would add energy.
    #[error("a grip with {stiffness} N/m and {damping} N·s/m is not passive: use no value below zero")]
    Grip {
        /// Stiffness, N/m.
        stiffness: f64,
        /// Damping, N·s/m.
        damping: f64,
    },
    /// A dimension is not above zero.
    #[error("{what} of {value} m: use a length above zero")]
    Length {
        /// The dimension.
        what: &'static str,
        /// Value, m.
        value: f64,
    },
    /// The height field of a workpiece is too large.
    #[error(
        "a height field of {columns} by {rows} cells: use at most {MOST_CELLS} cells, by wider cells or a smaller workpiece"
    )]
    Cells {
        /// Cells along x.
        columns: usize,
        /// Cells along y.
        rows: usize,
    },
    /// A cutting force below zero would add energy.
    #[error("cutting forces of {specific} N/m² and {edge} N/m: use no value below zero")]
    CuttingForce {
        /// Force per area, N/m².
        specific: f64,
        /// Force per width, N/m.
        edge: f64,
    },
    /// A mass is not above zero.
    #[error("a body of {mass} kg: use a mass above zero")]
    Mass {
        /// Mass, kg.
        mass: f64,
    },
    /// A light gate would report an edge before its device can take the edge.
    #[error("a light gate with a response time of {response:.1?}: use at least {SHORTEST_RESPONSE:.1?}")]
    Response {
        /// Response time.
        response: Duration,
    },
    /// The threshold of a touch probe is not above zero or not finite.
    #[error("a touch probe that closes at {threshold} N: use a force above zero")]
    Threshold {
        /// Threshold, N.
        threshold: f64,
    },
    /// A coordinate or an angle is NaN or infinite.
    #[error("{what} is not finite")]
    NotFinite {
        /// The quantity.
        what: &'static str,
    },
    /// The weight of the robot's links would have another direction than the weight of the bodies.
    #[error("the base of the robot leans by {angle:.4} rad: turn the base so that its upward direction is up")]
    Leaning {
        /// Angle between the upward directions of the robot and of the scene, rad.
        angle: f64,
    },
    /// The mechanism already belongs to this scene or to another scene.
    #[error("the robot is part of a scene already: add each robot once, and keep one scene for the cell")]
    Taken,
}
