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
    /// Torque, N·m, from which the motor counts as overloaded: its rated torque (object 0x6076), or the torque at which
    /// its protection acts. Zero where unknown.
    pub torque_limit: f64,
    /// The drive reports that it limits the torque: bit 11 of the statusword, or the limit of the current.
    pub torque_limited: bool,
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

/// Share of [`AxisState::torque_limit`] from which the torque counts as at its limit. The controller of a drive may
/// keep the torque slightly below the limit.
const AT_LIMIT: f64 = 0.9;

/// The same share for a drive that reports a limit, which may be that of its speed.
const AT_REPORTED_LIMIT: f64 = 0.5;

impl AxisState {
    /// Torque and its limit, N·m, if the torque is at its limit.
    pub fn torque_at_limit(&self) -> Option<(f64, f64)> {
        let share = if self.torque_limited { AT_REPORTED_LIMIT } else { AT_LIMIT };
        let (torque, limit) = (self.torque, self.torque_limit);
        (limit > 0.0 && torque.abs() >= share * limit).then_some((torque, limit))
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torque_counts_as_at_its_limit_by_its_share_and_by_the_report_of_the_drive() {
        for (torque, torque_limit, torque_limited, expected) in [
            (0.37, 0.42, false, false),
            (0.38, 0.42, false, true),
            (-2.1, 0.42, false, true),
            (0.2, 0.42, true, false),
            (-0.22, 0.42, true, true),
            (f64::NAN, 0.42, true, false),
            // A drive whose limit is not known.
            (2.1, 0.0, true, false),
        ] {
            let state = AxisState { torque, torque_limit, torque_limited, ..AxisState::default() };
            let found = state.torque_at_limit();
            assert_eq!(found.is_some(), expected, "{torque} of {torque_limit}, {torque_limited}");
            assert!(found.is_none_or(|found| found == (torque, torque_limit)));
        }
    }
}
