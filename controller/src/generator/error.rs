//! Errors of generators.

use std::f64::consts::TAU;
use std::time::Duration;

use thiserror::Error;

use super::TimingError;
use crate::path::PathError;
use crate::robot::{Arm, Axes, KinematicsError};
use crate::sensor::{EchoError, ForceError, GateError, SightError};

/// Reasons why a generator refuses a motion or gives it up.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum GeneratorError {
    #[error("no poses")]
    NoPoses,
    /// The number of axes is zero or above [`servo::MAX_AXES`].
    #[error("{axes} axes, supported are 1 to {max}")]
    Axes { axes: usize, max: usize },
    #[error("pose {pose}, axis {axis}: not a finite number")]
    NotFinite { pose: usize, axis: u8 },
    /// A coordinate of a tool pose: position x, y, z or quaternion qx, qy, qz, qw.
    #[error("{coordinate} of the target: not a finite number")]
    TargetNotFinite { coordinate: &'static str },
    /// A limit is not positive and finite.
    #[error("axis {axis}: limit is not positive")]
    Limit { axis: u8 },
    /// A speed or acceleration of a path is not positive and finite.
    #[error("path limit is not positive")]
    PathLimit,
    #[error("pose {pose}, axis {axis}: fraction {value} is not in (0, 1]")]
    Fraction { pose: usize, axis: u8, value: f64 },
    #[error("macrostep has no length")]
    NoMacrostep,
    /// A [`Pace`](super::Pace) without periods or with too many, or one that reads images outside its periods.
    #[error("a macrostep has 1 to 1000 periods, of which one reads images: not {periods} periods and period {read_at}")]
    Pace { periods: u16, read_at: u16 },
    #[error("motion takes more than {limit} macrosteps")]
    TooLong { limit: u32 },
    #[error("takes {needed:.3} s at the least, not {given:.3} s")]
    TooShort { needed: f64, given: f64 },
    /// A velocity at the end of a motion through intermediate poses.
    #[error("a motion through intermediate poses ends at rest")]
    PassesPoses,
    #[error("axis {axis}: velocity {value:.3} at the end is above the limit {limit:.3}")]
    EndVelocity { axis: u8, value: f64, limit: f64 },
    #[error("axis {axis}: velocity {value:.3} is above the limit {limit:.3}")]
    Velocity { axis: u8, value: f64, limit: f64 },
    #[error(
        "a distance of {distance} at a velocity of {velocity}: the distance must not be negative, nor the velocity zero"
    )]
    Distance { distance: f64, velocity: f64 },
    /// A motion along a joint path begins where the effector stands.
    #[error("axis {axis} stands {distance:.6} from the start of the path: move it there first")]
    NotAtJointStart { axis: u8, distance: f64 },
    #[error("no profile within the limits: one is too small for the distance, or the motion takes more than 7600 s")]
    NoProfile,
    /// The arm cannot take a pose of the path, at parameter `s` from 0 at the start to 1 at the end. The pose was found
    /// before the motion began.
    #[error("at {s:.4} of the path: {cause}")]
    Path { s: f64, cause: KinematicsError },
    /// The arm would have to jump between two neighbouring poses of a path. The field `by` is in rad or m.
    ///
    /// `singular`: whether the posture before the jump or after it is beside a singular one.
    #[error("at {s:.4} of the path: axis {axis} jumps by {by:.3} to the next pose: {}", remedy(*singular))]
    Jump { s: f64, axis: u8, by: f64, singular: bool },
    /// A joint would have to turn back by whole turns between two neighbouring poses of a path, because the nearest turn is
    /// beyond its range. The field `by` is in rad.
    #[error(
        "at {s:.4} of the path: axis {axis} would turn back by {by:.3} rad, because the nearer turn is beyond the range of the \
         joint or of its motor: begin the path in another turn of the axis, or divide the path"
    )]
    Turn { s: f64, axis: u8, by: f64 },
    /// A [`Contour`](super::Contour) begins where the tool stands.
    #[error("tool stands {distance:.6} m and {angle:.6} rad from the start of the path: move the tool there first")]
    NotAtStart { distance: f64, angle: f64 },
    /// The way-points define no joint path.
    #[error("joint path: {0}")]
    JointPath(PathError),
    /// A joint path cannot be timed within the limits.
    #[error("joint path: {0}")]
    Timing(TimingError),
    /// The effector measures positions that its mechanism cannot take.
    #[error("effector image: {0}")]
    Image(KinematicsError),
    /// A generator that declares `V` runs on an agent without the sensor.
    #[error("the agent has no sensor with readings of type {reading}: install one with `Robot::sense`")]
    NoSensor { reading: &'static str },
    /// A generator that declares `a0` runs without a coordinator.
    #[error("no coordinator gives orders of type {order}: execute the generator in a team or on a link")]
    NoOrders { order: &'static str },
    #[error("no sensor of the agent takes commands of type {command}")]
    NotTold { command: &'static str },
    #[error("no coordinator takes answers of type {answer}, or its queue is full")]
    NotAnswered { answer: &'static str },
    #[error("nothing received since the instruction began")]
    NothingReceived,
    #[error("the last sample is {age:.1?} old, more than {limit:.1?}")]
    Stale { age: Duration, limit: Duration },
    #[error("the order, axis {axis}: not a finite number")]
    OrderNotFinite { axis: u8 },
    /// A step of [`Transparent`](super::Transparent) received the last order again: its link does not wait for orders, or
    /// holds the last order ([`Late::Hold`](crate::coordination::Late::Hold)).
    #[error("no new order: link the team so that each step waits for its order and a late order stops")]
    NoNewOrder,
    /// The newly selected generator of a [`Selection`](super::Selection) does not continue the motion. The velocity needed
    /// in the next macrostep and the commanded velocity are in rad/s or m/s.
    #[error("axis {axis}: the selected generator needs a velocity of {needed:.3} at once, after {commanded:.3}")]
    Switch { axis: u8, needed: f64, commanded: f64 },
    #[error("weight {weight} is not in [0, 1]")]
    Weight { weight: f64 },
    #[error("a weighted sum takes set-points of one space from both generators, of joints or of motors")]
    NotAdded,
    /// A part of a combination has a force law that the combination cannot carry.
    #[error("one part of a combination of generators is under a force law: put the whole combination under the law")]
    LawOfPart,
    #[error("one generator of a weighted sum ended in motion before the other generator ended")]
    EndedInMotion,
    /// A panic in a step. The panic hook received its message.
    #[error("the step panicked")]
    Panicked,
    /// A motion in a team keeps the macrostep of the cell, but this generator chooses another macrostep.
    #[error(
        "a member of a team keeps the cell's macrostep of {cell} periods and its reading: the generator chooses {periods}"
    )]
    PaceInTeam { cell: u16, periods: u16 },
    /// The first step of a member of a team has a set-point. Members command from the first next step on, each macrostep
    /// for the same step of the coordinator.
    #[error("the first step of a member of a team commands nothing: command in the next step")]
    CommandsAtFirst,
    /// A coordinator has no effector of its own.
    #[error("a coordinator has no effector")]
    NoEffector,
    /// The sensor whose reading the step needs has none.
    #[error("force sensor: {0}")]
    Force(ForceError),
    /// The light gates whose reading the step needs have no velocity and place of an object.
    #[error("light gates: {0}")]
    Gates(GateError),
    /// The ultrasonic matrix whose reading the step needs has no place of a box.
    #[error("ultrasonic matrix: {0}")]
    Echo(EchoError),
    /// The camera whose reading the step needs has no place of an object.
    #[error("camera: {0}")]
    Sight(SightError),
    /// Reason of a user's generator, with a number defined by that generator.
    #[error("generator error {0}")]
    User(u16),
}

/// A jump that differs from whole turns by at most this angle counts as a turn back, rad.
const TURN: f64 = 0.5;

/// Margin from a singular posture below which a jump is attributed to the singular posture. The margin is not zero,
/// because the poses of a path are steps apart.
const BESIDE: f64 = 0.03;

impl GeneratorError {
    /// A jump of a joint between the postures `from` and `to` of two neighbouring poses of a path.
    pub(super) fn jump(s: f64, axis: usize, arm: &Arm, (from, to): (&Axes, &Axes)) -> Self {
        let by = (to[axis] - from[axis]).abs();
        let axis = axis as u8;
        let turns = (by / TAU).round();
        if turns >= 1.0 && (by - turns * TAU).abs() < TURN {
            return Self::Turn { s, axis, by };
        }
        let margin = |joints: &Axes| arm.robot().singularity(&arm.given(joints)).map(|it| it.margin);
        let singular = [from, to].into_iter().flat_map(margin).any(|margin| margin < BESIDE);
        Self::Jump { s, axis, by, singular }
    }
}

/// Remedy for a jump.
fn remedy(singular: bool) -> &'static str {
    if singular {
        "a posture beside a singular posture, which does not determine the axis: give positions and orientations with \
         twelve digits, begin the path beside the singular posture, or move the joints"
    } else {
        "begin the path in another posture, or move the joints"
    }
}
