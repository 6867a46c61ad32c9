//! The library of robot programs: cell files, benches, runs and their results.
//!
//! A program reads a [cell file](cell::CellFile), gives each robot a [task](prelude::Task) made of
//! [generators](controller::generator), and runs the tasks on a [bench](bench::BenchKind):
//!
//! ```
//! use mrroc::prelude::*;
//!
//! let cell = CellFile::read("../cells/irb6.toml")?;
//! let tasks = |cell: &CellFile| Tasks::new(cell).give("irb6", Task::new().enable().home().disable());
//! let report = mrroc::run(&cell, BenchKind::Lockstep, &tasks)?;
//! assert_eq!(report.outcome, Outcome::Completed);
//! # Ok::<(), mrroc::Error>(())
//! ```
//!
//! [`program`] is the `main` of such a program, with all options of `mrroc run`.

pub mod bench;
pub mod budget;
pub mod cell;
pub mod charts;
pub mod check;
pub mod input;
mod motions;
pub mod outputs;
mod program_main;
pub mod rehearsal;
pub mod report;
pub mod robots;
pub mod run;
pub mod setup;
pub mod signals;
pub mod spikes;
pub mod streams;
mod tasks;
mod trace;
pub mod wire;

pub use check::check;
pub use motions::Motions;
pub use program_main::{ProgramOptions, program, run_program};
pub use tasks::{MakeTasks, Tasks};

use bench::BenchKind;
use cell::CellFile;
use report::RunReport;
use run::{Requests, RunOptions};

/// The reason why a cell or a program was refused, as text.
pub type Error = anyhow::Error;

/// Rehearses `tasks`, runs them on `bench` and returns the report. A fault of the run is no error:
/// [`RunReport::outcome`] has the outcome. Moves hardware on [`BenchKind::Card`].
///
/// This function catches no signal. If a signal ends the process, only the drives' own watchdogs stop the robots.
/// [`program`], and [`run::run`] with [`Requests`], brake first.
pub fn run(cell: &CellFile, bench: BenchKind, tasks: &MakeTasks) -> Result<RunReport, Error> {
    run::run(cell, &RunOptions::on(bench), &Requests::default(), tasks, &mut |_| {})
}

/// All items that a robot program needs, for one `use`.
pub mod prelude {
    pub use std::process::ExitCode;
    pub use std::time::Duration;

    pub use controller::ecp::Task;
    pub use controller::generator::{
        Accelerations, AxesState, Contour, EffectorImage, FeedLimits, Generator, GeneratorError, JerkLimited,
        LineLimits, MotionLimits, Newsmooth, Next, Pace, Polynomial, Pose, Setpoint, SmoothPose, StraightLine, Wait,
    };
    pub use controller::path::{BSpline, Curve, Path, SplineEnds};
    pub use controller::robot::Space;

    pub use crate::bench::BenchKind;
    pub use crate::cell::CellFile;
    pub use crate::motions::Motions;
    pub use crate::report::{AxisReport, Deviation, FaultReport, Outcome, RobotReport, RunReport};
    pub use crate::tasks::Tasks;
}
