//! The `mrroc` command: the only room that opens ports, spawns threads and prints.
//!
//! Exit status: 0 done; 1 stopped by a fault or on request, or a node was told and did not do it; 2 refused before
//! anything moved, or no answer.

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod emulate;
mod manual;
mod usage;
mod vm;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use mrroc::Tasks;
use mrroc::cell::Cell;
use mrroc::cell_file::CellFile;
use mrroc::streams;

/// What scripts may build upon.
const EXIT_STATUS: &str = "Exit status: 0 done; 1 stopped by a fault or by a signal such as Ctrl-C, or a node was told and did not do \
it; 2 refused before anything moved, aborted by the node, no answer, or no bus.";

/// A multi-robot research-oriented controller with its hardware in the loop.
#[derive(Parser)]
#[command(name = "mrroc", version, after_help = EXIT_STATUS)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Check a cell file, every pose of its programs, and the load of its buses.
    Check {
        /// The cell file.
        cell: PathBuf,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Examine this host: can it run the cell, and what has to change where it cannot? Changes nothing.
    Doctor(host::doctor::Options),
    /// Bring a cell up, home it, run its programs and report. Moves hardware on the card bench.
    Run {
        /// The cell file.
        cell: PathBuf,
        #[command(flatten)]
        options: mrroc::ProgramOptions,
    },
    /// Stand in for the axis controllers of a cell on a CAN interface, behind an slcan adapter, on serial lines.
    Emulate(emulate::Options),
    /// Who is on a bus: asks every node-ID by SDO, whoever has none by LSS, and listens to heartbeats. Not while another
    /// master is at work.
    Scan(service::scan::Options),
    /// Read or write one object of a node. Not while another master uses the node's SDO server, which serves one at a
    /// time: a running cell does at its start and at a fault.
    Sdo {
        #[command(subcommand)]
        action: service::sdo::Action,
    },
    /// Tell a node, or all, to change its NMT state. Resets and stops take the power from drives; a brakeless arm falls.
    /// Every command but start ends a running cell in a fault.
    Nmt(service::nmt::Options),
    /// Give node-IDs to nodes that have none, by layer setting services. A running cell is disturbed by it.
    Lss {
        #[command(subcommand)]
        action: service::lss::Action,
    },
    /// Show the frames of a bus in words until Ctrl-C. Sends nothing, unless --map asks; an slcan adapter only listens.
    Monitor(service::monitor::Options),
    /// Print the electronic data sheet (EDS of CiA 306) of the drive emulated for an axis.
    Eds {
        /// The cell file.
        cell: PathBuf,
        /// The axis: ROBOT/AXIS, the axis's name, or its node-ID.
        axis: String,
    },
    /// Measure the loop of one axis: frequency response, crossover and phase margin. Homes the robot on the emulated
    /// benches; moves hardware on the card bench, where it has to be told so.
    Identify(identify::Options),
    /// Measure how punctual a thread that waits as the servo's does is on this host, beside cyclictest in the same run.
    Jitter(host::jitter::Options),
    /// Where a robot's flange is for given joints, which joints put it there, and how they move it.
    Kinematics {
        #[command(subcommand)]
        question: descriptions::kinematics::Question,
    },
    /// Print the data sheet of a robot, of the gripper or of the conveyor in Markdown, or its figure in SVG: geometry,
    /// drives, limits, and where the numbers come from.
    Datasheet(descriptions::datasheet::Options),
    /// Print a robot's description (URDF) for viewers and libraries of rigid bodies.
    Urdf(descriptions::urdf::Options),
    /// Run a command in a virtual machine that has CAN.
    Vm {
        #[command(subcommand)]
        machine: vm::Machine,
    },
    /// Print the JSON schema of cell files, or their reference.
    Schema {
        /// Print the reference in Markdown.
        #[arg(long)]
        reference: bool,
    },
    /// Write the manual pages and the completions of bash, zsh and fish into a directory.
    #[command(hide = true)]
    Manual {
        /// The directory.
        directory: PathBuf,
        #[command(flatten)]
        replacement: mrroc::outputs::Replacement,
    },
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return usage::answer(&error),
    };
    let result = match arguments.command {
        Command::Check { cell, json } => check(&cell, json),
        Command::Doctor(options) => host::doctor::doctor(&options),
        Command::Run { cell, options } => CellFile::read(&cell)
            .and_then(|file| mrroc::run_program(&file, &options, &Tasks::programs)),
        Command::Emulate(options) => emulate::emulate(&options),
        Command::Scan(options) => service::scan::scan(&options),
        Command::Sdo { action } => service::sdo::sdo(&action),
        Command::Nmt(options) => service::nmt::nmt(&options),
        Command::Lss { action } => service::lss::lss(&action),
        Command::Monitor(options) => service::monitor::monitor(&options),
        Command::Eds { cell, axis } => descriptions::eds::eds(&cell, &axis),
        Command::Identify(options) => identify::identify(&options),
        Command::Jitter(options) => host::jitter::jitter(&options),
        Command::Kinematics { question } => descriptions::kinematics::kinematics(&question),
        Command::Datasheet(options) => descriptions::datasheet::datasheet(&options),
        Command::Urdf(options) => descriptions::urdf::urdf(&options),
        Command::Vm { machine } => vm::vm(&machine),
        Command::Schema { reference } => schema(reference),
        Command::Manual {
            directory,
            replacement,
        } => manual::write(Arguments::command(), &directory, replacement),
    };
    result.unwrap_or_else(|refusal| {
        streams::refuse(&refusal);
        ExitCode::from(2)
    })
}

/// Checks a cell file, its programs and its buses.
fn check(cell: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let checked = mrroc::check(&CellFile::read(cell)?, &Tasks::programs)?;
    for problem in &checked.problems {
        streams::warn(format_args!(
            "mrroc: {problem}; only for robots that are wired otherwise than the emulated ones"
        ));
    }
    streams::answer(&checked, json)
}

/// Prints the JSON schema of cell files, or their reference.
fn schema(reference: bool) -> anyhow::Result<ExitCode> {
    streams::print(match reference {
        true => descriptions::cell_reference::reference(),
        false => serde_json::to_string_pretty(&Cell::schema())? + "\n",
    })
}
