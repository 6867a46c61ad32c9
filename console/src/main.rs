//! The `mrroc` command: the only room that opens ports, spawns threads and prints.
//!
//! Exit status: 0 done; 1 stopped by a fault or on request, or a node was told and did not do it; 2 refused before
//! anything moved, or no answer.

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod bench;
mod bridge;
mod budget;
mod bus_port;
mod card;
mod cell_file;
mod chart;
mod check;
mod clockwork;
mod configuration;
mod datasheet;
mod doctor;
mod eds;
mod emulate;
mod emulated_lines;
mod emulated_time;
mod emulation;
mod identify;
mod input;
mod interfaces;
mod jitter;
mod kinematics;
mod manual;
mod outputs;
mod plants;
mod programs;
mod rehearsal;
mod report;
mod run;
mod service;
mod setup;
mod signals;
mod spikes;
mod streams;
mod svg;
mod trace;
mod urdf;
mod usage;
mod vm;
mod warning_report;
mod wire;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

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
    Doctor(doctor::Options),
    /// Bring a cell up, home it, run its programs and report. Moves hardware on the card bench.
    Run(run::Options),
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
    Jitter(jitter::Options),
    /// Where a robot's flange is for given joints, which joints put it there, and how they move it.
    Kinematics {
        #[command(subcommand)]
        question: kinematics::Question,
    },
    /// Print the data sheet of a robot, of the gripper or of the conveyor in Markdown, or its figure in SVG: geometry,
    /// drives, limits, and where the numbers come from.
    Datasheet(datasheet::Options),
    /// Print a robot's description (URDF) for viewers and libraries of rigid bodies.
    Urdf(urdf::Options),
    /// Run a command in a virtual machine that has CAN.
    Vm {
        #[command(subcommand)]
        machine: vm::Machine,
    },
    /// Print the JSON schema of cell files.
    Schema,
    /// Write the manual pages and the completions of bash, zsh and fish into a directory.
    #[command(hide = true)]
    Manual {
        /// The directory.
        directory: PathBuf,
        #[command(flatten)]
        replacement: outputs::Replacement,
    },
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return usage::answer(&error),
    };
    let result = match arguments.command {
        Command::Check { cell, json } => check::check(&cell, json),
        Command::Doctor(options) => doctor::doctor(&options),
        Command::Run(options) => run::run(&options),
        Command::Emulate(options) => emulate::emulate(&options),
        Command::Scan(options) => service::scan::scan(&options),
        Command::Sdo { action } => service::sdo::sdo(&action),
        Command::Nmt(options) => service::nmt::nmt(&options),
        Command::Lss { action } => service::lss::lss(&action),
        Command::Monitor(options) => service::monitor::monitor(&options),
        Command::Eds { cell, axis } => eds::eds(&cell, &axis),
        Command::Identify(options) => identify::identify(&options),
        Command::Jitter(options) => jitter::jitter(&options),
        Command::Kinematics { question } => kinematics::kinematics(&question),
        Command::Datasheet(options) => datasheet::datasheet(&options),
        Command::Urdf(options) => urdf::urdf(&options),
        Command::Vm { machine } => vm::vm(&machine),
        Command::Schema => check::schema(),
        Command::Manual {
            directory,
            replacement,
        } => manual::write(Arguments::command(), &directory, replacement),
    };
    result.unwrap_or_else(|refusal| {
        // A refusal may quote a file: nothing of it acts on a terminal, and it stays one line.
        let said = controller::cell::printable(&format!("{refusal:#}"));
        streams::warn(format_args!("mrroc: {said}"));
        ExitCode::from(2)
    })
}
