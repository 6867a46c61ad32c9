//! Images that generators read, and set-points that generators return.

use std::time::Duration;

use can::Instant;
use servo::{MAX_AXES, Switches};

use super::{Axes, Pose};
use crate::path::PoseState;

/// State of motion of every axis. The holder determines whether the values are joint or motor values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxesState {
    /// Position, rad, or m for a linear joint.
    pub position: Axes,
    /// Velocity, rad/s, or m/s for a linear joint.
    pub velocity: Axes,
    /// Acceleration, rad/s², or m/s² for a linear joint. `None` in images. A set-point with `None` gets the end
    /// acceleration of a cubic from the previous set-point.
    pub acceleration: Option<Axes>,
}

impl AxesState {
    /// A motion without a stated acceleration.
    pub const fn new(position: Axes, velocity: Axes) -> Self {
        Self { position, velocity, acceleration: None }
    }

    /// Standstill at `position`, with zero acceleration.
    pub const fn at_rest(position: Axes) -> Self {
        Self { position, velocity: [0.0; MAX_AXES], acceleration: Some([0.0; MAX_AXES]) }
    }

    /// The same motion with this acceleration, rad/s² or m/s².
    #[must_use]
    pub const fn accelerating(self, acceleration: Axes) -> Self {
        Self { acceleration: Some(acceleration), ..self }
    }
}

/// Commanded accelerations of an effector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accelerations {
    /// Motors, rad/s².
    pub motors: Axes,
    /// Joints, rad/s², or m/s² for a linear joint.
    pub joints: Axes,
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
    /// Time of the SYNC or telegram at which the drives took their samples. If the times differ, the time of the oldest
    /// sample. A first step reads the latest samples, and so do next steps before the first report of a motion. Other
    /// next steps read the samples of the last report.
    pub at: Instant,
    /// Time of the servo cycle that read the samples, at least one period after [`at`](Self::at).
    pub read_at: Instant,
    /// Time from the sample of each axis to [`read_at`](Self::read_at): one servo period if the drive answered in time.
    pub age: [Duration; MAX_AXES],
    /// The macrostep in execution at [`read_at`](Self::read_at).
    pub macrostep: u64,
    /// Measured state. The sample of each axis was taken at [`read_at`](Self::read_at) minus its [`age`](Self::age).
    pub measured: EffectorState,
    /// Measured motor torques, N·m; zero where the drive does not report a torque.
    pub torque: Axes,
    /// Switches of the axes; open where the drive does not report its switches.
    pub switches: [Switches; MAX_AXES],
    /// Commanded state at the end of the last macrostep sent, which is the start of the next macrostep.
    pub commanded: EffectorState,
    /// Acceleration at the end of the last macrostep sent.
    pub commanded_acceleration: Accelerations,
}

impl EffectorImage {
    /// An effector that stands at `state`, sampled at time zero: for tests of generators.
    pub fn standing(state: EffectorState) -> Self {
        Self {
            at: Instant::ZERO,
            read_at: Instant::ZERO,
            age: [Duration::ZERO; MAX_AXES],
            macrostep: 0,
            measured: state,
            torque: Axes::default(),
            switches: [Switches::default(); MAX_AXES],
            commanded: state,
            commanded_acceleration: Accelerations::default(),
        }
    }
}

/// `e(i+1)`: the effector's state at the end of the next macrostep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setpoint {
    /// Motors.
    Motors(AxesState),
    /// Joints.
    Joints(AxesState),
    /// Joints: displacement from the end of the last macrostep; velocity and acceleration at the end of this macrostep.
    JointsBy(AxesState),
    /// The tool: pose and velocity in the base frame, without a stated acceleration.
    Pose {
        /// Pose of the tool in the base frame.
        pose: Pose,
        /// Velocity of the tool's origin, m/s.
        linear: nalgebra::Vector3<f64>,
        /// Angular velocity of the tool, rad/s.
        angular: nalgebra::Vector3<f64>,
    },
    /// The tool: pose, velocity and acceleration in the base frame.
    Tool(PoseState),
}

impl Setpoint {
    /// Index of the first axis, or of the first coordinate of a pose, with a value that is not finite.
    pub fn not_finite(&self) -> Option<u8> {
        let first = |numbers: &[f64]| numbers.iter().position(|number| !number.is_finite());
        let index = match self {
            Self::Motors(state) | Self::Joints(state) | Self::JointsBy(state) => {
                let acceleration = state.acceleration.unwrap_or_default();
                first(&state.position).or_else(|| first(&state.velocity)).or_else(|| first(&acceleration))
            }
            Self::Tool(PoseState { linear_acceleration, angular_acceleration, .. })
                if !linear_acceleration.iter().chain(angular_acceleration).all(|number| number.is_finite()) =>
            {
                Some(0)
            }
            Self::Pose { pose, linear, angular } | Self::Tool(PoseState { pose, linear, angular, .. }) => {
                first(pose.translation.vector.as_slice())
                    .or_else(|| first(pose.rotation.coords.as_slice()))
                    .or_else(|| first(linear.as_slice()))
                    .or_else(|| first(angular.as_slice()))
            }
        };
        index.map(|index| index as u8)
    }
}
