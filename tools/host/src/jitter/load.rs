//! Load for the CPUs during a measurement: ordinary threads, one per CPU, or a program that loads all CPUs.
//!
//! A program runs in a process group of its own. Dropping the load kills the whole group. If this process is killed
//! first, the kernel ends the program.

use std::fs::OpenOptions;
use std::hint::black_box;
use std::io::{ErrorKind, Seek, SeekFrom, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use anyhow::{Context, bail};
use can::clock::{now, sleep_until};
use clap::ValueEnum;
use nix::sys::signal::{Signal, kill, killpg};
use nix::unistd::Pid;
use serde::Serialize;

/// Stack of a thread, bytes; small, because all memory may be locked.
const STACK: usize = 128 * 1024;

/// Memory that the memory load accesses, bytes; larger than the caches.
const MEMORY: usize = 32 << 20;

/// Size of one write of the disk load, bytes.
const BLOCK: usize = 1 << 20;

/// Number of blocks in the file of the disk load.
const BLOCKS: u64 = 16;

/// Time between two checks whether a program has ended.
const LOOK: Duration = Duration::from_millis(50);

/// Time that a program has to end after a signal.
const ENDING: Duration = Duration::from_secs(3);

/// Kind of load.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Kind {
    /// Arithmetic.
    Cpu,
    /// Reads and writes in a memory larger than the caches.
    Memory,
    /// Starts new processes, one after the other.
    Fork,
    /// Writes to a file in the directory for temporary files, each followed by a sync.
    Io,
    /// Additional frames on the virtual buses of the measured cell.
    Bus,
    /// hackbench of Debian's package rt-tests: messages between many threads.
    Hackbench,
    /// stress-ng of Debian's package of that name: its arithmetic, memory and disk.
    StressNg,
}

impl Kind {
    /// Name on the command line.
    pub(super) fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// The program that produces this load, and its Debian package.
    fn program(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Hackbench => Some(("hackbench", "rt-tests")),
            Self::StressNg => Some(("stress-ng", "stress-ng")),
            Self::Cpu | Self::Memory | Self::Fork | Self::Io | Self::Bus => None,
        }
    }
}

/// Refuses a program of a Debian package that is not installed. `otherwise` says how to do without the program.
pub(super) fn find(name: &str, package: &str, otherwise: &str) -> anyhow::Result<()> {
    let found =
        Command::new(name).arg("--help").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    match found {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            bail!("{name} is not installed; `apt install {package}` installs it{otherwise}")
        }
        found => found.with_context(|| format!("{name} cannot be run"))?,
    };
    Ok(())
}

/// A running load. Dropping it ends the load.
pub(super) struct Load {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Refuses kinds of load whose program is not installed.
    pub(super) fn find(kinds: &[Kind]) -> anyhow::Result<()> {
        let mut programs = kinds.iter().filter_map(|kind| kind.program());
        programs.try_for_each(|(name, package)| find(name, package, ""))
    }

    /// Starts a thread per CPU for each of `kinds`; a kind that is a program is started once.
    pub(super) fn start(kinds: &[Kind]) -> anyhow::Result<Self> {
        let mut load = Self { over: Arc::default(), threads: Vec::new() };
        let cpus = std::thread::available_parallelism().map_or(1, usize::from);
        for (kind, number) in kinds.iter().flat_map(|&kind| {
            let threads = match kind {
                Kind::Bus => 0,
                _ => kind.program().map_or(cpus, |_| 1),
            };
            (0..threads).map(move |number| (kind, number))
        }) {
            let mut turn = turn(kind, number)?;
            let over = load.over.clone();
            let body = move || while !over.load(Ordering::Relaxed) && turn() {};
            let thread = Builder::new().name("load".into()).stack_size(STACK).spawn(body);
            load.threads.push(thread.context("no thread for the load can be made")?);
        }
        Ok(load)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A load that panicked has printed the message already.
            let _ = thread.join();
        }
    }
}

/// One short turn of a load, which returns whether to continue.
fn turn(kind: Kind, number: usize) -> anyhow::Result<Box<dyn FnMut() -> bool + Send>> {
    Ok(match kind {
        Kind::Cpu => Box::new(|| {
            black_box((0..1_000_000u64).fold(1u64, |x, y| black_box(x.wrapping_mul(y | 1))));
            true
        }),
        Kind::Memory => {
            let mut memory = vec![1u8; MEMORY];
            Box::new(move || {
                for byte in black_box(&mut memory).iter_mut().step_by(64) {
                    *byte = byte.wrapping_mul(3);
                }
                true
            })
        }
        Kind::Fork => Box::new(|| {
            let child = Command::new("true").stdin(Stdio::null()).status();
            child.is_ok()
        }),
        // The frames are sent by the buses of the cell, without a thread here.
        Kind::Bus => Box::new(|| false),
        // The threads of a process end with the process.
        Kind::Hackbench => again(&["hackbench", "--threads", "--loops=10000"]),
        Kind::StressNg => again(&[
            "stress-ng",
            "--quiet",
            "--temp-path=/tmp",
            "--cpu=0",
            "--vm=1",
            "--vm-bytes=64M",
            "--hdd=1",
            "--hdd-bytes=16M",
        ]),
        Kind::Io => {
            let name = format!("mrroc-load-{}-{number}", std::process::id());
            let path = std::env::temp_dir().join(name);
            let mut file = OpenOptions::new()
                .write(true)
                .create_new(true)
                .open(&path)
                .with_context(|| format!("{} cannot be written for the load", path.display()))?;
            // The kernel frees the file with its descriptor, however this process ends.
            std::fs::remove_file(&path)?;
            let (block, mut written) = (vec![0x55; BLOCK], 0);
            Box::new(move || {
                written += 1;
                let rewound = match written % BLOCKS {
                    0 => file.seek(SeekFrom::Start(0)).map(|_| ()),
                    _ => Ok(()),
                };
                rewound.and_then(|()| file.write_all(&block)).and_then(|()| file.sync_data()).is_ok()
            })
        }
    })
}

/// Keeps a program running; each turn checks whether it has ended.
fn again(words: &'static [&'static str]) -> Box<dyn FnMut() -> bool + Send> {
    let mut running = None::<Program>;
    Box::new(move || {
        let ended = match &mut running {
            Some(program) => program.0.try_wait().map(|status| status.is_some()),
            None => Ok(true),
        };
        if ended.is_ok_and(|ended| ended) {
            running = Program::start(words).ok();
        }
        sleep_until(now() + LOOK);
        running.is_some()
    })
}

/// A running program. Dropping it ends the program, and kills its process group after a time-out.
struct Program(Child);

impl Program {
    /// setpriv of util-linux makes the kernel signal the program when this thread ends.
    fn start(words: &[&str]) -> std::io::Result<Self> {
        let mut command = Command::new("setpriv");
        command
            .args(["--pdeathsig", "TERM", "--"])
            .args(words)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .process_group(0);
        command.spawn().map(Self)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let id = Pid::from_raw(self.0.id().cast_signed());
        // Programs with child processes wait for them.
        let _ = kill(id, Signal::SIGTERM);
        let end = now() + ENDING;
        while matches!(self.0.try_wait(), Ok(None)) && now() < end {
            sleep_until(now() + LOOK);
        }
        let _ = killpg(id, Signal::SIGKILL);
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
