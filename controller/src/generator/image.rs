//! Images that generators read, and set-points that generators return.

use can::Instant;
use servo::MAX_AXES;

use super::{Axes, GeneratorError, Pose};

/// Position and velocity of every axis. The holder determines whether the values are joint or motor values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxesState {
    /// Position, rad, or m for a linear joint.
    pub position: Axes,
    /// Velocity, rad/s, or m/s for a linear joint.
    pub velocity: Axes,
}

impl AxesState {
    /// Standstill at `position`.
    pub const fn at_rest(position: Axes) -> Self {
        Self { position, velocity: [0.0; MAX_AXES] }
    }
}

/// State of an effector at one instant, in motors, joints and pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectorState {
    /// Motors, rad.
    pub motors: AxesState,
    /// Joints, rad or m.
    pub joints: AxesState,
    /// Pose of the tool in the base frame.
    pub pose: Pose,
}

/// `e(i)`: the subcontroller's image of its effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectorImage {
    /// Time of the measurement. While the effector moves: in this macrostep or the previous macrostep. While the
    /// effector stands: when the standstill began.
    pub at: Instant,
    /// The macrostep in execution at that time.
    pub macrostep: u64,
    /// Measured at [`at`](Self::at).
    pub measured: EffectorState,
    /// End of the last macrostep sent, and start of the next macrostep.
    pub commanded: EffectorState,
}

/// `e(i+1)`: the effector's state at the end of the next macrostep, position and velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setpoint {
    /// Motors.
    Motors(AxesState),
    /// Joints.
    Joints(AxesState),
    /// Joints: displacement from the end of the last macrostep, and velocity at the end of this macrostep.
    JointsBy(AxesState),
    /// The tool: pose, and its velocity in the base frame, m/s and rad/s.
    Pose {
        /// Pose of the tool in the base frame.
        pose: Pose,
        /// Velocity of the tool's origin, m/s.
        linear: nalgebra::Vector3<f64>,
        /// Angular velocity of the tool, rad/s.
        angular: nalgebra::Vector3<f64>,
    },
}

impl Setpoint {
    /// Index of the first axis, or of the first coordinate of a pose, with a value that is not finite.
    pub fn not_finite(&self) -> Option<u8> {
        let first = |numbers: &[f64]| numbers.iter().position(|number| !number.is_finite());
        let index = match self {
            Self::Motors(state) | Self::Joints(state) | Self::JointsBy(state) => {
                first(&state.position).or_else(|| first(&state.velocity))
            }
            Self::Pose { pose, linear, angular } => first(pose.translation.vector.as_slice())
                .or_else(|| first(pose.rotation.coords.as_slice()))
                .or_else(|| first(linear.as_slice()))
                .or_else(|| first(angular.as_slice())),
        };
        index.map(|index| index as u8)
    }
}

/// Source of images. Only the images declared by the generator are read.
pub trait ImageSource {
    /// The effector's present image. Fails if the effector measures positions that the mechanism cannot take.
    fn effector(&self) -> Result<EffectorImage, GeneratorError>;
}

/// A set of images: `()` is the empty set, [`EffectorImage`] is `e`.
pub trait Images: Sized {
    /// Contribution to the class: `e` is 1, `V` 2, `a0` 4.
    const CLASS: u8;

    /// Takes the snapshot.
    fn fetch(source: &dyn ImageSource) -> Result<Self, GeneratorError>;
}

impl Images for () {
    const CLASS: u8 = 0;
    fn fetch(_: &dyn ImageSource) -> Result<Self, GeneratorError> {
        Ok(())
    }
}

impl Images for EffectorImage {
    const CLASS: u8 = 1;
    fn fetch(source: &dyn ImageSource) -> Result<Self, GeneratorError> {
        source.effector()
    }
}
