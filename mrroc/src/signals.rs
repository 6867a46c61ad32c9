//! Signals: each signal that would end the process requests an orderly end of the command.
//!
//! Exceptions are SIGKILL and SIGSTOP, which cannot be caught. After SIGILL, SIGFPE, SIGSEGV and SIGBUS the program
//! cannot be trusted. Rust ignores SIGPIPE, and the C library reserves 32 and 33.

use std::ffi::c_int;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;

use anyhow::Context;
use libc::{SIGPWR, SIGSTKFLT};
use nix::sys::signal::{SigSet, Signal};
use signal_hook::consts::{
    SIGABRT, SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGSYS, SIGTERM, SIGTRAP, SIGTSTP, SIGUSR1, SIGUSR2,
    SIGVTALRM, SIGXCPU,
};
use signal_hook::iterator::Signals;

use crate::{bench::BenchKind, run::SMALL_STACK};

/// Signals that end a process, except the real-time signals.
const ENDING: [c_int; 16] = [
    SIGHUP, SIGINT, SIGQUIT, SIGTRAP, SIGABRT, SIGUSR1, SIGUSR2, SIGALRM, SIGTERM, SIGSTKFLT, SIGXCPU, SIGVTALRM,
    SIGPROF, SIGIO, SIGPWR, SIGSYS,
];

/// Number of signals after which a command is ended at once, if nothing can be in motion.
const PATIENCE: usize = 3;

/// Whether real hardware may be in motion.
#[derive(Clone)]
pub struct Motion(Arc<AtomicBool>);

impl Motion {
    /// For a command that moves nothing.
    pub fn none() -> Self {
        Self(Arc::default())
    }

    /// For a command that starts motion on a bench.
    pub fn on(bench: BenchKind) -> Self {
        let may_move = match bench {
            BenchKind::Lockstep | BenchKind::Emulated => false,
            BenchKind::Vcan | BenchKind::Card => true,
        };
        Self(Arc::new(may_move.into()))
    }

    /// Notes that all motion has ended.
    pub fn is_over(&self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// Calls `ask`, on its own thread, for each signal that would end the process. The third signal ends the process,
/// unless there may be `motion`.
pub fn on_ending(motion: Motion, ask: impl FnMut(c_int) + Send + 'static) -> anyhow::Result<()> {
    on(ending(), motion, ask)
}

/// Like [`on_ending`], for a command that moves an arm. SIGTSTP (Ctrl-Z) also ends such a command, because a suspended
/// controller cannot monitor its arm. SIGUSR1 is left to the command.
pub fn on_ending_of_motion(motion: Motion, ask: impl FnMut(c_int) + Send + 'static) -> anyhow::Result<()> {
    on(ending().into_iter().filter(|signal| *signal != SIGUSR1).chain([SIGTSTP]), motion, ask)
}

/// A flag set by the signals that end a process.
pub fn ending_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let ended = Arc::new(AtomicBool::new(false));
    let flag = ended.clone();
    on_ending(Motion::none(), move |_| flag.store(true, Ordering::Relaxed))?;
    Ok(ended)
}

/// Keeps SIGTTIN, SIGTTOU and SIGXFSZ from this thread and the threads that it starts. Writes to the terminal then succeed
/// in the background, also under `stty tostop`, and a write beyond the limit of file size (`ulimit -f`) fails like a write
/// to a full disk.
pub fn block_signals_of_writes() -> anyhow::Result<()> {
    let signals: SigSet = [Signal::SIGTTIN, Signal::SIGTTOU, Signal::SIGXFSZ].into_iter().collect();
    signals.thread_block().context("SIGTTOU cannot be blocked")
}

fn ending() -> Vec<c_int> {
    ENDING.into_iter().chain(libc::SIGRTMIN()..=libc::SIGRTMAX()).collect()
}

fn on(
    signals: impl IntoIterator<Item = c_int>,
    motion: Motion,
    mut ask: impl FnMut(c_int) + Send + 'static,
) -> anyhow::Result<()> {
    let refused = "signals such as Ctrl-C cannot be caught, so nothing could be stopped by them";
    let mut signals = Signals::new(signals).context(refused)?;
    let listen = move || {
        for (signal, count) in signals.forever().zip(1..) {
            ask(signal);
            if count >= PATIENCE && !motion.0.load(Ordering::Relaxed) {
                std::process::exit(1);
            }
        }
    };
    Builder::new().name("signals".into()).stack_size(SMALL_STACK).spawn(listen).context(refused)?;
    Ok(())
}
