//! The whole `mrroc` command as a function, for the program of this project and for programs with tasks of their own:
//!
//! ```no_run
//! use mrroc::prelude::*;
//!
//! async fn wave(cell: &mut Cell) -> Outcome {
//!     cell.robot("irb6")?.perform(Task::new().enable().home().disable()).await
//! }
//!
//! fn main() -> ExitCode {
//!     mrroc_console::main(&mrroc::Extension::new().task("wave", wave))
//! }
//! ```
//!
//! This program has every command, and `run CELL --task wave` and `check CELL --task wave` beside the built-in tasks.
//!
//! Exit status: 0 done; 1 stopped by a fault or on request, a file of a run is incomplete, a node did not obey a command,
//! or the reader closed standard output before the end of the answer; 2 refused before any motion, or no answer.

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod emulate;
mod faults;
mod manual;
mod usage;
mod vm;

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::builder::PossibleValuesParser;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use mrroc::cell::{Cell, CellFile};
use mrroc::check::CheckReport;
use mrroc::outputs::Measured;
use mrroc::recording::{self, ReplayOptions};
use mrroc::scenario::Scenario;
use mrroc::{Extension, signals, streams, tasks::TaskOptions};
use serde::Serialize;

/// Exit status in the help text: scripts may rely on it.
const EXIT_STATUS: &str = "Exit status: 0 done; 1 stopped by a fault or by a signal such as Ctrl-C, a file of a run is incomplete, a node \
was told and did not do it, or the reader of the output closed it before the answer; 2 refused before anything moved, aborted by the node, no answer, or no bus.";

/// A multi-robot research-oriented controller with its hardware in the loop.
#[derive(Parser)]
#[command(name = "mrroc", version, after_help = EXIT_STATUS)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Check a cell file, every pose of a task, and the load of its buses.
    Check {
        /// The cell file.
        cell: PathBuf,
        #[command(flatten)]
        task: TaskOptions,
        /// Rehearse the task with the emulated scene of the cell too: with contact, sensors and the torques of the emulated
        /// drives. This takes as long as a run with --bench lockstep.
        #[arg(long)]
        rehearse_with_scene: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Check whether this host can run the cell, and propose corrections. Changes nothing without --fix.
    Doctor(host::doctor::Options),
    /// Bring a cell up, run a task on its robots and report. Moves hardware on the card bench.
    Run {
        /// The cell file.
        cell: PathBuf,
        #[command(flatten)]
        task: TaskOptions,
        #[command(flatten)]
        options: mrroc::ProgramOptions,
    },
    /// Stop the controller of a cell that runs on this computer in another process: its robots brake, and their drives go
    /// off.
    Stop(service::stop::Options),
    /// Wait for a run with `--guardian SOCKET`, and become its guardian. A service manager starts this process, so that
    /// whatever ends the controller's service leaves the guardian. The process ends after the run.
    Guard {
        /// The Unix socket to wait at.
        socket: PathBuf,
    },
    /// Replay a recording of `run --record FILE.mcap` through the drivers and the servo of this version, and compare all
    /// outputs bit for bit. Opens no device. A recording that was cut replays up to its last whole chunk, and a damaged
    /// recording up to its first damaged chunk. Exit status 0 if the recording is whole and all outputs are equal, 1 if an
    /// output differs, 2 if the recording was cut, is damaged or cannot be replayed.
    Replay {
        /// The recording.
        file: PathBuf,
        /// The cell file to use in place of the recorded one, for example with another limit.
        #[arg(long)]
        cell: Option<PathBuf>,
        /// Print every value that differs in the first differing cycle.
        #[arg(long)]
        diff: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Play faults of wires, drives and motors on each robot in each phase, in lockstep, and print how they end. Exit
    /// status 1 if a row is red: a fault is not found, or a robot moves beyond its bound.
    Faults {
        /// The cell file.
        cell: PathBuf,
        #[command(flatten)]
        options: ::faults::FaultOptions,
        #[command(flatten)]
        replacement: mrroc::outputs::Replacement,
    },
    /// Emulate the axis controllers of a cell: on a CAN interface, behind an slcan adapter, or on serial lines.
    Emulate(emulate::Options),
    /// List the nodes of a bus: by SDO requests to every node-ID, by LSS requests, and by heartbeats. Do not use while
    /// another master is active.
    Scan(service::scan::Options),
    /// Read or write one object of a node. Do not use while another master uses the SDO server of the node, which
    /// serves one client at a time. A running cell uses the server at its start and at a fault.
    Sdo {
        #[command(subcommand)]
        action: service::sdo::Action,
    },
    /// Device configuration files (DCF, CiA 306) of drives: save the values of a drive, compare a drive with a file, and
    /// leave out what no drive may be given.
    Dcf {
        #[command(subcommand)]
        action: service::dcf::Action,
    },
    /// Send an NMT command to one node or to all. Resets and stops switch the power of drives off, and an arm without
    /// brakes falls. Every command except start ends a running cell in a fault.
    Nmt(service::nmt::Options),
    /// Assign node-IDs to nodes by layer setting services (LSS). This disturbs a running cell.
    Lss {
        #[command(subcommand)]
        action: service::lss::Action,
    },
    /// Show the frames of a bus as text until Ctrl-C. Sends nothing without --map. An slcan adapter is opened in
    /// listen-only mode.
    Monitor(service::monitor::Options),
    /// Print the electronic data sheet (EDS, CiA 306) of the emulated drive of an axis.
    Eds {
        /// The cell file.
        cell: PathBuf,
        /// The axis: ROBOT.AXIS, the axis's name, or its node-ID.
        axis: String,
    },
    /// Measure the loop of one axis: frequency response, crossover and phase margin. Homes the robot on the emulated
    /// benches. Moves hardware on the card bench, where motion must be allowed explicitly.
    Identify(identify::Options),
    /// Measure the punctuality of a thread that waits as the servo thread does, compared with cyclictest in the same
    /// run.
    Jitter(host::jitter::Options),
    /// Compute forward kinematics, inverse kinematics, Jacobian and limits of a robot.
    Kinematics {
        #[command(subcommand)]
        question: descriptions::kinematics::Question,
    },
    /// Print the data sheet of a robot, of the gripper or of the conveyor: geometry, drives, limits, and the source of
    /// each number. The format is Markdown; the figure is SVG.
    Datasheet(descriptions::datasheet::Options),
    /// Write a cell file for a robot that is described in URDF. Numbers that the description does not have are nominal, and
    /// the file says so.
    New(descriptions::new::Options),
    /// Print the description of a robot (URDF) for viewers and libraries of rigid bodies.
    Urdf(descriptions::kinematics::Which),
    /// Run a command in a virtual machine with CAN.
    Vm {
        #[command(subcommand)]
        machine: vm::Machine,
    },
    /// Print the JSON schema of cell files, or their reference.
    Schema {
        /// Print the reference in Markdown.
        #[arg(long)]
        reference: bool,
        /// Print the schema of scenario files.
        #[arg(long, conflicts_with = "reference")]
        scenario: bool,
    },
    /// Write the manual pages and the completions for bash, zsh and fish into a directory.
    #[command(hide = true)]
    Manual {
        /// The directory.
        directory: PathBuf,
        #[command(flatten)]
        replacement: mrroc::outputs::Replacement,
    },
}

/// The `main` of the command, with what a program adds to it: reads the arguments of the process, obeys them, and prints.
///
/// Stability: arguments that an extension does not name keep their meaning within a major version.
pub fn main(extension: &Extension) -> ExitCode {
    let command = command(extension);
    let arguments = command.try_get_matches().and_then(|matches| Arguments::from_arg_matches(&matches));
    let arguments = match arguments {
        Ok(arguments) => arguments,
        Err(error) => return usage::answer(&error),
    };
    let blocked = signals::block_signals_of_writes();
    // A run handles the loss of its report itself, and an emulation has no answer.
    let answers = !matches!(arguments.command, Command::Run { .. } | Command::Emulate(_));
    let result = blocked.and_then(|()| answer(arguments.command, extension));
    let result = result.map(|status| if answers { streams::exit_status(status) } else { status });
    result.unwrap_or_else(|refusal| {
        if refusal.is::<service::Interrupted>() {
            return ExitCode::from(1);
        }
        streams::refuse(&refusal);
        ExitCode::from(2)
    })
}

/// The definition of the command line, with the names of all tasks.
fn command(extension: &Extension) -> clap::Command {
    let names = || PossibleValuesParser::new(extension.tasks());
    let mut command = Arguments::command();
    for with_task in ["check", "run"] {
        command = command.mut_subcommand(with_task, |it| it.mut_arg("task", |task| task.value_parser(names())));
    }
    command
}

fn answer(command: Command, extension: &Extension) -> anyhow::Result<ExitCode> {
    match command {
        Command::Check { cell, task, rehearse_with_scene, json } => {
            let checked = if rehearse_with_scene { mrroc::check_with_scene } else { mrroc::check };
            check(&checked(&CellFile::read(&cell)?, &task.program(extension)?)?, json)
        }
        Command::Doctor(options) => host::doctor::doctor(&options),
        Command::Run { cell, task, options } => {
            let program = task.program(extension)?;
            CellFile::read(&cell).and_then(|file| mrroc::run_program(&file, &options, &program))
        }
        Command::Stop(options) => service::stop::stop(&options),
        Command::Guard { socket } => mrroc::guardian::separate::guard(&socket).map(|never| match never {}),
        Command::Replay { file, cell, diff, json } => replay(&file, cell, diff, json),
        Command::Faults { cell, options, replacement } => faults::faults(&cell, &options, replacement),
        Command::Emulate(options) => emulate::emulate(&options),
        Command::Scan(options) => {
            service::scan::scan(&options).and_then(|scanned| streams::answer(&scanned, options.json))
        }
        Command::Sdo { action } => service::sdo::sdo(&action),
        Command::Dcf { action } => service::dcf::dcf(&action),
        Command::Nmt(options) => service::nmt::nmt(&options),
        Command::Lss { action } => service::lss::lss(&action),
        Command::Monitor(options) => service::monitor::monitor(&options),
        Command::Eds { cell, axis } => descriptions::eds::eds(&cell, &axis).and_then(streams::print),
        Command::Identify(options) => identify::identify(&options).map(|measured| measurement(measured, options.json)),
        Command::Jitter(options) => jitter(&options),
        Command::Kinematics { question } => {
            descriptions::kinematics::kinematics(&question).and_then(|answer| streams::answer(&answer, question.json()))
        }
        Command::Datasheet(options) => descriptions::datasheet::datasheet(&options).and_then(streams::print),
        Command::New(options) => descriptions::new::new(&options).and_then(streams::print),
        Command::Urdf(which) => descriptions::urdf::urdf(&which).and_then(streams::print),
        Command::Vm { machine } => vm::vm(&machine),
        Command::Schema { scenario: true, .. } => scenario_schema(),
        Command::Schema { reference, .. } => schema(reference),
        Command::Manual { directory, replacement } => manual::write(self::command(extension), &directory, replacement),
    }
}

fn check(checked: &CheckReport, json: bool) -> anyhow::Result<ExitCode> {
    for problem in &checked.problems {
        streams::warn(format_args!(
            "mrroc: {problem}; only for robots that are wired otherwise than the emulated ones"
        ));
    }
    for warning in &checked.warnings {
        streams::warn(format_args!("mrroc: {warning}"));
    }
    streams::answer(checked, json)
}

/// Replays a recording. Exit status 1 if an output differs, and 2 if the recording was cut or is damaged.
fn replay(file: &Path, cell: Option<PathBuf>, diff: bool, json: bool) -> anyhow::Result<ExitCode> {
    let replayed = recording::replay(file, &ReplayOptions { cell })?;
    streams::answer(&replayed, json)?;
    if diff && !json {
        for difference in &replayed.differences {
            streams::say(difference)?;
        }
    }
    Ok(ExitCode::from(match (replayed.is_equal(), replayed.is_whole()) {
        (false, _) => 1,
        (true, false) => 2,
        (true, true) => 0,
    }))
}

/// Measures the jitter behind a progress bar, and prints the report.
fn jitter(options: &host::jitter::Options) -> anyhow::Result<ExitCode> {
    let bar = ProgressBar::new(0).with_style(ProgressStyle::with_template("turn {pos}/{len}, {msg}")?);
    let measured = host::jitter::jitter(options, &|progress| {
        bar.set_length(progress.turns.into());
        bar.set_position(progress.turn.into());
        bar.set_message(progress.results);
    });
    bar.finish_and_clear();
    Ok(measurement(measured?, options.json))
}

/// Prints what a measurement gave, then writes its files.
fn measurement<R: Serialize + Display>(measured: Measured<R>, json: bool) -> ExitCode {
    let Measured { report, complete, failure, write } = measured;
    let told = report.and_then(|report| streams::answer(&report, json).err());
    let failures: Vec<_> = failure.into_iter().chain(told).chain(write().err()).collect();
    for failure in &failures {
        streams::warn(format_args!("mrroc: {failure:#}"));
    }
    ExitCode::from(u8::from(!complete || !failures.is_empty()))
}

fn scenario_schema() -> anyhow::Result<ExitCode> {
    streams::print(serde_json::to_string_pretty(&Scenario::schema())? + "\n")
}

fn schema(reference: bool) -> anyhow::Result<ExitCode> {
    streams::print(match reference {
        true => descriptions::cell_reference::reference(),
        false => serde_json::to_string_pretty(&Cell::schema())? + "\n",
    })
}
