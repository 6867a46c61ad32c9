//! Pseudo-terminals between the host and the emulated lines of a cell whose time follows the servo's cycles.
//!
//! The kernel normally passes bytes through a pseudo-terminal within microseconds. The cell's time stands still during
//! the transfer. After a cycle, the bridge waits until it has received every byte that the host wrote in the cycle.
//! Before the next cycle, the bridge waits until the host's end holds every byte that has arrived.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Context;
use can::{Instant, clock};
use hil::Pty;
use hil::pty::{self, Interest};
use serial::{Line, LineCounters, LineError, Settings, Tty, VirtualLine};

/// Longest wait for the kernel. Later bytes are taken in the next cycle.
const KERNEL: Duration = Duration::from_millis(50);

/// Time between two checks of the host's end.
const LOOK: Duration = Duration::from_micros(20);

/// Events that a bridge waits for.
const READ: Interest = Interest { read: true, write: false };

/// Greatest number of bytes transferred at a time.
const CHUNK: usize = 4096;

/// The emulated side of a pseudo-terminal. Bytes from the host go to a virtual line, and back.
pub struct Bridge {
    pty: Pty,
    line: VirtualLine,
    host: Arc<Passed>,
    taken: u64,
    delivered: u64,
}

/// The host's side: a tty that counts the transferred bytes.
pub struct BridgedTty {
    tty: Tty,
    passed: Arc<Passed>,
}

/// Numbers of bytes written and read by the host.
#[derive(Default)]
struct Passed {
    written: AtomicU64,
    read: AtomicU64,
}

impl Bridge {
    /// A bridge to `line`, and the tty at its other end.
    pub fn new(line: VirtualLine, settings: Settings) -> anyhow::Result<(Self, BridgedTty)> {
        let pty = Pty::open()?;
        let tty = Tty::open(pty.path(), settings).context("a pseudo-terminal")?;
        let passed = Arc::new(Passed::default());
        let bridge = Self { pty, line, host: passed.clone(), taken: 0, delivered: 0 };
        Ok((bridge, BridgedTty { tty, passed }))
    }

    /// Takes the bytes that the host wrote, at `now`. A failed pseudo-terminal acts like a cut line.
    pub fn take(&mut self, now: Instant) {
        let written = self.host.written.load(Ordering::Relaxed);
        let give_up = clock::now() + KERNEL;
        let mut bytes = [0; CHUNK];
        while self.taken < written {
            match self.pty.read(&mut bytes) {
                Ok(0) if clock::now() < give_up => {
                    if pty::wait([(self.pty.as_fd(), READ)], give_up).is_err() {
                        return;
                    }
                }
                Ok(0) | Err(_) => return,
                Ok(count) => {
                    self.taken += count as u64;
                    // Bytes without room are lost, as in the overrun of a receiver.
                    let _ = self.line.write(now, &bytes[..count]);
                }
            }
        }
    }

    /// Delivers the bytes that have arrived by `until`, and waits until the host can read them.
    pub fn deliver(&mut self, until: Instant) {
        let mut bytes = [0; CHUNK];
        while let Ok(count @ 1..) = self.line.read(until, &mut bytes) {
            self.delivered += self.pty.write(&bytes[..count]).unwrap_or(0) as u64;
        }
        let give_up = clock::now() + KERNEL;
        let unread = self.delivered - self.host.read.load(Ordering::Relaxed).min(self.delivered);
        while self.pty.readable().is_ok_and(|held| (held as u64) < unread) && clock::now() < give_up {
            clock::sleep_until(clock::now() + LOOK);
        }
    }
}

impl Line for BridgedTty {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let count = self.tty.write(now, bytes)?;
        self.passed.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn read(&mut self, now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        let count = self.tty.read(now, into)?;
        self.passed.read.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn counters(&self) -> LineCounters {
        self.tty.counters()
    }
}
