//! Measured state of an axis.

use can::Instant;

use crate::{Fault, Increments};

/// Measured state of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisState {
    /// When the drive's last answer was received.
    pub at: Instant,
    /// When the drive took the sample of [`position`](Self::position): when the last SYNC before the answer, or the
    /// telegram that the drive answered, was sent.
    pub sampled: Instant,
    /// Cycles since an answer to the last SYNC was read: 0 in a cycle that read one. Older answers do not count.
    pub age: u32,
    /// Periods by which all answers of the drive are known to come later than in the period of their SYNC, as
    /// [`sampled`](Self::sampled) takes into account. 0 on a sound bus.
    pub lag: u32,
    /// Motor position, rad. Not an absolute position before [`Homing::Attained`].
    pub position: f64,
    /// The same position in the drive's unit.
    pub increments: Increments,
    /// Motor velocity, rad/s.
    pub velocity: f64,
    /// Motor torque, N·m; zero where the drive does not report it.
    pub torque: f64,
    /// Whether the motor has torque.
    pub power: Power,
    /// Whether the position counter has its reference.
    pub homing: Homing,
    /// Distance, rad, by which the motor must have moved since the counter last changed, if the drive searches for its
    /// reference and the counter stands still for too long.
    pub stalled: Option<f64>,
    /// Whether the drive follows the set-points it is sent.
    pub following: bool,
    /// The switches of the axis; open where the drive does not report them.
    pub switches: Switches,
    /// The fault of the axis, latched until reset.
    pub fault: Option<Fault>,
    /// A reset of the fault brings the drive up again. Every step has a deadline, and the fault ends or changes at the end.
    pub recovering: bool,
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
    /// Changing between on and off.
    Changing,
    /// Torque.
    On,
}

/// Homing state as reported by the drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Homing {
    /// The position counter has no reference.
    #[default]
    NotHomed,
    /// The axis is searching.
    InProgress,
    /// The counter has its reference, found in this run or an earlier one.
    Attained,
    /// The search ended without a reference; leave [`AxisCommand::Home`](crate::AxisCommand::Home) to try again.
    Failed,
}
