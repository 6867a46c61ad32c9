//! The library of robot programs: cell files, benches, runs and their results.
//!
//! A program is a *task*: an `async` function that uses the robots of a [cell file](cell::CellFile). A robot executes
//! [generators](controller::generator). A run executes the task on a [bench](bench::BenchKind):
//!
//! ```
//! use mrroc::prelude::*;
//!
//! async fn carry(cell: &mut Cell) -> Outcome {
//!     let mut irb6 = cell.robot("irb6")?;
//!     irb6.enable().await?;
//!     irb6.home().await?;
//!     irb6.disable().await
//! }
//!
//! let cell = CellFile::read("../cells/irb6.toml")?;
//! let report = mrroc::run(&cell, BenchKind::Lockstep, carry)?;
//! assert_eq!(report.outcome, RunOutcome::Completed);
//! # Ok::<(), mrroc::Error>(())
//! ```
//!
//! `program` is the `main` of such a program, with all options of `mrroc run`.
//!
//! Features, of which the first three are on by default:
//!
//! - `command-line`: `program`, options of the command line, signals, console of the operator;
//! - `pages`: page of a report (`RunOptions::out`), and charts;
//! - `recording`: MCAP recordings, flight recorder and replay;
//! - `schema`: JSON schema of cell files and scenario files.

pub mod bench;
pub mod budget;
pub mod cell;
#[cfg(feature = "pages")]
pub mod charts;
pub mod check;
mod demand;
#[cfg(feature = "command-line")]
mod extension;
mod frame_order;
pub mod guardian;
pub mod input;
mod inputs;
mod lag;
mod motions;
#[cfg(feature = "command-line")]
mod operator;
pub mod outputs;
#[cfg(feature = "command-line")]
mod program_main;
#[cfg(feature = "recording")]
pub mod recording;
pub mod rehearsal;
pub mod report;
pub mod robots;
mod row_file;
pub mod run;
pub mod scenario;
pub mod setup;
#[cfg(feature = "command-line")]
pub mod signals;
pub mod spikes;
pub mod streams;
pub mod tasks;
mod trace;
pub mod wire;

pub use check::{check, check_with_scene};
pub use controller::coordination::carry;
#[cfg(feature = "command-line")]
pub use extension::Extension;
pub use motions::{Motions, PoseSize};
#[cfg(feature = "command-line")]
pub use program_main::{ProgramOptions, program, run_program};
pub use tasks::Program;

use bench::BenchKind;
use cell::CellFile;
use report::RunReport;
use run::{Requests, RunOptions};
use tasks::{Cell, Outcome};

/// The reason why a cell or a program was refused, as text.
pub type Error = anyhow::Error;

/// Rehearses `task`, runs it on `bench` and returns the report. A fault of the run is no error: [`RunReport::outcome`] has
/// the outcome. Moves hardware on [`BenchKind::Card`].
///
/// This function catches no signal. If a signal ends the process, only the drives' own watchdogs stop the robots.
/// `program`, and [`run::run`] with [`Requests`], brake first.
pub fn run(
    cell: &CellFile,
    bench: BenchKind,
    task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static,
) -> Result<RunReport, Error> {
    run::run(cell, &RunOptions::on(bench), &Requests::default(), &Program::of(task), &mut |_| {})
}

/// All items that a robot program needs, for one `use`.
pub mod prelude {
    pub use std::process::ExitCode;
    pub use std::time::Duration;

    pub use can::Instant;
    pub use controller::coordination::{Coordinator, Late, LinkConfig, NextOrders, Orders};
    pub use controller::ecp::{Class, Task};
    pub use controller::executor::{LooseLink, Observer, Replacer, join, join_all};
    pub use controller::force::Wrench;
    pub use controller::generator::{
        A, Accelerations, Answer, AxesState, ConstantVelocity, Contour, EffectorImage, FeedLimits, Generator,
        GeneratorError, JerkLimited, Jog, LineLimits, MotionLimits, Newsmooth, Next, OperatorReaction, Pace,
        Polynomial, Pose, Received, Sample, Selected, Selection, SelectionMemory, SensorReading, Setpoint, SmoothPose,
        StraightLine, Tell, TimeOptimal, Transparent, UnderLaw, V, Wait, WeightedSum, WithImages,
    };
    pub use controller::law::{Compliance, Direction, ForceTask, Guard, TaskAxes};
    pub use controller::path::{BSpline, Curve, JointPath, Path, PoseState, SplineEnds};
    pub use controller::robot::Space;
    pub use controller::sensor::{
        Blob, BlobFinder, BlobPlace, BlobReading, BoxLocator, BoxPlace, BoxReading, DigitalInputs, EchoError,
        ForceError, ForceReading, ForceTorque, GateError, GateReading, JogCommand, JogHandle, JogPanel, JogReading,
        LightGates, Marked, Operator, Passage, Question, Reaction, Shell, SightError, ViewedPlane, VirtualSensor,
    };
    pub use controller::trajectory_file::JointConvention;
    pub use drive::cia401::InputImage;

    pub use crate::bench::BenchKind;
    pub use crate::cell::CellFile;
    pub use crate::motions::Motions;
    pub use crate::report::{AxisReport, Deviation, FaultReport, RobotReport, RunOutcome, RunReport};
    pub use crate::tasks::{
        Camera, Cell, ForceSensor, GateTrack, InputLine, Outcome, OutputLine, Robot, TaskError, Team, Ultrasonic,
    };
}

/// The Rust blocks of the book, which the documentation tests compile.
#[cfg(doctest)]
mod book {
    #[doc = include_str!("../../book/src/first-program.md")]
    mod first_program {}
    #[doc = include_str!("../../book/src/motions.md")]
    mod motions {}
    #[doc = include_str!("../../book/src/own-generator.md")]
    mod own_generator {}
    #[doc = include_str!("../../book/src/teach.md")]
    mod teach {}
}
