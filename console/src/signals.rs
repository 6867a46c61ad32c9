//! Signals: each that would end the process asks the command to end in order.
//!
//! Left alone are SIGKILL and SIGSTOP, which cannot be caught; SIGILL, SIGFPE, SIGSEGV and SIGBUS, after which no code of
//! the program can be trusted; SIGPIPE, which Rust ignores; and 32 and 33, which the C library keeps for itself.

use std::ffi::c_int;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;

use anyhow::Context;
use nix::sys::signal::{SigSet, Signal};
use signal_hook::consts::{
    SIGABRT, SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGSYS, SIGTERM, SIGTRAP, SIGTSTP,
    SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
};
use signal_hook::iterator::Signals;

use crate::bench::BenchKind;
use crate::run::SMALL_STACK;

/// Signals that end a process, but for real-time ones.
const ENDING: [c_int; 17] = [
    SIGHUP,
    SIGINT,
    SIGQUIT,
    SIGTRAP,
    SIGABRT,
    SIGUSR1,
    SIGUSR2,
    SIGALRM,
    SIGTERM,
    libc::SIGSTKFLT,
    SIGXCPU,
    SIGXFSZ,
    SIGVTALRM,
    SIGPROF,
    SIGIO,
    libc::SIGPWR,
    SIGSYS,
];

/// Signals after which a command that still has not ended is ended at once, where nothing can be in motion.
const PATIENCE: usize = 3;

/// Whether something that is no emulation may be in motion.
#[derive(Clone)]
pub(crate) struct Motion(Arc<AtomicBool>);

impl Motion {
    /// Of a command that moves nothing.
    pub(crate) fn none() -> Self {
        Self(Arc::default())
    }

    /// Of a command on a bench, from now on.
    pub(crate) fn on(bench: BenchKind) -> Self {
        let may_move = match bench {
            BenchKind::Lockstep | BenchKind::Emulated => false,
            BenchKind::Vcan | BenchKind::Card => true,
        };
        Self(Arc::new(may_move.into()))
    }

    /// All stands still from now on.
    pub(crate) fn is_over(&self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// From now on each signal that would end the process has `ask` called with it, on a thread of its own. The third of them
/// ends the process unless there may be `motion`.
pub(crate) fn on_ending(
    motion: Motion,
    ask: impl FnMut(c_int) + Send + 'static,
) -> anyhow::Result<()> {
    on(ending(), motion, ask)
}

/// The same, of a command that moves an arm. Such a command does not let itself be suspended: Ctrl-Z ends it as well, and
/// in the background it may write to its terminal whatever `stty tostop` says. SIGUSR1 is not among the signals.
pub(crate) fn on_ending_of_motion(
    motion: Motion,
    ask: impl FnMut(c_int) + Send + 'static,
) -> anyhow::Result<()> {
    let signals = ending().into_iter().filter(|signal| *signal != SIGUSR1);
    on(signals.chain([SIGTSTP]), motion, ask)
}

/// A flag that such signals set.
pub(crate) fn ending_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let ended = Arc::new(AtomicBool::new(false));
    let flag = ended.clone();
    on_ending(Motion::none(), move |_| flag.store(true, Ordering::Relaxed))?;
    Ok(ended)
}

/// Keeps SIGTTIN and SIGTTOU from suspending this thread and those that it starts.
pub(crate) fn block_suspension() -> anyhow::Result<()> {
    let signals: SigSet = [Signal::SIGTTIN, Signal::SIGTTOU].into_iter().collect();
    signals.thread_block().context("SIGTTOU cannot be blocked")
}

fn ending() -> Vec<c_int> {
    ENDING
        .into_iter()
        .chain(libc::SIGRTMIN()..=libc::SIGRTMAX())
        .collect()
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
    let thread = Builder::new()
        .name("signals".into())
        .stack_size(SMALL_STACK);
    thread.spawn(listen).context(refused)?;
    Ok(())
}
