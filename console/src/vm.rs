//! `mrroc vm`: runs a command in user-mode Linux with vcan, or in an emulated PC with PREEMPT_RT and CAN cards.

use std::env;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::{Args, Subcommand};
use hil::uml::Cancellation;
use hil::{qemu, uml};

use mrroc::signals::{self, Motion};

/// PATH inside the machine, after the directory of this program.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// Default of `--kernel`, if this directory exists.
const UNPACKED: &str = "target/qemu";

/// Kinds of machine.
#[derive(Subcommand)]
pub(crate) enum Machine {
    /// Run the command in user-mode Linux with vcan0. Files of the host are read-only. /tmp, /var/tmp, /run and /dev
    /// are hidden, except the working directory and --see. Files in the directory MRROC_OUT are copied to --out. This
    /// program is on the PATH of the command. The exit status is that of the command, or 128 plus the number of the
    /// signal that ended this program.
    Uml(Options),
    /// Run the command in a PC with Debian's PREEMPT_RT kernel, a hardware watchdog, an interface vcan0, and two Kvaser
    /// CAN cards on a bus of their own. The interfaces can0 and can1 are down at first, and vcan0 is up. Files are as
    /// in user-mode Linux. The machine is for functional tests; its timing is not representative.
    Qemu {
        /// Unpacked package on which linux-image-rt-amd64 depends. [default: target/qemu if it exists, otherwise the
        /// installed package in /]
        #[arg(long, value_name = "DIRECTORY")]
        kernel: Option<PathBuf>,
        /// Let the clock of the machine count instructions, 1 ns each. The clock stands still while the host does other
        /// work, so no program in the machine is late because of the host. While its processor is busy, the machine
        /// needs about ten times as long as its clock shows. --timeout is in the time of the host.
        #[arg(long)]
        count_instructions: bool,
        #[command(flatten)]
        options: Options,
    },
}

/// Options of a machine.
#[derive(Args)]
pub(crate) struct Options {
    /// Directory on the host that receives the content of MRROC_OUT. Without it, no file is copied out of the machine.
    /// The directory is created if it does not exist. It is refused if other users can change its content or its path.
    #[arg(long)]
    out: Option<PathBuf>,
    /// A directory under /tmp, /var/tmp, /run or /dev that is to be visible inside.
    #[arg(long, value_name = "DIRECTORY")]
    see: Vec<PathBuf>,
    /// Memory, MiB.
    #[arg(long, default_value_t = 512)]
    memory: u32,
    /// Time-out, s.
    #[arg(long, default_value_t = 600)]
    timeout: u64,
    /// The command and its arguments.
    #[arg(last = true, required = true)]
    command: Vec<OsString>,
}

impl Options {
    /// Options for `hil`, with absolute paths.
    fn resolve(&self, cancellation: &Cancellation) -> anyhow::Result<uml::Options> {
        let program = env::current_exe().context("this program's own path")?;
        let home = program.parent().expect("a program lies in a directory");
        let mut path = home.as_os_str().to_owned();
        path.push(":");
        path.push(PATH);
        let see = self.see.iter().map(std::path::absolute);
        Ok(uml::Options {
            env: vec![("PATH".into(), path)],
            directory: env::current_dir().context("the working directory")?,
            visible: see.chain([Ok(home.to_owned())]).collect::<Result<_, _>>()?,
            output: self.out.clone(),
            memory_mib: self.memory,
            timeout: Duration::from_secs(self.timeout),
            cancellation: cancellation.clone(),
            ..uml::Options::new(&self.command)
        })
    }
}

/// Runs a command in a machine and returns the exit status of the command. If a signal ends the machine before
/// the command ends, the status is 128 plus the signal number.
pub(crate) fn vm(machine: &Machine) -> anyhow::Result<ExitCode> {
    let mut stdout = io::stdout();
    let cancellation = Cancellation::default();
    let (cancel, ended_by) = (cancellation.clone(), Arc::new(AtomicU8::new(0)));
    let first = ended_by.clone();
    signals::on_ending(Motion::none(), move |signal| {
        let signal = u8::try_from(signal).expect("signals have small numbers");
        // The exit status reports the first signal only.
        let _ = first.compare_exchange(0, signal, Ordering::Relaxed, Ordering::Relaxed);
        cancel.cancel();
    })?;
    let status = match machine {
        Machine::Uml(options) => uml::run(&options.resolve(&cancellation)?, &mut stdout).map_err(anyhow::Error::from),
        Machine::Qemu { kernel, count_instructions, options } => {
            let unpacked = Path::new(UNPACKED);
            let found = if unpacked.exists() { unpacked } else { Path::new("/") };
            let kernel = qemu::Kernel::below(kernel.as_deref().unwrap_or(found))?;
            let clock = if *count_instructions { qemu::Clock::Instructions } else { qemu::Clock::Host };
            qemu::run(&kernel, clock, &options.resolve(&cancellation)?, &mut stdout).map_err(Into::into)
        }
    };
    match ended_by.load(Ordering::Relaxed) {
        0 => status.map(ExitCode::from),
        signal => Ok(status.map_or(ExitCode::from(128 + signal), ExitCode::from)),
    }
}
