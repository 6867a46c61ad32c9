//! Load for the CPUs while something is measured: ordinary threads, one per CPU.

use std::fs::OpenOptions;
use std::hint::black_box;
use std::io::{Seek, SeekFrom, Write};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle};

use anyhow::Context;
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

/// What loads the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Kind {
    /// Arithmetic.
    Cpu,
    /// Reads and writes all over a memory larger than the caches.
    Memory,
    /// New processes, one after the other.
    Fork,
    /// Writes to a file in the directory for temporary ones, each made durable.
    Io,
}

/// Load under way; dropping it ends it.
pub(crate) struct Load {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Starts each of `kinds` on as many threads as there are CPUs.
    pub(crate) fn start(kinds: &[Kind]) -> anyhow::Result<Self> {
        let mut load = Self {
            over: Arc::default(),
            threads: Vec::new(),
        };
        let cpus = std::thread::available_parallelism().map_or(1, usize::from);
        for (kind, number) in kinds
            .iter()
            .flat_map(|&kind| (0..cpus).map(move |number| (kind, number)))
        {
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
