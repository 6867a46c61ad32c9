//! Cycle laws: control laws that displace the set-points of an effector in each servo cycle.
//!
//! A law runs between interpolation and the limit checks of a macrostep that carries [`LawParameters`]. The law reads
//! the axis states of the cycle and its own sensors, and returns a displacement of each motor from the interpolated
//! path. The sum passes the same checks as any set-point. `servo` knows neither sensors nor the meaning of parameters.
//!
//! A law owns the reader of a latest value ([`drive::latest`]) for each of its sensors. The age of a sample follows
//! from [`LawInput::now`].

use can::Instant;
use thiserror::Error;

use crate::{Knot, MAX_AXES, ServoAxisConfig, Trail};

/// Number of parameters of a cycle law in a macrostep.
pub const LAW_PARAMETERS: usize = 40;

/// Parameters of a cycle law during one macrostep. Their meaning belongs to the law. All are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawParameters(pub [f64; LAW_PARAMETERS]);

impl Default for LawParameters {
    /// All parameters are zero.
    fn default() -> Self {
        Self([0.0; LAW_PARAMETERS])
    }
}

/// A control law that displaces the set-points of one effector in each cycle.
///
/// All functions run in the servo cycle. They do not allocate, lock, format or wait.
///
/// # Effect
/// The set-point of a motor is the interpolated position plus the displacement. The displacement persists from one
/// macrostep with a law to the next. When the motion ends, the effector stands at the sum, and the displacement is part
/// of the next plan's start. If the law still moves the effector at the end of a motion, the effector brakes to a stand
/// within its acceleration limits. A stop brakes from the last set-points sent, and ends the law.
///
/// A law may [keep](Self::keeps) the displacement at the end of a motion. The next motion can then continue the path
/// ([`Macrostep::continues_law`](crate::Macrostep::continues_law)). Any other motion, a stop, a fault and a
/// power-off give up the displacement: the path then begins where the effector stands.
///
/// A speed override or a pause slows the interpolated path. The law runs in each cycle, and slows its own motion by
/// [`LawInput::rate`]: a motion that a task has programmed must stop in a pause, and a motion that yields to a force must
/// not. In a cycle that repeats its set-points because a bus refused the last batch, the law does not run and the
/// displacement stays.
///
/// # Bounds
/// A displacement beyond its [`LawBound`] is a fault. The servo does not clamp: a limit per motor would change the
/// direction of the tool's motion, and the state of the law would differ from the set-points. A law that saturates
/// limits the motion of the tool as a whole, for example by one factor for all directions.
///
/// In each cycle under a law, a stop of the effector from the new set-points must end within the position limits.
/// Otherwise the effector stops from the last set-points. A stop that lasts longer because of a partner in a team may end
/// beyond a position limit, as without a law.
///
/// A panic of a law is caught: the effector brakes (category 1), and the law is not called again.
pub trait CycleLaw: Send {
    /// Checks the parameters of a macrostep before the macrostep begins. A fault refuses the macrostep.
    fn check(&self, parameters: &LawParameters) -> Result<(), LawFault>;

    /// Whether the displacement at the end of a motion stays for a next motion with the same parameters: for laws whose
    /// output depends on the displacement from the path, for example a spring.
    fn keeps(&self, parameters: &LawParameters) -> bool {
        let _ = parameters;
        false
    }

    /// Prepares the law for a motion. The servo calls this function in the cycle in which the first macrostep with a law
    /// begins, before [`shift`](Self::shift). The displacements are zero, or those that the law has kept.
    fn begin(&mut self, input: &LawInput<'_>, parameters: &LawParameters);

    /// Computes the displacements of this cycle, or ends the motion.
    fn shift(&mut self, input: &LawInput<'_>, parameters: &LawParameters) -> LawOutput;
}

/// Data of one cycle for a law.
#[derive(Clone, Copy, Debug)]
pub struct LawInput<'a> {
    /// Time of the cycle.
    pub now: Instant,
    /// Time from one set-point to the next, s.
    pub period: f64,
    /// Periods since the last cycle: 1 plus the number of missed deadlines.
    pub periods: u32,
    /// Rate of motion time: 1, or less by a [`SpeedOverride`](crate::SpeedOverride), and 0 in a pause. Changes within
    /// the acceleration limits of all axes of the cell.
    pub rate: f64,
    /// Number of the macrostep.
    pub macrostep: u64,
    /// The axes of the effector.
    pub axes: &'a [LawAxis],
    /// Set-points of the last cycles, without this cycle.
    pub trail: &'a Trail,
}

/// Data of one axis for a law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LawAxis {
    /// Set-point of the path in this cycle, at the present rate.
    pub planned: Knot,
    /// Displacement of the last cycle, rad.
    pub displacement: f64,
    /// Position in the last set-point sent, rad: planned position plus displacement.
    pub commanded: f64,
    /// Measured position, rad.
    pub position: f64,
    /// Measured velocity, rad/s.
    pub velocity: f64,
    /// Measured torque, N·m; zero where the drive does not report the torque.
    pub torque: f64,
    /// Time at which the drive took the sample.
    pub sampled: Instant,
    /// Cycles in a row without a new sample: 0 if the sample is of this cycle.
    pub age: u32,
}

/// Result of a law in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LawOutput {
    /// Displacement of each motor from the interpolated path, rad. Entries beyond the axes of the effector are ignored.
    Displacement([f64; MAX_AXES]),
    /// Ends the motion as intended: the effector brakes in this cycle and stands ([`StopCause::Touched`]).
    ///
    /// [`StopCause::Touched`]: crate::StopCause::Touched
    Touched,
    /// Ends the motion by a fault: the effector brakes in this cycle, and is then switched off.
    Fault(LawFault),
}

/// Fault that a cycle law reports.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum LawFault {
    /// The sensor of the law gives no samples. Both values are in seconds.
    #[error("no sample of its sensor for {age:.4} s, the limit is {limit:.4} s")]
    Silent { age: f64, limit: f64 },
    /// The sensor of the law is saturated in a channel.
    #[error("channel {channel} of its sensor is saturated")]
    Saturated { channel: u8 },
    /// A measured value or a result is not a finite number.
    #[error("a value is not a finite number")]
    NotFinite,
    /// A measured value is beyond a limit of the law, for example a dangerous force. The unit is that of the channel.
    #[error("channel {channel} of its sensor measures {value:.2}, the limit is {limit:.2}")]
    Exceeded { channel: u8, value: f64, limit: f64 },
    /// The force/torque sensor of the law has a fault.
    #[error("{0}")]
    Sensor(drive::wrench::WrenchFault),
    /// The sensor of the law was not zeroed since its bring-up, so that its offset would count as contact.
    #[error(
        "its sensor was not zeroed since it was switched on, or a zeroing is under way or has failed: zero the sensor without contact"
    )]
    NotZeroed,
    /// The sensor of the law was zeroed, and the weight of the tool at the zeroing is not noted yet.
    #[error(
        "its sensor was zeroed by request {request}, and the weight of the tool at that moment is unknown: read the sensor after a zeroing"
    )]
    NoWeight { request: u64 },
    /// The mechanism cannot make the motion of the law at its present position: a limit or a singularity.
    #[error("the robot cannot make the motion of the law here: a limit of an axis or a singularity is too near")]
    Unreachable,
    /// The law panicked. The panic hook received the message. The law refuses all later macrosteps.
    #[error("it panicked")]
    Panicked,
    /// A parameter of the macrostep is out of its range.
    #[error("parameter {index} is {value}, which its law does not accept")]
    Parameter { index: u8, value: f64 },
}

/// Bounds of the displacement of one motor by a law. Both are 0 for a motor that the law does not move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawBound {
    /// Greatest displacement from the interpolated path, rad.
    pub displacement: f64,
    /// Greatest speed of the displacement, rad/s, at most the greatest velocity of the axis.
    pub speed: f64,
}

/// Why a law is not installed. Indices count from zero.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum LawError {
    #[error("there is no effector {effector} for the law")]
    NoSuchEffector { effector: usize },
    /// A law without a bound for each axis.
    #[error("a law without limits: {given} bounds for {axes} axes; give displacement and speed of each motor")]
    Unbounded { given: usize, axes: usize },
    /// A bound that is negative, infinite, not a number, or beyond the limit of the axis.
    #[error("the bound of axis {axis} is {value} {unit}, it must be between 0 and {limit} {unit}")]
    Bound { axis: usize, value: f64, limit: f64, unit: &'static str },
    #[error("effector {effector} has a law already")]
    Installed { effector: usize },
    #[error("a law can only be installed before the first cycle")]
    Running,
}

impl LawBound {
    /// Checks the bounds of all axes: each is at most the travel and the greatest velocity of its axis.
    pub(crate) fn check<'a>(
        bounds: &[Self],
        axes: impl ExactSizeIterator<Item = &'a ServoAxisConfig>,
    ) -> Result<(), LawError> {
        if bounds.len() != axes.len() {
            return Err(LawError::Unbounded { given: bounds.len(), axes: axes.len() });
        }
        for (axis, (bound, config)) in bounds.iter().zip(axes).enumerate() {
            let travel = config.max_position - config.min_position;
            let sides = [(bound.displacement, travel, "rad"), (bound.speed, config.max_velocity, "rad/s")];
            for (value, limit, unit) in sides {
                if !(value.is_finite() && (0.0..=limit).contains(&value)) {
                    return Err(LawError::Bound { axis, value, limit, unit });
                }
            }
        }
        Ok(())
    }
}
