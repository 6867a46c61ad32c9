//! State of an axis as measured.

use can::Instant;

use crate::{Fault, Increments};

/// What is known of one axis at the cycle of [`AxisState::at`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisState {
    /// When the drive's last answer was received.
    pub at: Instant,
    /// Cycles without an answer to their SYNC: 0 in a cycle that read one. Older answers do not count.
    pub age: u32,
    /// Motor position, rad. Meaningless as an absolute position until [`Homing::Attained`].
    pub position: f64,
    /// The same position as the drive counts it.
    pub increments: Increments,
    /// Motor velocity, rad/s.
    pub velocity: f64,
    /// Motor torque, N·m; zero where the drive does not say.
    pub torque: f64,
    /// Whether the motor has torque.
    pub power: Power,
    /// Whether the position counter has its reference.
    pub homing: Homing,
    /// Whether the drive follows the set-points it is sent.
    pub following: bool,
    /// The switches of the axis; open where the drive does not say.
    pub switches: Switches,
    /// What stands in the way, latched until reset.
    pub fault: Option<Fault>,
}

/// Which switches of an axis are closed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Switches {
    /// The home (synchronisation) switch.
    pub home: bool,
    /// The limit switch at the lower end of the counter's travel.
    pub lower_limit: bool,
    /// The limit switch at its upper end.
    pub upper_limit: bool,
}

/// Whether a drive's power stage is on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Power {
    /// No torque.
    #[default]
    Off,
    /// On its way from off to on or back.
    Changing,
    /// Torque.
    On,
}

/// What a drive says of its reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Homing {
    /// The position counter means nothing yet.
    #[default]
    NotHomed,
    /// The axis is searching.
    InProgress,
    /// The counter is referenced, by this run or by one before it.
    Attained,
    /// The search ended without a reference; leave [`AxisCommand::Home`](crate::AxisCommand::Home) to try again.
    Failed,
}
