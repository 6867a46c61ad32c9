//! Part of a motion that joints slow.

use std::fmt;

/// Limit of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointLimit {
    /// The limit of velocity.
    Velocity,
    /// The limit of acceleration.
    Acceleration,
}

impl fmt::Display for JointLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
        })
    }
}

/// Part of a path in which the fastest motion within the limits of the tool would exceed the limits of joints,
/// around the place of the greatest excess.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlowedPart {
    /// Begin and end of the part, from 0 at the start of the path to 1 at its end.
    pub from: f64,
    /// See [`from`](Self::from).
    pub to: f64,
    /// The joint that would exceed its limit most.
    pub joint: u8,
    /// This limit.
    pub limit: JointLimit,
    /// How many times slower the motion must be for this limit.
    pub times: f64,
}
