//! Errors of generators.

use thiserror::Error;

use crate::robot::KinematicsError;

/// Why a generator refuses a motion or gives it up.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GeneratorError {
    /// A list of poses that has none.
    #[error("no poses")]
    NoPoses,
    /// An axis count of zero or beyond [`servo::MAX_AXES`].
    #[error("{axes} axes, supported are 1 to {max}")]
    Axes {
        /// Asked for.
        axes: usize,
        /// What can be.
        max: usize,
    },
    /// A coordinate that is NaN or infinite.
    #[error("pose {pose}, axis {axis}: not a finite number")]
    NotFinite {
        /// Index in the list of poses.
        pose: usize,
        /// Index of the axis.
        axis: u8,
    },
    /// A limit that is not positive and finite.
    #[error("axis {axis}: limit is not positive")]
    Limit {
        /// Index of the axis.
        axis: u8,
    },
    /// A speed or acceleration of a path that is not positive and finite.
    #[error("path limit is not positive")]
    PathLimit,
    /// A fraction of a limit outside of (0, 1].
    #[error("pose {pose}, axis {axis}: fraction {value} is not in (0, 1]")]
    Fraction {
        /// Index in the list of poses.
        pose: usize,
        /// Index of the axis.
        axis: u8,
        /// The fraction.
        value: f64,
    },
    /// A macrostep of zero length.
    #[error("macrostep has no length")]
    NoMacrostep,
    /// A motion that would take more macrosteps than any reasonable one.
    #[error("motion takes more than {limit} macrosteps")]
    TooLong {
        /// The most that is accepted.
        limit: u32,
    },
    /// A motion that cannot be done in the time given.
    #[error("takes {needed:.3} s at the least, not {given:.3} s")]
    TooShort {
        /// What it needs, s.
        needed: f64,
        /// What it was given, s.
        given: f64,
    },
    /// No profile within the limits was found.
    #[error("no profile within the limits")]
    NoProfile,
    /// A pose of a path that the arm cannot take, found before the motion began.
    #[error("at {s:.4} of the path: {cause}")]
    Path {
        /// Path parameter, 0 at the start to 1 at the end.
        s: f64,
        /// Which axis, and why.
        cause: KinematicsError,
    },
    /// The arm would have to jump between two neighbouring poses of a path.
    #[error("at {s:.4} of the path: axis {axis} jumps by {by:.3} to the next pose")]
    Jump {
        /// Path parameter.
        s: f64,
        /// Index of the axis.
        axis: u8,
        /// How far, rad or m.
        by: f64,
    },
    /// A path that has to be walked so slowly for one axis that this is a refusal: it is next to a
    /// singularity.
    #[error("at {s:.4} of the path: axis {axis} needs {times:.0} times its limit")]
    Singular {
        /// Path parameter.
        s: f64,
        /// Index of the axis.
        axis: u8,
        /// How many times the axis' limit the asked speed would need.
        times: f64,
    },
    /// The effector measures what its mechanism cannot assume.
    #[error("effector image: {0}")]
    Image(KinematicsError),
    /// A reason of a user's generator; the number is its own.
    #[error("generator error {0}")]
    User(u16),
}
