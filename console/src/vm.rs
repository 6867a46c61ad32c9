//! `mrroc vm`: virtual machines that have what the host lacks.

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

use crate::signals::{self, Motion};

/// Where the machine looks for programs after the directory of this one.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// Where the kernel package is unpacked, if `--kernel` does not say.
const UNPACKED: &str = "target/qemu";

/// The machines.
#[derive(Subcommand)]
pub(crate) enum Machine {
    /// User-mode Linux with vcan0. The host's files are there, read-only, and so is the working directory; what the
    /// command writes into the directory that MRROC_OUT names comes out. This program is on its PATH. The exit status is
    /// the command's; a signal that ends this program ends the machine too, with status 128 and the signal's number.
    Uml(Options),
    /// A PC with Debian's PREEMPT_RT kernel and two Kvaser CAN cards on one bus, can0 and can1, down at first. Files are
    /// as in user-mode Linux. It shows that something works, and nothing of how fast.
    Qemu {
        /// Where the package behind linux-image-rt-amd64 is unpacked: target/qemu if that is there, or else installed
        /// in /.
        #[arg(long, value_name = "DIRECTORY")]
        kernel: Option<PathBuf>,
        #[command(flatten)]
        options: Options,
    },
}

/// What to run in a machine.
#[derive(Args)]
pub(crate) struct Options {
    /// The directory that MRROC_OUT names inside; nothing comes out without it. It is made where it is not there, and
    /// refused where other users can change it or its path.
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
}

impl Options {
    /// As the machines take them.
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

/// Runs a command in a machine; its exit status becomes ours. A signal that ends the machine does as one that ends the
/// command: 128 and its number.
pub(crate) fn vm(machine: &Machine) -> anyhow::Result<ExitCode> {
    let mut stdout = io::stdout();
    let cancellation = Cancellation::default();
    let (cancel, ended_by) = (cancellation.clone(), Arc::new(AtomicU8::new(0)));
    let first = ended_by.clone();
    signals::on_ending(Motion::none(), move |signal| {
        let signal = u8::try_from(signal).expect("signals have small numbers");
        // A second one does not change by what it was ended.
        let _ = first.compare_exchange(0, signal, Ordering::Relaxed, Ordering::Relaxed);
        cancel.cancel();
    })?;
    let status = match machine {
        Machine::Uml(options) => {
            uml::run(&options.resolve(&cancellation)?, &mut stdout).map_err(anyhow::Error::from)
        }
        Machine::Qemu { kernel, options } => {
            let unpacked = Path::new(UNPACKED);
            let found = if unpacked.exists() {
                unpacked
            } else {
                Path::new("/")
            };
            let kernel = qemu::Kernel::below(kernel.as_deref().unwrap_or(found))?;
            qemu::run(&kernel, &options.resolve(&cancellation)?, &mut stdout).map_err(Into::into)
        }
    };
    match ended_by.load(Ordering::Relaxed) {
        0 => status.map(ExitCode::from),
        signal => Ok(status.map_or(ExitCode::from(128 + signal), ExitCode::from)),
    }
}
