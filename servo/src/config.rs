use std::time::Duration;

use thiserror::Error;

use crate::{AxisLimits, MAX_AXES};

/// What a [`Servo`](crate::Servo) steps and how fast.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoConfig {
    /// Time from one SYNC to the next.
    pub period: Duration,
    /// Cycles that may miss their deadline in a row before every effector stops with category 1.
    pub max_missed_in_row: u32,
    /// The effectors, in the order of their links.
    pub effectors: Vec<EffectorConfig>,
}

/// One effector: a robot, a track, a gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectorConfig {
    /// Its name in the cell.
    pub name: String,
    /// Its axes, in the order of [`Macrostep::position`](crate::Macrostep::position).
    pub axes: Vec<ServoAxisConfig>,
    /// Orders that may wait in its queue.
    pub queue: usize,
    /// Longest time from [`Order::Enable`](crate::Order::Enable) to every axis on and following,
    /// and from [`Order::ResetFault`](crate::Order::ResetFault) to every drive without a fault.
    pub enabling_timeout: Duration,
    /// Longest time homing may take, all axes together.
    pub homing_timeout: Duration,
}

/// One axis of an effector: which drive it is, and what it may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoAxisConfig {
    /// Index of its drive group.
    pub group: usize,
    /// Index of the axis within that group.
    pub index_in_group: usize,
    /// Lowest commanded motor position, rad.
    pub min_position: f64,
    /// Highest commanded motor position, rad.
    pub max_position: f64,
    /// Highest commanded motor speed, rad/s.
    pub max_velocity: f64,
    /// Highest commanded motor acceleration, rad/s²; every stop brakes with it.
    ///
    /// It is for the interpolated sequence. Where a planned acceleration changes sign in the middle
    /// of a macrostep, the cubic through its ends needs up to 1.5 times the planned value.
    pub max_acceleration: f64,
    /// Largest distance, rad, between the motor and the command whose effect its drive sampled,
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before.
    pub following_error: f64,
    /// Axes of equal order home together, lower orders first.
    pub homing_order: u8,
}

impl ServoAxisConfig {
    /// The limits of its commanded sequence.
    pub fn limits(&self) -> AxisLimits {
        AxisLimits {
            min_position: self.min_position,
            max_position: self.max_position,
            max_velocity: self.max_velocity,
            max_acceleration: self.max_acceleration,
        }
    }
}

/// Why a [`Servo`](crate::Servo) cannot be made of a configuration. Indices count from zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ServoError {
    /// The period is zero.
    #[error("the period is zero")]
    ZeroPeriod,
    /// An effector has no axis or too many.
    #[error("effector {effector} has {axes} axes, 1 to {max} are possible", max = MAX_AXES)]
    AxisCount {
        /// The effector.
        effector: usize,
        /// Its axes.
        axes: usize,
    },
    /// An effector's queue holds nothing.
    #[error("effector {effector} has a queue of zero orders")]
    EmptyQueue {
        /// The effector.
        effector: usize,
    },
    /// An axis is in a group that does not exist.
    #[error("effector {effector} axis {axis} is in group {group}, there are {groups} groups")]
    NoSuchGroup {
        /// The effector.
        effector: usize,
        /// The axis within it.
        axis: usize,
        /// The group asked for.
        group: usize,
        /// Groups given.
        groups: usize,
    },
    /// A group does not have that axis.
    #[error(
        "effector {effector} axis {axis} is axis {index} of group {group}, which has {axes} axes"
    )]
    NoSuchAxis {
        /// The effector.
        effector: usize,
        /// The axis within it.
        axis: usize,
        /// The group.
        group: usize,
        /// The index asked for.
        index: usize,
        /// Axes of the group.
        axes: usize,
    },
    /// One drive serves two axes.
    #[error(
        "effector {effector} axis {axis} is axis {index} of group {group}, which is taken already"
    )]
    MappedTwice {
        /// The effector that came second.
        effector: usize,
        /// The axis within it.
        axis: usize,
        /// The group.
        group: usize,
        /// The index within the group.
        index: usize,
    },
    /// A limit is not a number, not positive, or the lowest position is not below the highest.
    #[error("effector {effector} axis {axis}: {limit} makes no sense")]
    BadLimit {
        /// The effector.
        effector: usize,
        /// The axis within it.
        axis: usize,
        /// Name of the field of [`ServoAxisConfig`].
        limit: &'static str,
    },
}

impl ServoConfig {
    /// Finds the first thing wrong with it; `group_axes` is how many axes each group has.
    pub(crate) fn check(&self, group_axes: &[usize]) -> Result<(), ServoError> {
        if self.period.is_zero() {
            return Err(ServoError::ZeroPeriod);
        }
        let mut taken = Vec::new();
        for (effector, config) in self.effectors.iter().enumerate() {
            let axes = config.axes.len();
            if axes == 0 || axes > MAX_AXES {
                return Err(ServoError::AxisCount { effector, axes });
            }
            if config.queue == 0 {
                return Err(ServoError::EmptyQueue { effector });
            }
            for (axis, config) in config.axes.iter().enumerate() {
                let (group, index) = (config.group, config.index_in_group);
                let groups = group_axes.len();
                let Some(&axes) = group_axes.get(group) else {
                    return Err(ServoError::NoSuchGroup {
                        effector,
                        axis,
                        group,
                        groups,
                    });
                };
                if index >= axes {
                    return Err(ServoError::NoSuchAxis {
                        effector,
                        axis,
                        group,
                        index,
                        axes,
                    });
                }
                if taken.contains(&(group, index)) {
                    return Err(ServoError::MappedTwice {
                        effector,
                        axis,
                        group,
                        index,
                    });
                }
                taken.push((group, index));
                if let Some(limit) = config.nonsense() {
                    return Err(ServoError::BadLimit {
                        effector,
                        axis,
                        limit,
                    });
                }
            }
        }
        Ok(())
    }
}

impl ServoAxisConfig {
    /// The first field that makes no sense.
    fn nonsense(&self) -> Option<&'static str> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        if !self.min_position.is_finite() {
            Some("min_position")
        } else if !self.max_position.is_finite() || self.max_position <= self.min_position {
            Some("max_position")
        } else if !positive(self.max_velocity) {
            Some("max_velocity")
        } else if !positive(self.max_acceleration) {
            Some("max_acceleration")
        } else if !positive(self.following_error) {
            Some("following_error")
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scripted::config;

    fn refusal(change: impl FnOnce(&mut ServoConfig)) -> Result<(), ServoError> {
        let mut config = config(2);
        change(&mut config);
        config.check(&[2])
    }

    #[test]
    fn a_configuration_is_refused_for_what_is_wrong_with_it() {
        let bad = |limit| {
            Err(ServoError::BadLimit {
                effector: 0,
                axis: 1,
                limit,
            })
        };
        let mapped_twice = ServoError::MappedTwice {
            effector: 0,
            axis: 1,
            group: 0,
            index: 0,
        };
        let no_group = ServoError::NoSuchGroup {
            effector: 0,
            axis: 1,
            group: 1,
            groups: 1,
        };
        let no_axis = ServoError::NoSuchAxis {
            effector: 0,
            axis: 1,
            group: 0,
            index: 2,
            axes: 2,
        };
        type Case = (fn(&mut ServoConfig), Result<(), ServoError>);
        let cases: [Case; 14] = [
            (|_| {}, Ok(())),
            (|c| c.period = Duration::ZERO, Err(ServoError::ZeroPeriod)),
            (
                |c| c.effectors[0].axes.clear(),
                Err(ServoError::AxisCount {
                    effector: 0,
                    axes: 0,
                }),
            ),
            (
                |c| c.effectors[0].axes = vec![c.effectors[0].axes[0]; 9],
                Err(ServoError::AxisCount {
                    effector: 0,
                    axes: 9,
                }),
            ),
            (
                |c| c.effectors[0].queue = 0,
                Err(ServoError::EmptyQueue { effector: 0 }),
            ),
            (
                |c| c.effectors[0].axes[1].index_in_group = 0,
                Err(mapped_twice),
            ),
            (|c| c.effectors[0].axes[1].group = 1, Err(no_group)),
            (|c| c.effectors[0].axes[1].index_in_group = 2, Err(no_axis)),
            (
                |c| c.effectors[0].axes[1].min_position = f64::NAN,
                bad("min_position"),
            ),
            (
                |c| c.effectors[0].axes[1].max_position = -1000.0,
                bad("max_position"),
            ),
            (
                |c| c.effectors[0].axes[1].max_velocity = 0.0,
                bad("max_velocity"),
            ),
            (
                |c| c.effectors[0].axes[1].max_acceleration = -1.0,
                bad("max_acceleration"),
            ),
            (
                |c| c.effectors[0].axes[1].following_error = f64::INFINITY,
                bad("following_error"),
            ),
            (|c| c.max_missed_in_row = 0, Ok(())),
        ];
        for (number, (change, expected)) in cases.into_iter().enumerate() {
            assert_eq!(refusal(change), expected, "case {number}");
        }
    }
}
