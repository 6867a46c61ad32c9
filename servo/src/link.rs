//! Orders to an effector and reports from it.

use std::time::Duration;

use drive::{EmergencyStop, Fault};
use thiserror::Error;

use crate::{HomingFailure, Latest, LawFault, LawParameters, Oscillation, Snapshot, StopCategory};

/// Greatest number of axes of one effector.
pub const MAX_AXES: usize = 8;

/// One macrostep: motor positions, velocities and accelerations to reach in some servo periods.
///
/// From the end of the last macrostep, the servo interpolates each motor by the quintic that has the given position,
/// velocity and acceleration at both ends. The acceleration of a motion is therefore continuous. A motion that begins
/// from standing begins with zero acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Macrostep {
    /// Number of the macrostep, one more than the previous number. Reports refer to this number.
    pub number: u64,
    /// Duration in servo periods, at least 1.
    pub steps: u16,
    /// The period, 1 ..= `steps`, after which the servo reports the measured state.
    pub report_at: u16,
    /// Motor positions at its end, rad.
    pub position: [f64; MAX_AXES],
    /// Motor velocities at its end, rad/s. All zero means that the effector may rest there.
    pub velocity: [f64; MAX_AXES],
    /// Motor accelerations at its end, rad/s². With `None`, each motor gets the
    /// [acceleration of the cubic](crate::cubic_end_acceleration) with the same positions and velocities.
    pub acceleration: Option<[f64; MAX_AXES]>,
    /// Motor torques that hold the weight of links and load at its end, N·m; zero where none is known.
    ///
    /// Loops that the servo closes add the torques to their output by
    /// [`FeedForward::weight`](crate::FeedForward::weight). Drives that close the position loop do not receive them.
    /// The torques change linearly over the macrostep, and stay where a motion ends or is stopped.
    pub torque: [f64; MAX_AXES],
    /// Parameters of the [cycle law](crate::CycleLaw) that displaces the set-points of this macrostep. `None` for set-points
    /// without displacement.
    ///
    /// A macrostep with a law may follow one without. A macrostep without a law is refused directly after one with a law
    /// ([`StopCause::LawLeft`]), because the position would jump by the displacement. The motion has to end first.
    pub law: Option<LawParameters>,
    /// Whether this first macrostep of a motion continues the path of the previous motion, from which the law has
    /// displaced the effector. The path then begins at the set-point less [`Snapshot::displacement`], and the
    /// displacement persists.
    ///
    /// The law must have [kept](crate::CycleLaw::keeps) the displacement, and `law` must be the law of the previous
    /// motion. Otherwise the macrostep is refused ([`StopCause::Malformed`]).
    pub continues_law: bool,
}

/// An order of the controller to one effector.
#[expect(clippy::large_enum_variant, reason = "nearly all that a queue holds are macrosteps, and a box would allocate")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Switch the drives on and stand.
    Enable,
    /// Home the axes in the configured order. Axes that kept their reference are skipped.
    Home,
    /// Execute a macrostep, queued behind those sent before.
    Move(Macrostep),
    /// Barrier: stand until every member has an equal order at the front of its queue. All members then pass in the
    /// same cycle, and the orders behind begin in this cycle. A stop drops a barrier that still waits.
    ///
    /// Bit *i* of `members` is the effector of index *i*. The effector that receives the order is a member.
    Meet {
        /// Bit set of effectors.
        members: u32,
    },
    /// Barrier like [`Order::Meet`], after which the members are a *team*.
    ///
    /// Members begin each macrostep in the same cycle. A member begins its next macrostep only in a cycle in which
    /// every member can begin one of equal length. While the team stands, all wait for a member without a macrostep. In
    /// motion, a member without a macrostep starves, which stops the team.
    ///
    /// Each order or fault that stops one member stops all members in the same cycle. All motors of the team then brake
    /// in proportion and come to rest together. A stop dissolves the team. The partners end standing with power on and
    /// [`StopCause::Partner`].
    Tie {
        /// Bit set of effectors.
        members: u32,
    },
    /// Leave the team, while the team stands or at the end of a macrostep. The last member is then no longer tied.
    Untie,
    /// Brake to a stand within the acceleration limits, drop the queued motion and keep the power on (category 2). The
    /// order overtakes the queue. A moving effector whose queue runs empty brakes in the same way, but as a fault.
    ///
    /// The order also acknowledges [`StopCause::Partner`], [`StopCause::Touched`] and [`StopCause::BrakeSlips`].
    Stop,
    /// Brake like [`Order::Stop`], then switch the drives off (category 1). The order overtakes the queue, and
    /// acknowledges the same causes.
    Disable,
    /// Clear latched faults; the drives stay off.
    ResetFault,
}

/// Phase of an effector, as reported to the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Drives off.
    #[default]
    Off,
    /// The drives are being switched on.
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

impl Phase {
    /// All phases.
    pub const ALL: [Self; 7] =
        [Self::Off, Self::Enabling, Self::Homing, Self::Standing, Self::Moving, Self::Stopping, Self::Faulted];
}

/// Report from the servo to the controller. The servo reports every change of phase, every order except a macrostep,
/// and `report_at` of a macrostep. An effector sends at most one report per cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ServoReport {
    /// State of the effector in the cycle of the report.
    pub snapshot: Snapshot,
    /// Whether `report_at` periods of the macrostep are executed, or the effector does not move by macrosteps.
    pub reached: bool,
    /// The fault that stopped the effector, if any. [`StopCause::Partner`], [`StopCause::Touched`] and
    /// [`StopCause::BrakeSlips`] hold until the next stop or disable order, any other fault until its reset.
    pub fault: Option<ServoFault>,
    /// A reset of the fault is under way. The next report with [`Phase::Faulted`] and without a reset reports its failure.
    pub resetting: bool,
}

/// Fault by which the servo stopped an effector.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{}{cause}", axis.map_or_else(String::new, |axis| format!("axis {axis}: ")))]
pub struct ServoFault {
    /// Index of the axis within its effector; `None` if no single axis is concerned.
    pub axis: Option<u8>,
    /// Cause of the stop.
    pub cause: StopCause,
    /// Category of the stop, the strictest one if the stop was escalated.
    pub category: StopCategory,
}

impl ServoFault {
    /// A fault that stops with the [category](StopCause::category) of its cause.
    pub fn new(axis: Option<u8>, cause: StopCause) -> Self {
        Self { axis, cause, category: cause.category() }
    }
}

/// Cause of a stop. Positions are motor positions, rad.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum StopCause {
    /// A fault of the drive.
    #[error("{0}")]
    Drive(Fault),
    /// The following error, commanded minus measured position, exceeds the limit of the cell.
    #[error("following error {error:.4} rad exceeds {limit:.4} rad")]
    FollowingError { error: f64, limit: f64 },
    /// The axis is blocked or overloaded: its torque is at its limit, and the axis does not follow. The measured
    /// position does not change ([`Frozen`](Self::Frozen)) if `stands`, or the [following error](Self::FollowingError)
    /// exceeds its limit. `behind` is the distance by which the motor lacks. The torque of a motor whose encoder fails
    /// rises in the same way.
    #[error(
        "blocked or overloaded: torque {:.0} % of {limit:.2} N·m, {behind:.3} rad behind",
        100.0 * (.torque / .limit).abs()
    )]
    Blocked { torque: f64, limit: f64, behind: f64, stands: bool },
    /// The encoder fails, or the axis is blocked. The measured position does not change by one increment. Meanwhile the
    /// set-points move by half the permitted following error, or no brake could have stopped the motor so abruptly. The
    /// power of this axis is removed at once, and the other axes brake.
    #[error("measured position stands still, {travel:.4} rad expected")]
    Frozen { travel: f64 },
    /// The motor is faster than its position loop, closed by the servo, could make it: beyond `runaway_velocity`.
    #[error("motor runs away at {velocity:.1} rad/s, beyond {limit:.1} rad/s")]
    Runaway { velocity: f64, limit: f64 },
    /// The motor oscillates about its set-points, and the amplitude grows beyond half of the permitted following error. The
    /// loop, closed by the servo, is unstable and cannot brake.
    #[error("unstable loop swings up: {:.1} Hz, {:.4} rad", .0.frequency, .0.amplitude)]
    Oscillates(Oscillation),
    /// The motor is too fast in a stop: from this velocity, the greatest acceleration of the motor cannot brake it within
    /// the [envelope](crate::ServoState) of the stop. In a stop of homing, the motor still has more than half of its speed
    /// after the longest stop.
    #[error("motor does not brake: {velocity:.1} rad/s, the stop permits {limit:.1} rad/s")]
    NotBraking { velocity: f64, limit: f64 },
    /// The command leads towards a closed limit switch, or the switch holds the axis back. The upper switch is at the
    /// upper end of the counter's travel.
    #[error("ran onto the {} limit switch", if *.upper { "upper" } else { "lower" })]
    LimitSwitch { upper: bool },
    /// A set-point beyond a position limit. The set-point was not sent.
    #[error("set-point of the motor, {position:.4} rad, is beyond its limit {limit:.4} rad")]
    PositionLimit { position: f64, limit: f64 },
    /// A set-point so fast and so near to a position limit that a stop from it would end at `rest`, beyond the limit. The
    /// set-point was not sent.
    #[error("set-point leaves no room to stop: the motor would rest at {rest:.4} rad, beyond its limit {limit:.4} rad")]
    NoRoomToStop { rest: f64, limit: f64 },
    /// A set-point that needs more speed than permitted. The set-point was not sent.
    #[error("set-point needs a motor velocity of {velocity:.3} rad/s, the limit is {limit:.3} rad/s")]
    VelocityLimit { velocity: f64, limit: f64 },
    /// A set-point that needs more acceleration than permitted. The set-point was not sent.
    #[error("set-point needs a motor acceleration of {acceleration:.2} rad/s², the limit is {limit:.2} rad/s²")]
    AccelerationLimit { acceleration: f64, limit: f64 },
    /// A set-point that is NaN or infinite. The set-point was not sent.
    #[error("set-point is not a finite number")]
    NotFinite,
    /// A macrostep without steps, with `report_at` beyond its steps, or with `continues_law` although the law has kept
    /// no displacement. The macrostep was not begun.
    #[error("macrostep {number} has no steps, its report lies outside it, or it continues another law")]
    Malformed { number: u64 },
    /// The next macrosteps of a team have unequal lengths. No macrostep was begun.
    #[error("macrostep {number} has {steps} periods, that of a partner {other}")]
    UnequalSteps { number: u64, steps: u16, other: u16 },
    /// The number of a macrostep is not the next one of its team. The macrostep was not begun.
    #[error("macrostep {number} came to a team that begins number {expected}")]
    OutOfSequence { number: u64, expected: u64 },
    /// A barrier whose bit set does not contain this effector, or contains an effector that does not exist.
    #[error("barrier of effectors {members:#b}, which are not this effector and others of the cell")]
    NotAMember { members: u32 },
    /// A partner in the team stopped. This effector braked with the partner and stands, its drives on.
    ///
    /// The effector refuses motion until an [`Order::Stop`] or [`Order::Disable`] acknowledges the cause. Macrosteps
    /// that were sent before the controller heard of the stop are therefore never executed.
    #[error("effector {effector} of its team stopped")]
    Partner { effector: u8 },
    /// The cycle law ended the motion as intended, for example at a touch. The effector braked from this cycle on and
    /// stands, its drives on.
    ///
    /// As after [`StopCause::Partner`], the effector refuses motion until an [`Order::Stop`] or [`Order::Disable`]
    /// acknowledges the cause.
    #[error("its cycle law ended the motion")]
    Touched,
    /// A motor moved after an orderly power-off: its brake does not hold. The motors got their power again and hold the
    /// effector, which refuses motion until an [`Order::Stop`] or [`Order::Disable`] acknowledges the cause.
    #[error("brake does not hold: slipped by {travel:.4} rad, and the motor holds again")]
    BrakeSlips { travel: f64 },
    /// The cycle law reported a fault.
    #[error("cycle law: {0}")]
    Law(LawFault),
    /// A displacement by the cycle law is beyond its bound. The set-point was not sent.
    #[error("cycle law displaces by {displacement:.4} rad, the bound is {limit:.4} rad")]
    LawDisplacement { displacement: f64, limit: f64 },
    /// A displacement by the cycle law changes faster than its bound. The set-point was not sent.
    #[error("cycle law displaces at {velocity:.3} rad/s, the bound is {limit:.3} rad/s")]
    LawSpeed { velocity: f64, limit: f64 },
    /// A macrostep without a cycle law came directly after one with a law. The macrostep was not begun.
    #[error("macrostep {number} has no cycle law, and the one before has; end the motion before the law ends")]
    LawLeft { number: u64 },
    /// A macrostep requires a cycle law, and the effector has none. The macrostep was not begun.
    #[error("macrostep {number} requires a cycle law, and none is installed")]
    NoLaw { number: u64 },
    /// A macrostep for an axis without a reference. The macrostep was not begun.
    #[error("asked to move before it was homed")]
    NotHomed,
    /// The drive did not follow in time.
    #[error("not ready within {waited:?}")]
    NotReady { waited: Duration },
    /// The macrostep queue ran empty while the effector moved.
    #[error("no macrostep in time after number {last}")]
    Starved { last: u64 },
    /// Homing by the drive failed, or homing took too long.
    #[error("homing failed")]
    HomingFailed,
    /// Homing by the servo did not find the reference.
    #[error("homing: {0}")]
    NoReference(HomingFailure),
    /// An input of the emergency stop is open, or not known. All effectors stop, and stay off while the cause persists.
    #[error("{contact}")]
    EmergencyStop { group: u8, contact: EmergencyStop },
    /// More deadlines in a row were missed than the cell permits.
    #[error("{}", missed_in_row(*.missed))]
    Overrun { missed: u32 },
    /// More than a quarter of the deadlines were missed, among the last 1000 or 16 times the number that the cell permits in
    /// a row.
    #[error("{missed} of {deadlines} cycles missed their deadlines")]
    Overloaded { missed: u32, deadlines: u32 },
}

/// Text for deadlines that were missed in a row.
fn missed_in_row(count: u32) -> String {
    match count {
        1 => "1 cycle missed its deadline".to_owned(),
        _ => format!("{count} cycles in a row missed their deadline"),
    }
}

impl StopCause {
    /// Category of the stop. [`FollowingError`](Self::FollowingError), [`Blocked`](Self::Blocked) by the following
    /// error and [`NotBraking`](Self::NotBraking) of a loop that the servo closes have category 0 instead, because such
    /// a loop cannot brake. `NotBraking` in a stop of homing has category 0 too. A stop that [leaves its
    /// envelope](crate::ServoState) becomes stricter.
    ///
    /// A fault of an axis controller that opens the emergency-stop circuit of its cabinet has category 0: the drives open
    /// their power stages by themselves.
    pub fn category(&self) -> StopCategory {
        match self {
            Self::Drive(Fault::AxisController { fault, .. }) if fault.opens_cabinet() => StopCategory::Zero,
            Self::Partner { .. } | Self::Touched | Self::BrakeSlips { .. } => StopCategory::Two,
            Self::Runaway { .. } | Self::Oscillates(_) => StopCategory::Zero,
            Self::Drive(_)
            | Self::FollowingError { .. }
            | Self::NotBraking { .. }
            | Self::Frozen { .. }
            | Self::Blocked { .. }
            | Self::LimitSwitch { .. }
            | Self::PositionLimit { .. }
            | Self::NoRoomToStop { .. }
            | Self::VelocityLimit { .. }
            | Self::AccelerationLimit { .. }
            | Self::NotFinite
            | Self::Malformed { .. }
            | Self::UnequalSteps { .. }
            | Self::OutOfSequence { .. }
            | Self::NotAMember { .. }
            | Self::Law(_)
            | Self::LawDisplacement { .. }
            | Self::LawSpeed { .. }
            | Self::LawLeft { .. }
            | Self::NoLaw { .. }
            | Self::NotHomed
            | Self::NotReady { .. }
            | Self::Starved { .. }
            | Self::HomingFailed
            | Self::NoReference(_)
            | Self::EmergencyStop { .. }
            | Self::Overrun { .. }
            | Self::Overloaded { .. } => StopCategory::One,
        }
    }

    /// Whether the stop leaves the effector standing with power on, and motion is refused until a stop or disable order
    /// acknowledges the cause.
    pub fn needs_acknowledgement(&self) -> bool {
        matches!(self, Self::Partner { .. } | Self::Touched | Self::BrakeSlips { .. })
    }
}

/// The controller's end of the link to one effector: orders to the servo, reports from it and its latest state. Both
/// queues are wait-free and bounded.
#[derive(Debug)]
pub struct EffectorLink {
    /// Orders to the servo. A full queue means that the controller is ahead; send again later.
    pub orders: rtrb::Producer<Order>,
    /// Reports from the servo. The servo drops and counts reports that do not fit.
    pub reports: rtrb::Consumer<ServoReport>,
    /// State of the effector in the last cycle.
    pub latest: Latest,
}
