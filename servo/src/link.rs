//! Orders to an effector and reports from it.

use std::fmt;

use std::time::Duration;

use can::Instant;
use thiserror::Error;

use crate::HomingFailure;

/// The most axes one effector can have.
pub const MAX_AXES: usize = 8;

/// One macrostep: where the motors are to be some servo periods from now.
///
/// Between the end of the last macrostep and this one the servo interpolates each motor by the cubic
/// that meets position and velocity at both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Macrostep {
    /// Number of the macrostep, one more than the number before: replies are told apart by it.
    pub number: u64,
    /// Servo periods it lasts, at least 1.
    pub steps: u16,
    /// The period, 1 ..= `steps`, after which the servo reports the measured state back.
    pub report_at: u16,
    /// Motor positions at its end, rad.
    pub position: [f64; MAX_AXES],
    /// Motor velocities at its end, rad/s; all zero means the effector may rest there.
    pub velocity: [f64; MAX_AXES],
    /// Motor torques that hold the weight of links and load at its end, N·m; zero where none is known.
    ///
    /// Loops that the servo closes add the torques to their output by [`FeedForward::weight`](crate::FeedForward::weight).
    /// Drives that close the position loop do not receive them. The torques change linearly over the macrostep, and stay
    /// where a motion ends or is stopped.
    pub torque: [f64; MAX_AXES],
}

/// What the controller asks of one effector.
#[expect(
    clippy::large_enum_variant,
    reason = "nearly all that a queue holds are macrosteps, and a box would allocate"
)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Switch the drives on and stand.
    Enable,
    /// Home the axes in the configured order; those that kept their reference are skipped.
    Home,
    /// Move. Queued behind the macrosteps sent before.
    Move(Macrostep),
    /// Stand until this gate of [`Gates`](crate::Gates) is open; what was sent behind it waits too, but for a stop.
    Gate(u8),
    /// Brake to a stand within the acceleration limits, drop what was queued before, keep power on
    /// (category 2). It overtakes the queue. A moving effector whose queue runs dry brakes likewise, and that is a fault.
    Stop,
    /// Brake as [`Order::Stop`] does, then switch the drives off (category 1). It overtakes the queue.
    Disable,
    /// Clear latched faults; the drives stay off.
    ResetFault,
}

/// What an effector is doing, as its servo sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Drives off.
    #[default]
    Off,
    /// Drives on their way to on and following.
    Enabling,
    /// Homing.
    Homing,
    /// On and still.
    Standing,
    /// Following macrosteps.
    Moving,
    /// Braking.
    Stopping,
    /// Stopped by a fault, latched until [`Order::ResetFault`].
    Faulted,
}

/// What the servo tells the controller: at every change of phase, in answer to every order but a
/// macrostep, and at `report_at` of a macrostep. One a cycle at most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// The cycle's time.
    pub at: Instant,
    /// What the effector does.
    pub phase: Phase,
    /// Whether every axis is homed.
    pub homed: bool,
    /// The number of the macrostep this is the report of, or of the last one begun; 0 before any.
    pub macrostep: u64,
    /// Motor positions commanded in this cycle, rad.
    pub commanded: [f64; MAX_AXES],
    /// Motor positions measured, rad: the answer to what was commanded two cycles before.
    pub measured: [f64; MAX_AXES],
    /// Motor velocities measured, rad/s.
    pub velocity: [f64; MAX_AXES],
    /// The fault that stopped it, if one did.
    pub fault: Option<ServoFault>,
}

/// Why the servo stopped an effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoFault {
    /// Index of the axis within its effector; `None` if it is not of one.
    pub axis: Option<u8>,
    /// What happened.
    pub cause: StopCause,
}

impl std::error::Error for ServoFault {}

impl fmt::Display for ServoFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(axis) = self.axis {
            write!(f, "axis {axis}: ")?;
        }
        self.cause.fmt(f)
    }
}

/// What a servo stops for. Positions in motor rad.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum StopCause {
    /// The drive.
    #[error("{0}")]
    Drive(drive::Fault),
    /// The motor is further from where it was told to be than the cell allows.
    #[error("following error {error:.4} rad exceeds {limit:.4} rad")]
    FollowingError {
        /// Commanded minus measured.
        error: f64,
        /// The cell's limit.
        limit: f64,
    },
    /// The motor is faster than its loop, which is closed here, could ever make it.
    #[error("motor runs away at {velocity:.1} rad/s, beyond {limit:.1} rad/s")]
    Runaway {
        /// Measured.
        velocity: f64,
        /// The cell's limit.
        limit: f64,
    },
    /// The axis was told to go on towards a limit switch that is closed, or is held back by it.
    #[error("ran onto the {} limit switch", if *.upper { "upper" } else { "lower" })]
    LimitSwitch {
        /// At the upper end of the counter's travel, not at its lower.
        upper: bool,
    },
    /// A set-point beyond a position limit; it was not sent.
    #[error("set-point {position:.4} rad is beyond the limit {limit:.4} rad")]
    PositionLimit {
        /// The set-point.
        position: f64,
        /// The limit it passes.
        limit: f64,
    },
    /// A set-point that needs more speed than allowed; it was not sent.
    #[error("set-point needs {velocity:.3} rad/s, the limit is {limit:.3} rad/s")]
    VelocityLimit {
        /// Needed.
        velocity: f64,
        /// Allowed.
        limit: f64,
    },
    /// A set-point that needs more acceleration than allowed; it was not sent.
    #[error("set-point needs {acceleration:.2} rad/s², the limit is {limit:.2} rad/s²")]
    AccelerationLimit {
        /// Needed.
        acceleration: f64,
        /// Allowed.
        limit: f64,
    },
    /// A set-point that is NaN or infinite; it was not sent.
    #[error("set-point is not a finite number")]
    NotFinite,
    /// A macrostep of no steps, or one whose report lies outside it; it was not begun.
    #[error("macrostep {number} has no steps or its report lies outside it")]
    Malformed {
        /// Its number.
        number: u64,
    },
    /// A macrostep for an axis whose position means nothing yet; it was not begun.
    #[error("asked to move before it was homed")]
    NotHomed,
    /// The drive was not on and following, or still had a fault after a reset, in time.
    #[error("not ready within {waited:?}")]
    NotReady {
        /// Time waited.
        waited: Duration,
    },
    /// The macrostep queue ran dry while the effector moved.
    #[error("no macrostep in time after number {last}")]
    Starved {
        /// The last macrostep that was executed.
        last: u64,
    },
    /// Homing by the drive failed, or homing took too long.
    #[error("homing failed")]
    HomingFailed,
    /// Homing by the servo did not find the reference.
    #[error("homing: {0}")]
    NoReference(HomingFailure),
    /// More cycles in a row missed their deadline than the cell allows.
    #[error("{missed} cycles in a row missed their deadline")]
    Overrun {
        /// Cycles missed.
        missed: u32,
    },
}

/// The controller's end of one effector: orders out, reports in, both wait-free and bounded.
#[derive(Debug)]
pub struct EffectorLink {
    /// Orders to the servo. Full means the servo is ahead; offer again later.
    pub orders: rtrb::Producer<Order>,
    /// Reports from the servo. The servo drops and counts what does not fit.
    pub reports: rtrb::Consumer<Report>,
}
