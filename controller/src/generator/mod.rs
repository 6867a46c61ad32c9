//! Motion generators, which compute the set-point of an effector macrostep by macrostep.
//!
//! A subcontroller `Cj` of one effector (robot) reads *images*: of its effector `e`, of its virtual sensors `V` and of
//! the coordinator's order `a0`. Its own memory is `c`. In each step `i`, a generator computes from one snapshot of
//! these images (Zieliński, RoManSy 2002, equations 5 to 8)
//!
//! ```text
//! (5) e(i+1)   = fe (c, e, V, a0)      the effector's next state
//! (6) V(i+1)   = fv (c, e, V, a0)      the command to the sensors
//! (7) aj0(i+1) = fa (c, e, V, a0)      the answer to the coordinator
//! (8) c(i+1)   = fc (c, e, V, a0)      its own memory
//! ```
//!
//! and, before these functions, the *terminal condition* `fT(c, e, V, a0)`. The trait [`Generator`] has these functions.
//! [`Execution`] executes the flow chart of the paper's figure 3: first the first step, then terminal condition and next
//! step on every new snapshot.
//!
//! # What a generator may read
//! A generator declares the images of its [first step](Generator::First) (sporadic feedback) and of [every next
//! step](Generator::Every) (continuous feedback) as types. It receives no other image. The class is *q* = `e` + 2 `V` +
//! 4 `a0`, where an image counts 1 if it is read: the paper's eight classes, numbered by this project. If the next steps
//! read only the generator's own memory, macrosteps are computed ahead of the servo. A delay of the controller thread
//! then does not stop the motion.
//!
//! [`Images`] is a sealed trait: a program cannot define a set of images. The images are [`EffectorImage`] for `e`,
//! [`V`] for the readings of virtual sensors, and [`A`] for the order of a coordinator. [`Outputs`] are independent of the
//! images: a generator of any class may send a command to a sensor ([`Tell`]) and [answer](Answer) the coordinator.
//!
//! A step that names an undeclared image does not compile (`controller/tests/refused`).
//! `examples/own_generator.rs` and `examples/feedback.rs` are generators with their programs.
//!
//! # Generators of the library
//! Positions are in rad, or m for a linear joint, and times in s. The class is that of the next steps. A planned
//! generator has class 0: only its first step reads the effector (sporadic feedback). Before a generator that does not
//! begin in motion, the effector is braked.
//!
//! | generator | motion | set-points | class | begins in motion | ends in motion |
//! |---|---|---|---|---|---|
//! | [`Wait`] | hold or sleep for a time | none | 0 | no | no |
//! | [`Newsmooth`] | synchronised trapezoids through poses | joints or motors | 0 | no | no |
//! | [`Polynomial`] | cubic or quintic to a pose | joints or motors | 0 | no | no |
//! | [`JerkLimited`] | jerk-limited, to or through poses | joints or motors | 0 | to one pose | to one pose |
//! | [`TimeOptimal`] | the fastest along a spline or a B-spline | joints or motors | 0 | no | no |
//! | [`ConstantVelocity`] | at a constant velocity for a time or a distance | joints | 0 | yes | on request |
//! | [`StraightLine`] | straight line of the tool | joints | 0 | no | no |
//! | [`Contour`] | line, arc, polyline with blends or B-spline of the tool | tool | 0 | no | no |
//! | [`Jog`] | at the velocities of an operator | joints | 3 | no | no |
//! | [`OperatorReaction`] | holds until the operator answers | | 2 | no | no |
//! | [`Transparent`] | as a coordinator orders in every step | of the orders | 5 | no | no |
//! | [`Selection`] | motion of one of two generators, selected in every step | of the parts | of the parts and `e` | if both do | if one does |
//! | [`WeightedSum`] | weighted sum of two generators | joints or motors | of the parts | if both do | if both end in the same step |
//! | [`UnderLaw`] | motion of a generator, displaced by a cycle law | of the part | of the part | as the part | as the part |
//! | [`WithImages`] | motion of a generator, with more images declared | of the part | as declared | as the part | as the part |
//!
//! [`Ecp::image`](crate::ecp::Ecp::image) reads the position of an effector without a generator. An effector with its
//! drives on holds its position between two motions.
//!
//! Read [`Generator`] first, then [`Wait`] as the smallest generator and [`Newsmooth`] as a planned generator.

mod bounds;
mod cells;
mod constant_velocity;
mod contour;
mod demands;
pub(crate) mod digest;
mod error;
mod execution;
mod feed;
mod guide;
mod image;
mod images;
mod jerk_limited;
mod jog;
mod line;
mod newsmooth;
mod operator;
mod outputs;
mod pacing;
mod path_timing;
mod peaks;
mod plan;
mod polynomial;
mod profile;
mod progress;
mod selection;
mod slowed;
mod survey;
mod sweep;
#[cfg(test)]
mod tests;
mod through;
mod time_optimal;
mod transparent;
mod under_law;
mod wait;
mod weighted_sum;
mod with_images;

use std::fmt::Debug;
use std::time::Duration;

use servo::{LawParameters, MAX_AXES};

pub use crate::robot::{Axes, Pose};
pub use constant_velocity::ConstantVelocity;
pub use contour::Contour;
pub use error::GeneratorError;
pub(crate) use execution::{Chart, Functions, Run};
pub use execution::{Description, EffectorCommand, Execution, Step};
pub use feed::{Feed, FeedLimits, FeedState};
pub use image::{Accelerations, AxesState, EffectorImage, EffectorState, Setpoint};
pub use images::{A, Bundle, Images, Message, Partners, Readings, Received, Sample, SensorReading, V};
pub use jerk_limited::JerkLimited;
pub use jog::Jog;
pub use line::{LineLimits, LineMemory, PlannedStart, StraightLine};
pub use newsmooth::{Newsmooth, Progress, SmoothPose};
pub use operator::OperatorReaction;
pub use outputs::{Answer, Commands, Outputs, Tell};
pub use path_timing::{EndSpeeds, PathTiming, TimingError};
pub use polynomial::Polynomial;
pub use selection::{Selected, Selection, SelectionMemory};
pub use slowed::{JointLimit, SlowedPart};
pub use time_optimal::TimeOptimal;
pub use transparent::Transparent;
pub use under_law::UnderLaw;
pub use wait::Wait;
pub use weighted_sum::{SumMemory, WeightedSum};
pub use with_images::{Includes, WithImages};

/// Limits of each axis for the planning of a generator. Entries beyond the robot's axes are ignored.
///
/// The servo joins set-points by quintics, and checks its own limits on the quintics. In the macrostep in which full
/// acceleration turns into full braking, a quintic through samples of a trapezoid needs up to 5/3 of the trapezoid's
/// acceleration. The quintic may also exceed the cruise speed by 1/18 of the trapezoid's acceleration times the
/// macrostep. The servo's limits must leave room for both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// Velocity, rad/s, or m/s for a linear axis.
    pub max_velocity: Axes,
    /// Acceleration, rad/s², or m/s² for a linear axis.
    pub max_acceleration: Axes,
    /// Jerk, rad/s³, or m/s³ for a linear axis. [`JerkLimited`], [`Polynomial`] and [`ConstantVelocity`] use this limit.
    pub max_jerk: Axes,
}

impl MotionLimits {
    /// The same limits for every axis.
    pub const fn uniform(max_velocity: f64, max_acceleration: f64, max_jerk: f64) -> Self {
        Self {
            max_velocity: [max_velocity; MAX_AXES],
            max_acceleration: [max_acceleration; MAX_AXES],
            max_jerk: [max_jerk; MAX_AXES],
        }
    }

    /// Refuses an impossible number of axes, and limits that are not positive and finite for one of these axes.
    fn check(&self, axes: usize) -> Result<(), GeneratorError> {
        if axes == 0 || axes > MAX_AXES {
            return Err(GeneratorError::Axes { axes, max: MAX_AXES });
        }
        for axis in 0..axes {
            let limits = [self.max_velocity, self.max_acceleration, self.max_jerk];
            if !limits.iter().all(|limits| is_limit(limits[axis])) {
                return Err(GeneratorError::Limit { axis: axis as u8 });
            }
        }
        Ok(())
    }
}

/// Whether a limit is positive and finite.
fn is_limit(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// The functions (5) to (8) and the terminal condition of one motion instruction.
///
/// Next steps take `&self`, the old memory and one snapshot, and return a [`Next`], which the runner commits as a
/// whole. The first step stores its plan in `self`. Next steps must not allocate or block: with continuous feedback, each
/// result is due in the periods between the read of the images and the end of the macrostep.
///
/// A generator is [`Sync`], so it cannot contain a [`Cell`](std::cell::Cell), and its memory is [`Copy`]. Atomics and
/// locks compile, but a next step must not change them: such a change is not committed with the outputs.
pub trait Generator: Send + Sync + 'static {
    /// Images the first step reads: sporadic feedback.
    type First: Images;
    /// Images that the terminal condition and every next step read: continuous feedback.
    type Every: Images;
    /// Outputs beside the set-point: (6) a command to a sensor, (7) an answer to the coordinator.
    type Out: Outputs;
    /// Type of the generator's own memory, `c`. The digest in a file of steps is computed from its `Debug` text.
    type Memory: Copy + Debug + Send + 'static;

    /// The macrostep of this motion; `cell` is the macrostep of the cell. Called once, before the first step.
    fn pace(&self, cell: Pace) -> Pace {
        cell
    }

    /// Number of macrosteps of the cell that may be sent ahead of the servo; `most` is the greatest number. A generator
    /// with shorter macrosteps sends more of them, for the same time ahead. With a smaller number, a replacement acts
    /// sooner, but only a shorter delay of the controller is bridged. Without effect if the next steps read images.
    fn macrosteps_ahead(&self, most: u16) -> u16 {
        most
    }

    /// Whether the first step can plan from a moving effector. If true, and if the generator before ends in motion, this
    /// generator continues at that velocity. If false, a moving effector is braked before the first step.
    fn begins_in_motion(&self) -> bool {
        false
    }

    /// Parameters of the effector's cycle law that all macrosteps carry, if they are known before the first step. The
    /// law may have kept its displacement from the previous motion under the same parameters. The commanded state of
    /// the first step is then the end of the previous path, without this displacement.
    fn law(&self) -> Option<LawParameters> {
        None
    }

    /// Plans the motion and returns the first outputs and memory. The effector stands, unless the generator
    /// [begins in motion](Self::begins_in_motion). The macrostep is not zero. Only this function may take longer than a
    /// macrostep. If the effector moves, the result is due before the last macrostep sent ends.
    fn first_step(
        &mut self,
        images: &Self::First,
        macrostep: Duration,
    ) -> Result<Next<Self::Memory, Self::Out>, GeneratorError>;

    /// The part of the motion that joints slow, after the first step. The report of a run names this part.
    fn slowed(&self) -> Option<SlowedPart> {
        None
    }

    /// `fT`: whether the instruction ends. Evaluated on each new snapshot before [`next_step`](Self::next_step).
    fn terminal(&self, memory: &Self::Memory, images: &Self::Every) -> bool;

    /// (5) to (8): the outputs and the memory of the next step.
    fn next_step(
        &self,
        memory: &Self::Memory,
        images: &Self::Every,
    ) -> Result<Next<Self::Memory, Self::Out>, GeneratorError>;

    /// This generator with the same parameters of the effector's cycle law in all macrosteps.
    fn under(self, law: impl Into<LawParameters>) -> UnderLaw<Self>
    where
        Self: Sized,
    {
        UnderLaw::new(self, law)
    }
}

/// Length of a macrostep and time of its images, in servo periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// Number of periods, 1 ..= [`Pace::MOST_PERIODS`].
    pub periods: u16,
    /// The period, 1 ..= `periods`, after which the images for the next step are read. A generator with continuous
    /// feedback must compute the next step in the remaining periods. If `read_at` equals `periods`, the next step must
    /// reach the servo before the next cycle of the servo.
    pub read_at: u16,
}

impl Pace {
    /// Greatest number of periods.
    pub const MOST_PERIODS: u16 = 1000;

    /// One period: each set-point of the generator is a set-point of the servo.
    pub const PERIOD: Self = Self { periods: 1, read_at: 1 };

    /// The shorter of two macrosteps.
    #[must_use]
    pub const fn shorter(self, other: Self) -> Self {
        if other.periods < self.periods { other } else { self }
    }
}

/// Result of one step: all outputs and the memory, committed together.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Next<M, O = ()> {
    /// (5) The effector's state at the end of the next macrostep. With `None`, a first step sends no macrostep, and a
    /// next step lets the effector stand for one macrostep.
    pub effector: Option<Setpoint>,
    /// Parameters of the effector's cycle law during this macrostep; `None` without a law. Once a macrostep of a motion
    /// has parameters, all later ones of this motion must have them.
    pub law: Option<LawParameters>,
    /// (6) and (7) The other outputs.
    pub out: O,
    /// (8) The memory of the next step.
    pub memory: M,
}

impl<M> Next<M> {
    /// A result with a command to the effector.
    pub const fn command(effector: Setpoint, memory: M) -> Self {
        Self { effector: Some(effector), law: None, out: (), memory }
    }

    /// A result without a command to the effector.
    pub const fn remember(memory: M) -> Self {
        Self { effector: None, law: None, out: (), memory }
    }

    /// The same result with these outputs.
    pub fn with<O: Outputs>(self, out: O) -> Next<M, O> {
        Next { effector: self.effector, law: self.law, out, memory: self.memory }
    }
}

impl<M, O> Next<M, O> {
    /// The same result with the cycle law of the effector, for example with a [`ForceTask`](crate::law::ForceTask).
    ///
    /// In each servo period, the law adds a displacement to the interpolated path. In a macrostep without a set-point,
    /// the path stands still and the law continues. In a first step without a set-point, the law has no effect.
    #[must_use]
    pub fn under(self, law: impl Into<LawParameters>) -> Self {
        Self { law: Some(law.into()), ..self }
    }
}
