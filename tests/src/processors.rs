//! The budget of processors of the tests by the clock.
//!
//! Most of these tests wait for a clock most of the time. Each states its mean use of processors, and the sum of what
//! runs at once is bounded.

use std::collections::VecDeque;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::{env, fs, thread};

use can::clock;

use crate::mrroc;

/// The share of a test that cannot bear other tests.
pub const ALL: f64 = f64::INFINITY;

/// Part of the processors that no test gets, for observers and the kernel.
const RESERVE: f64 = 0.2;

/// Niceness of the programs of a test.
const NICENESS: &str = "-12";

/// Processors in hundredths, shared in the order of the requests.
#[derive(Debug)]
pub struct Budget {
    capacity: u32,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    used: u32,
    requests: u64,
    waiting: VecDeque<u64>,
}

impl Budget {
    pub const fn new(capacity: u32) -> Self {
        let state = State { used: 0, requests: 0, waiting: VecDeque::new() };
        Self { capacity, state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Waits until the share is free. A greater share than all is all.
    pub fn take(&self, processors: f64) -> Share<'_> {
        let amount = ((processors * 100.0).ceil() as u32).clamp(1, self.capacity);
        let mut state = self.state();
        let request = state.requests;
        state.requests += 1;
        state.waiting.push_back(request);
        while state.waiting.front() != Some(&request) || state.used + amount > self.capacity {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.waiting.pop_front();
        state.used += amount;
        self.changed.notify_all();
        Share { budget: self, amount }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hundredths of processors that are taken.
    pub fn used(&self) -> u32 {
        self.state().used
    }
}

/// A share of the processors, given back on drop.
#[derive(Debug)]
pub struct Share<'a> {
    budget: &'a Budget,
    amount: u32,
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        self.budget.state().used -= self.amount;
        self.budget.changed.notify_all();
    }
}

/// Takes a share of the processors of this host for a test by the clock. The programs are built before. The programs of
/// the test precede other work of the host, which only root may arrange.
pub fn take(processors: f64) -> Share<'static> {
    static BUDGET: std::sync::OnceLock<Budget> = std::sync::OnceLock::new();
    mrroc::binary();
    let budget = BUDGET.get_or_init(|| {
        let count = thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Budget::new(((count as f64 - RESERVE) * 100.0) as u32)
    });
    let began = clock::now();
    let share = budget.take(processors);
    // Read by `tests/run`, which leaves this time out of the duration of the test.
    println!("waited {:.3} s for processors", clock::now().since(began).as_secs_f64());
    precede();
    share
}

/// Gives the calling thread, and the programs and threads that it starts, the priority of a test by the clock.
pub fn precede() {
    // In a test machine, all programs have the same priority.
    if env::var_os("MRROC_OUT").is_some() {
        return;
    }
    let thread = fs::read_link("/proc/thread-self").expect("Linux");
    let thread: &Path = thread.file_name().expect("PID/task/TID").as_ref();
    let mut renice = Command::new("renice");
    let renice = renice.args(["-n", NICENESS, "-p"]).arg(thread);
    let _ = renice.stdout(Stdio::null()).stderr(Stdio::null()).status();
}
