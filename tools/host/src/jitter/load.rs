//! Load for the CPUs while something is measured: ordinary threads, one per CPU, or a program that loads them all.
//!
//! A program is started in a process group of its own that is killed whole when the load is dropped; if this process is
//! killed first, the kernel ends the program.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

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
use serde::Serialize;

/// Bytes of stack of a thread: all memory may be locked.
const STACK: usize = 128 * 1024;

/// Bytes that the memory load walks over: more than caches hold.
const MEMORY: usize = 32 << 20;

/// Bytes that the disk load writes at once.
const BLOCK: usize = 1 << 20;

/// Blocks in the file of the disk load.
const BLOCKS: u64 = 16;

/// How often to look whether a program has ended.
const LOOK: Duration = Duration::from_millis(50);

/// How long a program may take to end when it is told to.
const ENDING: Duration = Duration::from_secs(3);

/// What loads the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Kind {
    /// Arithmetic.
    Cpu,
    /// Reads and writes all over a memory larger than the caches.
    Memory,
    /// New processes, one after the other.
    Fork,
    /// Writes to a file in the directory for temporary ones, each made durable.
    Io,
    /// Frames that nobody asked for on the virtual buses of the cell under measurement.
    Bus,
    /// hackbench of Debian's package rt-tests: messages between many threads.
    Hackbench,
    /// stress-ng of Debian's package of that name: its arithmetic, memory and disk.
    StressNg,
}

impl Kind {
    /// As on the command line.
    pub(super) fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// The program that it is, and its Debian package.
    fn program(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Hackbench => Some(("hackbench", "rt-tests")),
            Self::StressNg => Some(("stress-ng", "stress-ng")),
            Self::Cpu | Self::Memory | Self::Fork | Self::Io | Self::Bus => None,
        }
    }
}

/// Load under way; dropping it ends it.
pub(super) struct Load {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Refuses programs among `kinds` that are not installed.
    pub(super) fn find(kinds: &[Kind]) -> anyhow::Result<()> {
        for (name, package) in kinds.iter().filter_map(|kind| kind.program()) {
            let found = Command::new(name)
                .arg("--help")
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status();
            match found {
                Err(error) if error.kind() == ErrorKind::NotFound => {
                    bail!("{name} is not installed; `apt install {package}` installs it")
                }
                found => found.with_context(|| format!("{name} cannot be run"))?,
            };
        }
        Ok(())
    }

    /// Starts each of `kinds` on as many threads as there are CPUs, each program once.
    pub(super) fn start(kinds: &[Kind]) -> anyhow::Result<Self> {
        let mut load = Self {
            over: Arc::default(),
            threads: Vec::new(),
        };
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
            let thread = Builder::new()
                .name("load".into())
                .stack_size(STACK)
                .spawn(body);
            load.threads
                .push(thread.context("no thread for the load can be made")?);
        }
        Ok(load)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A load that panicked said so itself.
            let _ = thread.join();
        }
    }
}

/// One short turn of a load, which says whether to go on.
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
        // It hangs on the buses of the cell, and needs no thread.
        Kind::Bus => Box::new(|| false),
        // Threads of one process end with it.
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
            // It goes with its descriptor, however this process ends.
            std::fs::remove_file(&path)?;
            let (block, mut written) = (vec![0x55; BLOCK], 0);
            Box::new(move || {
                written += 1;
                let rewound = match written % BLOCKS {
                    0 => file.seek(SeekFrom::Start(0)).map(|_| ()),
                    _ => Ok(()),
                };
                rewound
                    .and_then(|()| file.write_all(&block))
                    .and_then(|()| file.sync_data())
                    .is_ok()
            })
        }
    })
}

/// Keeps a program running: a look at it each turn.
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

/// A program under way; dropping it ends it, and kills its process group if it does not end in time.
struct Program(Child);

impl Program {
    /// setpriv of util-linux has the kernel tell the program when this thread is no more.
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
        let id = self.0.id();
        let signal = |signal: &str| {
            let _ = Command::new("sh")
                .args(["-c", &format!("kill {signal}{id}")])
                .stderr(Stdio::null())
                .status();
        };
        // Those that have processes of their own wait for them.
        signal("-TERM ");
        let end = now() + ENDING;
        while matches!(self.0.try_wait(), Ok(None)) && now() < end {
            sleep_until(now() + LOOK);
        }
        signal("-KILL -- -");
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
