//! The fixed-period cycle: `Servo::step(now)` = read → check → regulate → limit → write.
//!
//! A cell has one [`Servo`], which steps every effector on one tick grid; [`thread`] is the shell
//! that waits for deadlines, and nothing else here waits; [`lockstep`] turns the same functions in
//! virtual time. The controller talks to an effector over an [`EffectorLink`], a macrostep at a time.
//!
//! Drives close the position loop, or the servo does ([`HostLoop`]) and then can home the axis too
//! ([`HostHoming`]).
//!
//! [`identify`] measures a loop: its frequency response, crossover and phase margin.
//!
//! Read [`Servo`] for the cycle, [`state`](State) for what an effector can do when, and [`thread`]
//! for deadlines and what happens when they are missed. Joints, Cartesian poses and planning are
//! not here: everything is in motor positions.

#![cfg_attr(mrroc_rtsan, feature(sanitize))]

mod axis;
mod brake;
mod config;
mod effector;
mod excitation;
mod histogram;
mod host_loop;
pub mod identify;
mod interpolate;
mod limit;
mod link;
pub mod lockstep;
mod recorder;
pub mod regulator;
#[cfg(test)]
#[path = "../tests/scripted/mod.rs"]
mod scripted;
mod search;
mod servo;
mod state;
mod statistics;
pub mod thread;
mod timing;

pub use brake::StraightStop;
pub use config::{
    Direction, EffectorConfig, FeedForward, Figure, HomingLeg, HostHoming, HostLoop, Law,
    LoopBounds, Output, PositionLoop, Range, Reason, Refusal, ServoAxisConfig, ServoConfig,
    ServoError,
};
pub use excitation::{Excitation, ExcitationError, most as greatest_excitation};
pub use histogram::Histogram;
pub use interpolate::{Knot, hermite};
pub use limit::{AxisLimits, check};
pub use link::{EffectorLink, MAX_AXES, Macrostep, Order, Phase, Report, ServoFault, StopCause};
pub use recorder::{AxisRecord, Record};
pub use search::HomingFailure;
pub use servo::{Gates, NotUp, Servo, StopRequest};
pub use state::{After, Answer, Event, State};
pub use statistics::{Counters, TrackingError};
pub use timing::Timing;
