//! The guardian: a process beside the controller that stops drives which cannot watch their host.
//!
//! Axis controllers on serial lines follow their last set-point while the host is silent. The controller therefore
//! starts a second process of its own program, the guardian. The guardian has its own handles of the lines, and
//! monitors a counter of completed servo cycles in shared memory. In two cases, the guardian puts every drive on these
//! lines into its error state:
//!
//! - after [`GuardianConfig::silence`] without a completed cycle, until a cycle is completed again;
//! - when the process of the controller ends without the report that all drives are off.
//!
//! If the cell requests it for a CAN bus, the guardian also stops the nodes of this bus, by an NMT command to all
//! nodes. Drives then brake by their reaction to a lost connection, and outputs take their error state. The guardian
//! writes one byte per 100 ms to a hardware watchdog before the first cycle, and as long as cycles are completed.
//!
//! The guardian has its own session and blocks all signals. It requests a priority above the servo thread, locked
//! memory, and exemption from the OOM killer. [`Guardian::of_cell`] reports a denied priority and denied locked memory.
//!
//! The controller also monitors the guardian. After each cycle, the servo thread checks a heartbeat word of the
//! guardian ([`Pulse::beat`]), without a system call. The loss of the guardian stops all robots (category 1). After a
//! stop by the guardian, the run ends with [`GuardianFault::Stopped`]. Another thread finds this stop as well
//! ([`Guardian::look`]), because the servo thread may hang.
//!
//! The program of the guardian is `/proc/self/exe`. A function in `.init_array` runs before `main` and finds the
//! variable [`VARIABLE`] in the environment. Programs with a `main` of their own therefore need no code for the
//! guardian.
//!
//! The process is a child of the controller, or a process that a service manager started (`separate`).
//!
//! Read `process` for the states of the guardian, and `shared` for the shared memory.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod process;
pub mod separate;
mod shared;

use std::fs::File;
use std::io::{self, Write};
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use can::{clock, send_only};
use canopen::nmt;
use servo::StopRequest;
use servo::thread::Policy;
use thiserror::Error;

use crate::cell::{Cell, CellFile};
use crate::streams;
use separate::{Connection, MOST_DESCRIPTORS};
use shared::{Denied, LONGEST_TELEGRAM, LineOrders, MOST_LINES, Orders, Phase, Words};

/// Environment variable of a guardian process. The value is the number of the descriptor of the shared memory.
pub const VARIABLE: &str = "MRROC_GUARDIAN";

/// Name of a guardian process in lists of processes.
pub const NAME: &str = "mrroc-guardian";

/// Longest time until a new guardian is ready: it loads the program and locks its memory.
const READY: Duration = Duration::from_secs(5);

/// Longest time until a guardian that was told to end has ended.
const END: Duration = Duration::from_secs(1);

/// Interval of looks at a guardian that starts or ends.
const LOOK: Duration = Duration::from_millis(1);

/// Shortest time without a heartbeat after which the guardian is taken for lost. An ordinary host delays a process by
/// tens of milliseconds.
const LOST: Duration = Duration::from_millis(100);

/// The same, as a multiple of the silence that the guardian permits the controller.
const LOST_SILENCES: u32 = 5;

/// A line or CAN socket that a guardian holds, and the bytes that put its drive, or the nodes of the bus, into the error
/// state.
#[derive(Debug)]
pub struct GuardedLine {
    /// A duplicate of the descriptor of the line. Writing must not block.
    pub line: OwnedFd,
    /// At most 64 bytes.
    pub telegram: Vec<u8>,
}

/// The message to a CAN socket that puts all nodes of a bus into the NMT state stopped. Drives brake by their reaction to a
/// lost connection (object 0x6007), and outputs take their error state.
pub fn stop_of_all_nodes() -> Vec<u8> {
    let frame = nmt::Request { command: nmt::Command::Stop, target: nmt::Target::All }.encode();
    send_only::message(&frame).expect("an NMT command has a standard identifier").to_vec()
}

/// Times and priority of a guardian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardianConfig {
    /// Time without a completed servo cycle after which the guardian stops the drives.
    pub silence: Duration,
    /// The servo period. The guardian looks at the counter twice per period, so the stop begins at most half a period
    /// after `silence`.
    pub period: Duration,
    /// Priority of the servo thread under SCHED_FIFO. The guardian requests the next higher one.
    pub priority: u8,
}

/// Why a guardian did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum GuardianError {
    #[error("no shared memory (errno {errno})")]
    Memory { errno: i32 },
    #[error("the process cannot be started from /proc/self/exe (errno {errno})")]
    Spawn { errno: i32 },
    #[error("no `mrroc guard` waits at the socket of --guardian (errno {errno}): it serves one run, so start it again")]
    Connection { errno: i32 },
    #[error("the process has ended at its start")]
    Ended,
    #[error("the process was not ready after {waited:?}")]
    NotReady { waited: Duration },
    #[error("{lines} lines, {MOST_LINES} at most, with telegrams of 1 to {LONGEST_TELEGRAM} bytes")]
    Lines { lines: usize },
}

/// What a guardian does, in faults.
pub(crate) const DRIVES_STOPPED: &str = "the guardian put all drives that it guards into their error state";

/// What ended a run with a guardian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum GuardianFault {
    /// The guardian stopped the drives.
    #[error("no servo cycle for {silence:?}: {DRIVES_STOPPED}; check the host (`mrroc doctor`)")]
    Stopped { silence: Duration },
    /// The guardian has ended, or does not run.
    #[error("the guardian (process {pid}) has ended or was suspended: all robots stopped; check who ended the process")]
    Lost { pid: u32 },
}

/// A guardian process, as the controller sees it. Dropping this value ends the guardian. Unless [`Guardian::all_off`] was
/// called, or no cycle was completed, the guardian stops the drives before.
#[derive(Debug)]
pub struct Guardian {
    words: Arc<Words>,
    process: Process,
    /// The guardian notices the end of this process by the end of the pipe.
    life: Option<io::PipeWriter>,
    config: GuardianConfig,
    verdict: Arc<AtomicU8>,
    all_off: bool,
}

/// The process of a guardian.
#[derive(Debug)]
enum Process {
    Child(Child),
    Separate(Connection),
}

impl Process {
    fn id(&self) -> u32 {
        match self {
            Self::Child(child) => child.id(),
            Self::Separate(connection) => connection.pid,
        }
    }

    /// Whether the guardian will write no more telegrams.
    fn is_over(&mut self) -> bool {
        match self {
            Self::Child(child) => !matches!(child.try_wait(), Ok(None)),
            Self::Separate(connection) => connection.is_closed(),
        }
    }
}

/// Verdict of the servo thread on the guardian.
const FINE: u8 = 0;
const STOPPED: u8 = 1;
const LOST_HEARTBEAT: u8 = 2;

impl Guardian {
    /// Starts the guardian of a cell's serial lines, guarded buses and watchdog; `None` for a cell without these. The process
    /// that waits at the socket `separate` becomes the guardian, or without a socket a child of this process. Reports
    /// requests that the host denies in one warning. With [`Policy::Require`] a denied request refuses the start.
    pub fn of_cell(file: &CellFile, lines: &[GuardedLine], separate: Option<&Path>) -> anyhow::Result<Option<Self>> {
        let watchdog = file.cell.watchdog.as_ref().map(|path| {
            let opened = File::options().write(true).custom_flags(libc::O_NONBLOCK).open(path);
            opened.with_context(|| format!("watchdog {path}"))
        });
        let watchdog: Option<OwnedFd> = watchdog.transpose()?.map(OwnedFd::from);
        if lines.is_empty() && watchdog.is_none() {
            return Ok(None);
        }
        let guardian = Self::start(file.cell.guardian_config(), lines, watchdog.as_ref(), separate).inspect_err(|_| {
            // Opening a watchdog has started it. Without a guardian, nothing else would switch it off.
            if let Some(watchdog) = watchdog.as_ref().and_then(|watchdog| watchdog.try_clone().ok()) {
                let _ = File::from(watchdog).write_all(b"V");
            }
        });
        let guardian = guardian.context("guardian")?;
        if let Some(denied) = guardian.denied() {
            let told = format!("the host denies the guardian {denied}: it may act late or not at all");
            if file.cell.realtime.policy == Policy::Require {
                bail!("{told}; the cell requires it");
            }
            streams::warn(format_args!("mrroc: {told}; `mrroc doctor` names the settings"));
        }
        Ok(Some(guardian))
    }

    /// Starts a guardian and waits until it is ready. A ready guardian waits for the first completed cycle. The guardian
    /// inherits the descriptors of `lines` and `watchdog`, which the caller may close afterwards. A watchdog gets a byte per
    /// 100 ms, and the letter V at an orderly end.
    pub fn start(
        config: GuardianConfig,
        lines: &[GuardedLine],
        watchdog: Option<&OwnedFd>,
        separate: Option<&Path>,
    ) -> Result<Self, GuardianError> {
        let memory = |error: io::Error| GuardianError::Memory { errno: error.raw_os_error().unwrap_or(0) };
        let spawn = |error: io::Error| GuardianError::Spawn { errno: error.raw_os_error().unwrap_or(0) };
        let (ended, life) = io::pipe().map_err(spawn)?;
        let of_line = |line: &GuardedLine| LineOrders::new(line.line.as_raw_fd(), &line.telegram);
        let line_orders = lines.iter().map(of_line).collect::<Option<Vec<_>>>();
        let watchdog_descriptor = watchdog.map(AsRawFd::as_raw_fd);
        let orders = line_orders.and_then(|lines| Orders::new(&config, ended.as_raw_fd(), &lines, watchdog_descriptor));
        let orders = orders.ok_or(GuardianError::Lines { lines: lines.len() })?;
        let (file, words) = shared::create(&orders).map_err(memory)?;
        let given =
            [file.as_raw_fd(), ended.as_raw_fd()].into_iter().chain(lines.iter().map(|line| line.line.as_raw_fd()));
        let given: Vec<RawFd> = given.chain(watchdog_descriptor).collect();
        let process = match separate {
            None => Process::Child(Self::child(file.as_raw_fd(), given).map_err(spawn)?),
            Some(_) if given.len() > MOST_DESCRIPTORS => return Err(GuardianError::Lines { lines: lines.len() }),
            Some(socket) => {
                let connection =
                    |error: io::Error| GuardianError::Connection { errno: error.raw_os_error().unwrap_or(0) };
                Process::Separate(Connection::open(socket, &given).map_err(connection)?)
            }
        };
        let verdict = Arc::new(AtomicU8::new(FINE));
        let mut guardian = Self { words: Arc::new(words), process, life: Some(life), config, verdict, all_off: false };
        guardian.wait_until_ready()?;
        Ok(guardian)
    }

    /// Starts a guardian from the program of this process. `inherited` are its descriptors.
    fn child(memory: RawFd, inherited: Vec<RawFd>) -> io::Result<Child> {
        let mut command = Command::new("/proc/self/exe");
        command.arg0(NAME).env(VARIABLE, memory.to_string()).current_dir("/");
        command.stdin(Stdio::null()).stdout(Stdio::null());
        process::inherit(&mut command, inherited);
        command.spawn()
    }

    fn wait_until_ready(&mut self) -> Result<(), GuardianError> {
        let end = clock::now() + READY;
        while self.words.looks.load(Ordering::Acquire) == 0 {
            if self.process.is_over() {
                return Err(GuardianError::Ended);
            }
            if clock::now() >= end {
                return Err(GuardianError::NotReady { waited: READY });
            }
            clock::sleep_until(clock::now() + LOOK);
        }
        Ok(())
    }

    /// What the host denied to the guardian.
    fn denied(&self) -> Option<Denied> {
        Denied::of(self.words.denied.load(Ordering::Relaxed))
    }

    /// Process ID of the guardian.
    pub fn pid(&self) -> u32 {
        self.process.id()
    }

    /// The servo thread's end of the guardian. `stop` brakes all robots and switches them off.
    pub fn pulse(&self, stop: StopRequest) -> Pulse {
        let lost =
            LOST.max(self.config.silence.saturating_mul(LOST_SILENCES)).as_nanos() / self.config.period.as_nanos();
        Pulse {
            words: self.words.clone(),
            stop,
            verdict: self.verdict.clone(),
            cycles: self.words.cycles.load(Ordering::Relaxed),
            looks: 0,
            unchanged: 0,
            most_unchanged: u32::try_from(lost).unwrap_or(u32::MAX),
        }
    }

    /// The fault of a guardian that stopped the drives, or that is lost. A guardian that stopped the drives, or whose
    /// process has ended, stops the robots by `stop`. Not for the servo thread.
    pub fn look(&mut self, stop: &StopRequest) -> Option<GuardianFault> {
        if self.verdict.load(Ordering::Relaxed) == FINE {
            let found = if self.has_stopped_a_run() {
                STOPPED
            } else if self.process.is_over() {
                LOST_HEARTBEAT
            } else {
                return None;
            };
            // The first verdict stays.
            let _ = self.verdict.compare_exchange(FINE, found, Ordering::Relaxed, Ordering::Relaxed);
            stop.request();
        }
        self.fault()
    }

    /// Whether the guardian stopped the drives while the servo thread was to complete cycles. After the end of that
    /// thread, the guardian may stop drives without a fault of the run.
    fn has_stopped_a_run(&self) -> bool {
        let stopped = self.words.stops.load(Ordering::Acquire) > 0;
        stopped && self.words.phase.load(Ordering::Acquire) == Phase::Run as u32
    }

    /// The fault that was found so far.
    pub fn fault(&self) -> Option<GuardianFault> {
        match self.verdict.load(Ordering::Relaxed) {
            FINE => None,
            STOPPED => {
                let silence = Duration::from_micros(self.words.silence_us.load(Ordering::Relaxed));
                Some(GuardianFault::Stopped { silence })
            }
            _ => Some(GuardianFault::Lost { pid: self.pid() }),
        }
    }

    /// Tells the guardian that all drives report no power. The drives stay as they are when the guardian ends.
    pub fn all_off(&mut self) {
        self.all_off = true;
    }
}

impl Drop for Guardian {
    fn drop(&mut self) {
        let unused = self.words.cycles.load(Ordering::Relaxed) == 0;
        let phase = if self.all_off || unused { Phase::End } else { Phase::Stop };
        self.words.phase.store(phase as u32, Ordering::Release);
        let life = self.life.take();
        match self.process {
            // The end of the pipe ends the wait of the guardian.
            Process::Child(_) => drop(life),
            // The pipe ends with this process, and the service of the guardian after it.
            Process::Separate(_) => std::mem::forget(life),
        }
        let end = clock::now() + END;
        while !self.process.is_over() {
            if clock::now() >= end {
                // A suspended guardian cannot end by itself. A failure means that it has ended. A process that is not ours is
                // left to whom it belongs.
                if let Process::Child(child) = &mut self.process {
                    let _ = child.kill();
                    let _ = child.wait();
                }
                return;
            }
            clock::sleep_until(clock::now() + LOOK);
        }
    }
}

/// The servo thread's end of a guardian. Dropping this value announces the end of the cycles: the guardian then waits for
/// [`Guardian::all_off`] for a longer time.
#[derive(Debug)]
pub struct Pulse {
    words: Arc<Words>,
    stop: StopRequest,
    verdict: Arc<AtomicU8>,
    cycles: u64,
    /// Heartbeat word of the guardian at the last change.
    looks: u64,
    /// Number of cycles without a change.
    unchanged: u32,
    most_unchanged: u32,
}

impl Pulse {
    /// Tells the guardian that a servo cycle was completed, and checks the guardian. A guardian that stopped the drives or
    /// shows no heartbeat stops all robots. Makes no system call.
    pub fn beat(&mut self) {
        self.cycles += 1;
        self.words.cycles.store(self.cycles, Ordering::Release);
        let looks = self.words.looks.load(Ordering::Relaxed);
        self.unchanged = if looks == self.looks { self.unchanged.saturating_add(1) } else { 0 };
        self.looks = looks;
        let verdict = if self.words.stops.load(Ordering::Acquire) > 0 {
            STOPPED
        } else if self.unchanged > self.most_unchanged {
            LOST_HEARTBEAT
        } else {
            return;
        };
        // The first verdict stays.
        let _ = self.verdict.compare_exchange(FINE, verdict, Ordering::Relaxed, Ordering::Relaxed);
        self.stop.request();
    }
}

impl Drop for Pulse {
    fn drop(&mut self) {
        let words = &self.words.phase;
        let _ = words.compare_exchange(Phase::Run as u32, Phase::Leave as u32, Ordering::AcqRel, Ordering::Relaxed);
    }
}

/// Shortest silence without a key in the cell. An ordinary thread of a host without load wakes up within 2 ms.
const SHORTEST_SILENCE: Duration = Duration::from_millis(5);

/// Greatest silence that a cell file may give, ms.
pub(crate) const LONGEST_SILENCE_MS: f64 = 1000.0;

impl Cell {
    /// Times and priority of the guardian of the cell.
    ///
    /// The servo itself tolerates `max_missed_in_row` deadlines without a cycle, so two cycles may be one period more
    /// apart. Half a period more is the greatest lateness of a cycle that counts as punctual.
    pub fn guardian_config(&self) -> GuardianConfig {
        let period = self.period();
        let given = self.guardian_ms.map(|silence| Duration::from_millis(silence.into()));
        let longest = Duration::from_secs_f64(LONGEST_SILENCE_MS * 1e-3);
        let missed = period.saturating_mul(self.max_missed_in_row) + period * 3 / 2;
        GuardianConfig {
            silence: given.unwrap_or_else(|| missed.clamp(SHORTEST_SILENCE, longest)),
            period,
            priority: self.realtime.priority,
        }
    }
}

#[cfg(test)]
mod tests;
