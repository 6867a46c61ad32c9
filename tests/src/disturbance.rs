//! Tests by the clock, and disturbances of their runs by the host.
//!
//! A run is repeated only if its verdict was negative and the host disturbed the run: [`judged`]. A negative verdict of
//! an undisturbed run fails the test at once. A defect that is late, or that loses messages, is no disturbance: the
//! evidence is about the host alone.

use std::any::Any;
use std::cell::RefCell;
use std::collections::HashMap;
use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use can::clock;
use serde_json::Value;

use crate::processors::{self, ALL};

/// Greatest number of runs of a test by the clock: the first run and its repetitions.
pub const RUNS: usize = 8;

/// Words of each line about a run with a negative verdict.
pub(crate) const NEGATIVE: &str = "negative run";

/// Servo period of the example cells.
pub const PERIOD: Duration = Duration::from_millis(2);

/// Time without a disturbance before a repetition, and the longest wait for it.
const CALM: Duration = Duration::from_secs(1);
const STORM: Duration = Duration::from_secs(10);

/// Period of the observer. Every fifth period it reads the accounts of the kernel.
const LOOK: Duration = Duration::from_millis(10);
const LOOKS: u32 = 5;

/// Readings of the accounts between two searches for workers of the kernel.
const SEARCH: u32 = 20;

/// Unit of the stolen time in `/proc/stat`.
const TICK: Duration = Duration::from_millis(10);

/// Causes of late cycles that are no work of the program (`servo/src/thread/cause.rs`).
const OF_THE_HOST: [&str; 3] = ["preempted", "late wake-up", "host"];

/// Greatest delays of a run by its host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evidence {
    /// Lateness of a wait of the observer.
    pub late: Duration,
    /// Time between two readings of the accounts during which a thread of a program waited for a processor. The value is
    /// `None` where the kernel has no such account.
    pub waited: Option<Duration>,
    /// Time between two readings during which a worker of the kernel waited for a processor. Workers carry the bytes of
    /// pseudo-terminals, with less priority than the programs of a test.
    pub worker: Duration,
    /// Time that the hypervisor took from all processors between two readings, less a tick.
    pub stolen: Duration,
    /// Lateness of a servo cycle, by a cause of the host, in the report of a run.
    pub cycle: Duration,
}

impl Evidence {
    /// Evidence in the report of a run. Missed answers and the work of the program are no evidence.
    pub fn of_report(report: &Value) -> Self {
        let worst = report["cycle"]["worst"].as_array().into_iter().flatten();
        let by_host = worst.filter(|late| late["cause"].as_str().is_some_and(|cause| OF_THE_HOST.contains(&cause)));
        let late = by_host.filter_map(|late| late["late_us"].as_f64()).fold(0.0, f64::max);
        Self { cycle: Duration::from_secs_f64(late.max(0.0) * 1e-6), ..Self::default() }
    }

    /// Whether the host held the run back for at least the time that the run does not bear.
    pub fn disturbs(&self, unbearable: Duration) -> bool {
        let times = [self.late, self.waited.unwrap_or_default(), self.worker, self.stolen, self.cycle];
        times.into_iter().any(|time| time >= unbearable)
    }

    /// The greater of each delay.
    fn with(self, other: Self) -> Self {
        Self {
            late: self.late.max(other.late),
            waited: self.waited.max(other.waited),
            worker: self.worker.max(other.worker),
            stolen: self.stolen.max(other.stolen),
            cycle: self.cycle.max(other.cycle),
        }
    }
}

impl fmt::Display for Evidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { late, waited, worker, stolen, cycle } = self;
        write!(f, "the observer woke up to {late:.1?} late, ")?;
        match waited {
            Some(waited) => write!(f, "a thread waited {waited:.1?} for a processor, ")?,
            None => write!(f, "this kernel has no account of waits for a processor, ")?,
        }
        write!(f, "a worker of the kernel {worker:.1?}, {stolen:?} were stolen at once, ")?;
        write!(f, "a cycle was late by {cycle:.1?} because of the host")
    }
}

/// Runs `body`, a test by the clock, while it has a share of the processors. A disturbed run with a negative verdict is
/// repeated with all processors, once the host is calm.
///
/// `processors` is the mean use of processors, such as 0.3; `unbearable` is the shortest delay of a thread that can
/// change the verdict, in general the servo period.
pub fn by_the_clock<T>(processors: f64, unbearable: Duration, mut body: impl FnMut() -> T) -> T {
    let mut share = Some(processors::take(processors));
    judged(unbearable, |number| {
        if number > 1 {
            drop(share.take());
            share = Some(processors::take(ALL));
            wait_for_calm(unbearable);
        }
        let observer = Observer::start();
        let verdict = catch_unwind(AssertUnwindSafe(&mut body));
        (verdict, observer.end())
    })
}

/// Waits until the host lets this process run for [`CALM`] without a disturbance, [`STORM`] at most. Other work of the host,
/// such as a build, comes in spells.
fn wait_for_calm(unbearable: Duration) {
    let end = clock::now() + STORM;
    while clock::now() < end {
        let observer = Observer::start();
        clock::sleep_until(clock::now() + CALM);
        if !observer.end().disturbs(unbearable) {
            return;
        }
    }
}

/// Repeats a run, which receives its number from 1, while its verdict is negative and the host disturbed it, up to
/// [`RUNS`] times. Each repetition is printed with its evidence.
pub fn judged<T>(unbearable: Duration, mut run: impl FnMut(usize) -> (Result<T, Box<dyn Any + Send>>, Evidence)) -> T {
    for number in 1.. {
        let (verdict, evidence) = run(number);
        let panic = match verdict {
            Ok(passed) => return passed,
            Err(panic) => panic,
        };
        let repeated = evidence.disturbs(unbearable) && number < RUNS;
        let verdict = if repeated { "is repeated" } else { "counts" };
        let name = thread::current().name().unwrap_or("a thread").to_owned();
        let line = format!(
            "{name}: {NEGATIVE} {number} of at most {RUNS} {verdict}, {unbearable:?} is unbearable: {evidence}\n"
        );
        print!("{line}");
        // Also in the output of a test that passes, which the test runner does not show.
        let _ = io::stderr().write_all(line.as_bytes());
        if !repeated {
            resume_unwind(panic);
        }
    }
    unreachable!("a run returns or panics")
}

thread_local! {
    /// The observation of the test that this thread runs.
    static CURRENT: RefCell<Option<Arc<Observation>>> = const { RefCell::new(None) };
}

/// Observes a program of the present test, and the programs that it starts.
pub fn observe(process: u32) {
    of_this_test(|observation| observation.processes().push(process));
}

/// Adds the evidence in the output of a program, which may be a report.
pub fn report(output: &str) {
    of_this_test(|observation| {
        if let Ok(report) = serde_json::from_str(output) {
            observation.add(Evidence::of_report(&report));
        }
    });
}

fn of_this_test(act: impl FnOnce(&Observation)) {
    CURRENT.with_borrow(|current| current.as_deref().map(act));
}

/// What an observer and its test share.
#[derive(Default)]
struct Observation {
    over: AtomicBool,
    processes: Mutex<Vec<u32>>,
    evidence: Mutex<Evidence>,
}

impl Observation {
    fn processes(&self) -> MutexGuard<'_, Vec<u32>> {
        self.processes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&self, evidence: Evidence) {
        let mut all = self.evidence.lock().unwrap_or_else(PoisonError::into_inner);
        *all = all.with(evidence);
    }
}

/// A thread that measures the delays of a run.
struct Observer {
    observation: Arc<Observation>,
    before: Option<Arc<Observation>>,
    thread: JoinHandle<()>,
}

impl Observer {
    fn start() -> Self {
        let observation = Arc::<Observation>::default();
        // The threads of this process run drives and servo of some tests.
        observation.processes().push(std::process::id());
        let mut accounts = Accounts::default();
        accounts.read(&[std::process::id()]);
        let observed = Arc::clone(&observation);
        let thread = thread::spawn(move || {
            while !observed.over.load(Ordering::Relaxed) {
                let mut late = Duration::ZERO;
                for _ in 0..LOOKS {
                    let due = clock::now() + LOOK;
                    clock::sleep_until(due);
                    late = late.max(clock::now().since(due));
                }
                let processes = observed.processes().clone();
                let account = accounts.read(&processes);
                observed.add(Evidence { late, ..account });
            }
        });
        let before = CURRENT.replace(Some(Arc::clone(&observation)));
        Self { observation, before, thread }
    }

    fn end(self) -> Evidence {
        CURRENT.set(self.before);
        self.observation.over.store(true, Ordering::Relaxed);
        self.thread.join().expect("the observer does not panic");
        *self.observation.evidence.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The accounts of the kernel at the last reading.
#[derive(Default)]
struct Accounts {
    /// Time that each thread of the programs has waited for a processor, ns.
    waited: HashMap<PathBuf, u64>,
    /// The same for the workers of the kernel.
    workers: HashMap<PathBuf, u64>,
    /// Readings until the next search for workers.
    search: u32,
    stolen: Option<u64>,
}

impl Accounts {
    /// The longest waits of a thread and of a worker, and the stolen time, since the last reading.
    fn read(&mut self, processes: &[u32]) -> Evidence {
        let mut longest = None::<Duration>;
        let own = std::process::id();
        let mut open = processes.to_vec();
        while let Some(process) = open.pop() {
            for thread in fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten() {
                let thread = thread.path();
                if process != own {
                    let children = fs::read_to_string(thread.join("children")).unwrap_or_default();
                    open.extend(children.split_whitespace().filter_map(|child| child.parse::<u32>().ok()));
                }
                let Some(waited) = waited(&thread) else { continue };
                let before = self.waited.insert(thread, waited).unwrap_or(0);
                longest = longest.max(Some(Duration::from_nanos(waited.saturating_sub(before))));
            }
        }
        Evidence { waited: longest, worker: self.worker(), stolen: self.stolen(), ..Evidence::default() }
    }

    fn worker(&mut self) -> Duration {
        if self.search == 0 {
            self.search = SEARCH;
            for process in fs::read_dir("/proc").into_iter().flatten().flatten() {
                let process = process.path();
                let name = fs::read_to_string(process.join("comm")).unwrap_or_default();
                if name.starts_with("kworker") && !self.workers.contains_key(&process) {
                    self.workers.insert(process.clone(), waited(&process).unwrap_or(0));
                }
            }
        }
        self.search -= 1;
        let mut longest = 0;
        self.workers.retain(|process, before| {
            let Some(waited) = waited(process) else { return false };
            longest = longest.max(waited.saturating_sub(*before));
            *before = waited;
            true
        });
        Duration::from_nanos(longest)
    }

    fn stolen(&mut self) -> Duration {
        let stat = fs::read_to_string("/proc/stat").unwrap_or_default();
        let ticks = stat.lines().next().and_then(|all| all.split_whitespace().nth(8)?.parse::<u64>().ok());
        let before = self.stolen.replace(ticks.unwrap_or(0)).unwrap_or(ticks.unwrap_or(0));
        // The last tick may consist of many short times.
        TICK * ticks.unwrap_or(0).saturating_sub(before).saturating_sub(1).try_into().unwrap_or(u32::MAX)
    }
}

/// Time that a thread, a directory of `/proc`, has waited for a processor, ns. `None` where the kernel has no such
/// account, and for a thread that has ended.
fn waited(thread: &Path) -> Option<u64> {
    fs::read_to_string(thread.join("schedstat")).ok()?.split(' ').nth(1)?.parse().ok()
}
