//! `mrroc vm`: virtual machines that have what the host lacks.

use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Subcommand;
use hil::uml;

/// The machines.
#[derive(Subcommand)]
pub(crate) enum Machine {
    /// User-mode Linux with vcan0. The host's files are there, read-only; what the command writes into the directory
    /// that MRROC_OUT names comes out.
    Uml {
        /// The directory that MRROC_OUT names inside; nothing comes out without it.
        #[arg(long)]
        out: Option<PathBuf>,
        /// Memory, MiB.
        #[arg(long, default_value_t = 512)]
        memory: u32,
        /// When to give up, s.
        #[arg(long, default_value_t = 600)]
        timeout: u64,
        /// The command and its arguments.
        #[arg(last = true, required = true)]
        command: Vec<OsString>,
    },
}

/// Runs a command in a machine; its exit status becomes ours.
pub(crate) fn vm(machine: &Machine) -> anyhow::Result<ExitCode> {
    let Machine::Uml {
        out,
        memory,
        timeout,
        command,
    } = machine;
    let options = uml::Options {
        output: out.clone(),
        memory_mib: *memory,
        timeout: Duration::from_secs(*timeout),
        ..uml::Options::new(command)
    };
    Ok(ExitCode::from(uml::run(&options, &mut io::stdout())?))
}
