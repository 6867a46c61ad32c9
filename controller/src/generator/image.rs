//! Images that generators read, and set-points that they give.

use can::Instant;
use servo::MAX_AXES;

use super::{Axes, GeneratorError, Pose};

/// Position and velocity of every axis, joint or motor as the holder says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxesState {
    /// rad, or m for a linear joint.
    pub position: Axes,
    /// rad/s, or m/s for a linear joint.
    pub velocity: Axes,
}

impl AxesState {
    /// At rest there.
    pub const fn at_rest(position: Axes) -> Self {
        Self {
            position,
            velocity: [0.0; MAX_AXES],
        }
    }
}

/// An effector at one instant, in all three spaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectorState {
    /// Motors, rad.
    pub motors: AxesState,
    /// Joints.
    pub joints: AxesState,
    /// Base from tool.
    pub pose: Pose,
}

/// `e(i)`: what the subcontroller knows of its effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectorImage {
    /// When the measurement was taken: in this macrostep or the last while the effector moves; when it came
    /// to its stand while it stands.
    pub at: Instant,
    /// The macrostep that was being executed then.
    pub macrostep: u64,
    /// Measured at [`at`](Self::at).
    pub measured: EffectorState,
    /// Where the last macrostep sent ends and the next one begins.
    pub commanded: EffectorState,
}

/// `e(i+1)`: where the effector is to be when the next macrostep ends, and how fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setpoint {
    /// Motors.
    Motors(AxesState),
    /// Joints.
    Joints(AxesState),
    /// Joints: displacement from where the last macrostep ends, and velocity at the end of this one.
    JointsBy(AxesState),
    /// The tool: pose, and its velocity in the base frame, m/s and rad/s.
    Pose {
        /// Base from tool.
        pose: Pose,
        /// Of the tool's origin, m/s.
        linear: nalgebra::Vector3<f64>,
        /// rad/s.
        angular: nalgebra::Vector3<f64>,
    },
}

impl Setpoint {
    /// Index of the first axis, or of the first coordinate of a pose, that is not a finite number.
    pub fn not_finite(&self) -> Option<u8> {
        let first = |numbers: &[f64]| numbers.iter().position(|number| !number.is_finite());
        let index = match self {
            Self::Motors(state) | Self::Joints(state) | Self::JointsBy(state) => {
                first(&state.position).or_else(|| first(&state.velocity))
            }
            Self::Pose {
                pose,
                linear,
                angular,
            } => first(pose.translation.vector.as_slice())
                .or_else(|| first(pose.rotation.coords.as_slice()))
                .or_else(|| first(linear.as_slice()))
                .or_else(|| first(angular.as_slice())),
        };
        index.map(|index| index as u8)
    }
}

/// Where images are fetched from. Only those that a generator declares are.
pub trait ImageSource {
    /// The effector's image now. An error if it measures what the mechanism cannot assume.
    fn effector(&self) -> Result<EffectorImage, GeneratorError>;
}

/// A set of images: `()` is none, [`EffectorImage`] is `e`.
pub trait Images: Sized {
    /// Its part of the class: `e` is 1, `V` 2, `a0` 4.
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
