//! The fixed-period cycle: `Servo::step(now)` = read → check → regulate → limit → write.
//!
//! A cell has one [`Servo`], which steps all effectors at the same deadlines. Only [`thread`] waits for deadlines.
//! [`lockstep`] runs the same functions in virtual time. The controller commands an effector over an [`EffectorLink`],
//! one macrostep at a time.
//!
//! Either the drives or the servo ([`HostLoop`]) close the position loops. The servo can also home the axes whose
//! loops the servo closes ([`HostHoming`]).
//!
//! [`identify`] measures a loop: its frequency response, crossover and phase margin.
//!
//! Read [`Servo`] for the cycle, [`state`](ServoState) for the states and orders of an effector, and [`thread`] for
//! deadlines and the effect of a missed one. This crate works in motor positions only; joints, Cartesian poses and
//! planning are outside.

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
mod journal;
mod latest;
mod law;
mod limit;
mod link;
pub mod lockstep;
mod motion_time;
mod oscillation;
mod overload;
mod progress;
mod recorder;
mod reference_watch;
pub mod regulator;
mod remedies;
#[cfg(test)]
#[path = "../tests/scripted/mod.rs"]
mod scripted;
mod search;
mod servo;
mod state;
mod statistics;
mod team;
pub mod thread;
mod timing;
mod trail;

pub use ::drive::Switches;
pub use brake::{Braking, StraightStop};
pub use config::{
    Direction, EffectorConfig, FeedForward, Figure, FrozenWatch, HomingLeg, HostHoming, HostLoop, KeyError, KeyProblem,
    Law, LoopBounds, LoopPlant, MAX_EFFECTORS, Output, PositionLoop, Range, ServoAxisConfig, ServoConfig, ServoError,
};
pub use excitation::{Excitation, ExcitationError, most as greatest_excitation};
pub use histogram::Histogram;
pub use interpolate::{Knot, cubic_end_acceleration, quintic};
pub use journal::{JournalEntry, JournalEvent, JournalReader};
pub use latest::{Latest, Publisher, Snapshot, latest};
pub use law::{CycleLaw, LAW_PARAMETERS, LawAxis, LawBound, LawError, LawFault, LawInput, LawOutput, LawParameters};
pub use link::{EffectorLink, MAX_AXES, Macrostep, Order, Phase, ServoFault, ServoReport, StopCause};
pub use motion_time::{OverrideError, SpeedOverride};
pub use oscillation::Oscillation;
pub use recorder::{AxisRecord, Record};
pub use search::HomingFailure;
pub use servo::{NotUp, Servo, StopRequest};
pub use state::{After, Answer, CellState, ServoEvent, ServoState, StopCategory, TeamState};
pub use statistics::{Counters, TrackingError};
pub use timing::Timing;
pub use trail::Trail;
