//! `mrroc vm`: virtual machines that have what the host lacks.

use std::env;
use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use clap::Subcommand;
use hil::uml;

/// Where the machine looks for programs after the directory of this one.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// The machines.
#[derive(Subcommand)]
pub(crate) enum Machine {
    /// User-mode Linux with vcan0. The host's files are there, read-only, and so is the working directory; what the
    /// command writes into the directory that MRROC_OUT names comes out. This program is on its PATH.
    Uml {
        /// The directory that MRROC_OUT names inside; nothing comes out without it.
        #[arg(long)]
        out: Option<PathBuf>,
        /// A directory under /tmp, /var/tmp, /run or /dev that is to be seen inside.
        #[arg(long, value_name = "DIRECTORY")]
        see: Vec<PathBuf>,
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
        see,
        memory,
        timeout,
        command,
    } = machine;
    let program = env::current_exe().context("this program's own path")?;
    let home = program.parent().expect("a program lies in a directory");
    let mut path = home.as_os_str().to_owned();
    path.push(":");
    path.push(PATH);
    let see = see.iter().map(std::path::absolute);
    let options = uml::Options {
        env: vec![("PATH".into(), path)],
        directory: env::current_dir().context("the working directory")?,
        visible: see.chain([Ok(home.to_owned())]).collect::<Result<_, _>>()?,
        output: out.clone(),
        memory_mib: *memory,
        timeout: Duration::from_secs(*timeout),
        ..uml::Options::new(command)
    };
    Ok(ExitCode::from(uml::run(&options, &mut io::stdout())?))
}
