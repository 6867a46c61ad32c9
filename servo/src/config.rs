//! Configuration of a servo.

mod host_homing;
mod loop_ranges;
mod position_loop;
pub(crate) mod refusal;
mod stability;

use std::time::Duration;

use thiserror::Error;

pub use host_homing::{Direction, HomingLeg, HostHoming};
pub use loop_ranges::LoopBounds;
pub use position_loop::{FeedForward, HostLoop, Law, Output, PositionLoop};
pub use refusal::{Figure, KeyError, KeyProblem, Range};
pub use stability::LoopPlant;

use crate::MAX_AXES;
use refusal::{first_wrong, is_positive};

/// Greatest number of effectors of one servo. A bit set of 32 bits names any of them.
pub const MAX_EFFECTORS: usize = 32;

/// Configuration of a [`Servo`](crate::Servo): period and effectors.
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
    /// Longest time from [`Order::Enable`](crate::Order::Enable) to every axis on and following.
    ///
    /// A reset ends at the latest after this time or after one second, whichever is shorter, from
    /// [`Order::ResetFault`](crate::Order::ResetFault) or from the end of the last
    /// [recovery](drive::AxisState::recovering) of a drive.
    pub enabling_timeout: Duration,
    /// Longest time homing may take, all axes together.
    pub homing_timeout: Duration,
}

/// One axis of an effector: its drive and its limits.
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
    /// The limit applies to the interpolated sequence. Where a planned acceleration changes sign in the middle of a
    /// macrostep, the interpolating quintic needs up to 1.7 times the planned value.
    pub max_acceleration: f64,
    /// Highest planned jerk of the motor, rad/s³. A change of the speed override adds at most the same jerk, if planned
    /// accelerations are at most half of `max_acceleration`.
    pub planned_jerk: f64,
    /// Largest following error, rad: distance between the motor and the command whose effect its drive sampled,
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before.
    pub following_error: f64,
    /// Axes of equal order home together, lower orders first.
    pub homing_order: u8,
    /// Encoder increments per radian of motor rotation, negative if they fall while the motor turns in
    /// its positive direction: [`Scale::increments_per_radian`](drive::Scale::increments_per_radian).
    pub increments_per_radian: f64,
    /// Whether the servo or the drive closes the position loop.
    pub position_loop: PositionLoop,
    /// Rated torque of the motor, N·m, if the drive closes the position loop and takes a torque beside the position
    /// ([`Setpoint::PositionWithTorque`](drive::Setpoint::PositionWithTorque)). [Excitations](crate::Excitation) then
    /// are such torques.
    pub torque_offset: Option<f64>,
    /// Homing by the servo; `None` if the drive homes the axis ([`AxisCommand::Home`](drive::AxisCommand::Home)).
    /// Possible only where the servo closes the position loop. After its counter was set, a drive that closes the
    /// loop would still follow positions of the old count, which are under way.
    pub homing: Option<HostHoming>,
    /// When a measured position that stands still is a fault.
    pub frozen: FrozenWatch,
    /// Whether the motors get their power again if this motor moves after an orderly power-off
    /// ([`StopCause::BrakeSlips`](crate::StopCause::BrakeSlips)).
    pub brake_watch: bool,
}

/// When a measured position that stands still, although the motor should move, stops the effector
/// ([`StopCause::Frozen`](crate::StopCause::Frozen)).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrozenWatch {
    /// Never.
    Off,
    /// While the axis follows set-points. The drive homes the axis at a mechanical stop, where the motor stands still.
    Following,
    /// Also while the axis is homed.
    #[default]
    Always,
}

/// Error in the configuration of a [`Servo`](crate::Servo). Indices count from zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum ServoError {
    #[error("the period is zero")]
    ZeroPeriod,
    #[error("the servo has {effectors} effectors, {max} are possible", max = MAX_EFFECTORS)]
    EffectorCount { effectors: usize },
    #[error("effector {effector} has {axes} axes, 1 to {max} are possible", max = MAX_AXES)]
    AxisCount { effector: usize, axes: usize },
    #[error("effector {effector} has a queue of zero orders")]
    EmptyQueue { effector: usize },
    #[error("effector {effector} axis {axis} is in group {group}, there are {groups} groups")]
    NoSuchGroup { effector: usize, axis: usize, group: usize, groups: usize },
    #[error("effector {effector} axis {axis} is axis {index} of group {group}, which has {axes} axes")]
    NoSuchAxis { effector: usize, axis: usize, group: usize, index: usize, axes: usize },
    #[error("effector {effector} axis {axis} is axis {index} of group {group}, which is taken already")]
    MappedTwice { effector: usize, axis: usize, group: usize, index: usize },
    /// A limit is not a number, not positive, or the lowest position is not below the highest. `limit` names the field
    /// of [`ServoAxisConfig`].
    #[error("effector {effector} axis {axis}: {limit} makes no sense")]
    BadLimit { effector: usize, axis: usize, limit: &'static str },
}

impl ServoConfig {
    /// Returns the first error. `group_axes` is the number of axes of each group.
    pub(crate) fn check(&self, group_axes: &[usize]) -> Result<(), ServoError> {
        if self.period.is_zero() {
            return Err(ServoError::ZeroPeriod);
        }
        if self.effectors.len() > MAX_EFFECTORS {
            return Err(ServoError::EffectorCount { effectors: self.effectors.len() });
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
                    return Err(ServoError::NoSuchGroup { effector, axis, group, groups });
                };
                if index >= axes {
                    return Err(ServoError::NoSuchAxis { effector, axis, group, index, axes });
                }
                if taken.contains(&(group, index)) {
                    return Err(ServoError::MappedTwice { effector, axis, group, index });
                }
                taken.push((group, index));
                if let Some(limit) = config.nonsense() {
                    return Err(ServoError::BadLimit { effector, axis, limit });
                }
            }
        }
        Ok(())
    }
}

impl ServoAxisConfig {
    /// Longest duration of a stop, s: from the greatest velocity, or during homing.
    pub(crate) fn stopping_time(&self) -> f64 {
        let homing =
            self.homing.map_or(0.0, |homing| homing.search.velocity.max(homing.zero.velocity) / homing.acceleration);
        homing.max(self.max_velocity / self.max_acceleration)
    }

    /// The first field with an implausible value, as named by [`ServoError::BadLimit`].
    pub fn nonsense(&self) -> Option<&'static str> {
        let by_drive = self.position_loop == PositionLoop::Drive;
        let limits = first_wrong([
            (self.min_position.is_finite(), "min_position"),
            (self.max_position.is_finite() && self.max_position > self.min_position, "max_position"),
            (is_positive(self.max_velocity), "max_velocity"),
            (is_positive(self.max_acceleration), "max_acceleration"),
            (is_positive(self.planned_jerk), "planned_jerk"),
            (is_positive(self.following_error), "following_error"),
            (is_positive(self.increments_per_radian.abs()), "increments_per_radian"),
        ]);
        let host = || match &self.position_loop {
            PositionLoop::Drive => None,
            PositionLoop::Host(host) => host.nonsense(self.max_velocity),
        };
        let of_drive = [
            (self.torque_offset.is_none_or(|rated| is_positive(rated) && by_drive), "torque_offset"),
            (self.homing.is_none() || !by_drive, "homing, where the drive closes the position loop,"),
        ];
        let homing = || self.homing?.nonsense(self.max_velocity, self.max_acceleration);
        limits.or_else(host).or_else(|| first_wrong(of_drive)).or_else(homing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regulator::{CascadeConfig, IRP6, IRP6_DUTY, IncrementalConfig, ProportionalConfig};
    use crate::scripted::config;

    fn refusal(change: impl FnOnce(&mut ServoConfig)) -> Result<(), ServoError> {
        let mut config = config(2);
        change(&mut config);
        config.check(&[2])
    }

    #[test]
    fn a_configuration_is_refused_for_what_is_wrong_with_it() {
        let bad = |limit| Err(ServoError::BadLimit { effector: 0, axis: 1, limit });
        let mapped_twice = ServoError::MappedTwice { effector: 0, axis: 1, group: 0, index: 0 };
        let no_group = ServoError::NoSuchGroup { effector: 0, axis: 1, group: 1, groups: 1 };
        let no_axis = ServoError::NoSuchAxis { effector: 0, axis: 1, group: 0, index: 2, axes: 2 };
        type Case = (fn(&mut ServoConfig), Result<(), ServoError>);
        let cases: [Case; 16] = [
            (|_| {}, Ok(())),
            (|c| c.period = Duration::ZERO, Err(ServoError::ZeroPeriod)),
            (|c| c.effectors = vec![c.effectors[0].clone(); 33], Err(ServoError::EffectorCount { effectors: 33 })),
            (|c| c.effectors[0].axes.clear(), Err(ServoError::AxisCount { effector: 0, axes: 0 })),
            (
                |c| c.effectors[0].axes = vec![c.effectors[0].axes[0]; 9],
                Err(ServoError::AxisCount { effector: 0, axes: 9 }),
            ),
            (|c| c.effectors[0].queue = 0, Err(ServoError::EmptyQueue { effector: 0 })),
            (|c| c.effectors[0].axes[1].index_in_group = 0, Err(mapped_twice)),
            (|c| c.effectors[0].axes[1].group = 1, Err(no_group)),
            (|c| c.effectors[0].axes[1].index_in_group = 2, Err(no_axis)),
            (|c| c.effectors[0].axes[1].min_position = f64::NAN, bad("min_position")),
            (|c| c.effectors[0].axes[1].torque_offset = Some(0.0), bad("torque_offset")),
            (|c| c.effectors[0].axes[1].max_position = -1000.0, bad("max_position")),
            (|c| c.effectors[0].axes[1].max_velocity = 0.0, bad("max_velocity")),
            (|c| c.effectors[0].axes[1].max_acceleration = -1.0, bad("max_acceleration")),
            (|c| c.effectors[0].axes[1].following_error = f64::INFINITY, bad("following_error")),
            (|c| c.max_missed_in_row = 0, Ok(())),
        ];
        for (number, (change, expected)) in cases.into_iter().enumerate() {
            assert_eq!(refusal(change), expected, "case {number}");
        }
    }

    const PROPORTIONAL: ProportionalConfig =
        ProportionalConfig { position_gain: 50.0, integral_rate: 0.0, limit: 250.0 };
    const HOST: HostLoop = HostLoop {
        law: Law::Incremental(IRP6_DUTY[0]),
        output: Output::Duty,
        feed_forward: FeedForward {
            velocity: 0.0,
            acceleration: 0.0,
            coulomb: 0.0,
            stiction: None,
            stribeck_velocity: None,
            weight: None,
            constant: 0.0,
        },
        runaway_velocity: 120.0,
    };
    const CASCADE: CascadeConfig =
        CascadeConfig { position_gain: 40.0, velocity_gain: 0.02, integral_rate: 50.0, limit: 1.0 };
    const HOMING: HostHoming = HostHoming {
        direction: Direction::Negative,
        search: LEG,
        zero: LEG,
        acceleration: 500.0,
        pause: Duration::ZERO,
        debounce: 1,
        reverse_at_limit: true,
    };
    const LEG: HomingLeg = HomingLeg { velocity: 15.0, distance: 60.0, timeout: Duration::from_secs(5) };

    fn refused_limit(change: impl FnOnce(&mut ServoAxisConfig)) -> Option<&'static str> {
        let result = refusal(|config| change(&mut config.effectors[0].axes[0]));
        match result {
            Ok(()) => None,
            Err(ServoError::BadLimit { limit, .. }) => Some(limit),
            Err(other) => panic!("{other}"),
        }
    }

    #[test]
    fn a_loop_of_the_host_is_refused_for_the_field_that_is_wrong() {
        type Case = (fn(&mut HostLoop), Option<&'static str>);
        let cases: [Case; 19] = [
            (|_| {}, None),
            (|l| l.runaway_velocity = 100.0, Some("runaway_velocity, not above max_velocity,")),
            (|l| l.feed_forward.velocity = -1.0, Some("feed_forward.velocity")),
            (|l| l.feed_forward.acceleration = f64::NAN, Some("feed_forward.acceleration")),
            (|l| l.feed_forward.coulomb = -0.1, Some("feed_forward.coulomb")),
            (|l| (l.feed_forward.coulomb, l.feed_forward.stiction) = (0.1, Some(0.09)), Some("feed_forward.stiction")),
            (|l| l.feed_forward.stiction = Some(0.1), Some("feed_forward.stribeck_velocity")),
            (|l| l.feed_forward.weight = Some(f64::NAN), Some("feed_forward.weight")),
            (
                |l| (l.output, l.feed_forward.weight) = (Output::Velocity, Some(1.0)),
                Some("feed_forward.weight, a torque for a drive that is sent velocities,"),
            ),
            (
                |l| {
                    l.feed_forward.stiction = Some(0.1);
                    l.feed_forward.stribeck_velocity = Some(5.0);
                    l.feed_forward.weight = Some(0.1);
                },
                None,
            ),
            (|l| l.feed_forward.constant = f64::INFINITY, Some("feed_forward.constant")),
            // The tables of loops by torque have limits above 1.
            (|l| l.law = Law::Incremental(IRP6[0]), Some("limit of its loop, a duty above 1,")),
            (|l| l.law = Law::Incremental(IncrementalConfig { a: 1.0, ..IRP6[0] }), Some("a of its loop")),
            (|l| l.law = Law::Cascade(CASCADE), None),
            (
                |l| l.law = Law::Proportional(PROPORTIONAL),
                Some("law of its loop, which leaves the velocity to a drive that has no loop for it,"),
            ),
            (
                |l| {
                    l.law = Law::Proportional(PROPORTIONAL);
                    l.output = Output::Velocity;
                },
                None,
            ),
            (
                |l| {
                    l.law = Law::Proportional(ProportionalConfig { position_gain: 0.0, ..PROPORTIONAL });
                },
                Some("position_gain of its loop"),
            ),
            (
                |l| {
                    l.law = Law::Cascade(CascadeConfig { position_gain: f64::NAN, ..CASCADE });
                },
                Some("position_gain of its loop"),
            ),
            (
                |l| {
                    l.law = Law::Cascade(CascadeConfig { integral_rate: -1.0, ..CASCADE });
                },
                Some("integral_rate of its loop"),
            ),
        ];
        for (number, (change, expected)) in cases.into_iter().enumerate() {
            let mut host = HOST;
            change(&mut host);
            let found = refused_limit(|axis| axis.position_loop = PositionLoop::Host(host));
            assert_eq!(found, expected, "case {number}");
        }
        let unscaled = refused_limit(|axis| axis.increments_per_radian = 0.0);
        assert_eq!(unscaled, Some("increments_per_radian"));
        let falling = refused_limit(|axis| axis.increments_per_radian = -636.6);
        assert_eq!(falling, None);
    }

    #[test]
    fn homing_by_the_host_is_refused_for_the_field_that_is_wrong() {
        type Case = (fn(&mut HostHoming), Option<&'static str>);
        let cases: [Case; 9] = [
            (|_| {}, None),
            (|h| h.search.velocity = 101.0, Some("homing.search.velocity")),
            (|h| h.search.distance = 0.0, Some("homing.search.distance")),
            (|h| h.search.timeout = Duration::ZERO, Some("homing.search.timeout")),
            (|h| h.zero.velocity = -3.0, Some("homing.zero.velocity")),
            (|h| h.zero.distance = f64::INFINITY, Some("homing.zero.distance")),
            (|h| h.zero.timeout = Duration::ZERO, Some("homing.zero.timeout")),
            (|h| h.acceleration = 1001.0, Some("homing.acceleration")),
            (|h| h.debounce = 0, Some("homing.debounce")),
        ];
        for (number, (change, expected)) in cases.into_iter().enumerate() {
            let mut homing = HOMING;
            change(&mut homing);
            let found = refused_limit(|axis| {
                axis.position_loop = PositionLoop::Host(HOST);
                axis.homing = Some(homing);
            });
            assert_eq!(found, expected, "case {number}");
        }
        assert_eq!(
            refused_limit(|axis| axis.homing = Some(HOMING)),
            Some("homing, where the drive closes the position loop,")
        );
    }
}
