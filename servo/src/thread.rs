//! The servo thread: waits for deadlines and steps the servo. No other part of this crate waits.
//!
//! **Deadlines** lie one period apart on `CLOCK_MONOTONIC`. With [`Wait::Plain`], the thread sleeps until the deadline
//! by an absolute `clock_nanosleep`, then prepares the cycle and sends. With [`Wait::Hybrid`], the thread sleeps until
//! a margin before the deadline, prepares the cycle, spins to the deadline and sends. The thread wakes earlier by the
//! learnt duration of the preparation, so SYNC is sent at the deadline.
//!
//! **A missed deadline** is counted and skipped, never caught up. A thread that is late by more than half a period skips
//! this slot and waits for the next slot. The time between two SYNCs is therefore never shorter than half a period.
//! [`Servo::missed`] describes the effect of too many missed deadlines. An emulated cell can avoid this effect: see
//! [`CellTime`].
//!
//! **A suspension** of the machine stops `CLOCK_MONOTONIC`, and no deadline passes. `CLOCK_BOOTTIME` continues. The
//! periods of the suspension count as missed deadlines. If this number exceeds the tolerated number, all effectors
//! stop.
//!
//! **A late cycle** is explained: [`Timing::late`] counts the causes and keeps the worst cycles. The clock is read
//! between the phases of a cycle. The kernel's account of the thread (`getrusage`, `/proc/thread-self/schedstat`) is
//! read in the slack after SYNC: after each late or disturbed cycle, and after one quiet cycle in 16. The reading in
//! quiet cycles separates their accumulated delays from the delay of one cycle. The phases of the cycles around the
//! worst cycle are kept, and also the phases of the cycles around a requested moment: see [`Finished::spikes`] and
//! [`start`].
//!
//! **Time** in the control laws is the nominal period, also in a late cycle. [`Record::dt`](crate::Record) holds the
//! real time.
//!
//! **The end** always switches the drives off. When `until` returns true, the thread requests a stop. Cycles continue
//! until every effector has braked and has no power, or until the longest time for stopping has passed. A panic of
//! `between` or `until` ends the run in the same way (category 1), and neither is called again. A panic of a cycle also
//! ends the run in this way. If another cycle panics during the stop, the thread switches the power off at once
//! (category 0). The thread also does so if the effectors have not braked within the longest time, because deadlines
//! were missed. [`Finished::panicked`] reports the panic, and the panic hook receives its message. If the process dies,
//! drives stop only by their own reaction to silence. For a drive without such a reaction, another process must stop the
//! drive.
//!
//! **A hang** of the thread is visible to its starter, because [`Running::cycles`] stands still. [`Running::leave`]
//! leaves the thread behind. A thread that comes back sends nothing, so drives react as to a silent host.
//!
//! **Real-time needs** are requested one by one: SCHED_FIFO or SCHED_DEADLINE, a CPU, locked memory, timer slack of 1
//! ns, and no deep idle states while the thread runs (`/dev/cpu_dma_latency`). Threads and processes that the servo
//! thread starts do not inherit the scheduling. The wait determines when the thread runs. Under SCHED_DEADLINE, the
//! kernel's period begins whenever the thread wakes, and only limits the processor time of the thread. Requests that
//! the host denies are returned as [`Denial`]s, which name the setting that grants the request. With
//! [`Policy::Require`] a denial refuses the start.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod account;
mod cause;
mod explain;
mod host;
mod late;
mod quantile;
mod realtime;
mod suspend;
mod tracer;
mod wait;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::task::Poll;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use can::Instant;
use can::clock::{now, since_boot, sleep_until};
use thiserror::Error;

use self::explain::{Before, LATE};
use self::quantile::LearntQuantile;
use self::suspend::SuspendWatch;
use crate::{CellState, NotUp, Servo, Timing};

pub use self::account::{Account, AccountReads};
pub use self::cause::{Cause, Spent, Usage};
pub use self::explain::GAP;
pub use self::host::{CpuLatency, Denial, Grant, LIMITS, Limit, demand, set_deadline, set_fifo};
pub use self::late::{LateCycle, LateCycles};
pub use self::realtime::{Policy, Realtime, Scheduler, Wait};
pub use self::tracer::{Spike, Stamps, Tracer};
pub use self::wait::{Awake, WaitReport, Waiter};

/// Bytes of the thread's stack; `MCL_FUTURE` locks all of it.
const STACK: usize = 512 * 1024;
/// Number of cycles that switch the power off after a second panic of a cycle.
const CUTS: u32 = 10;

/// Least number of cycles after the end of a run. A drive obeys the command of a cycle at the SYNC of the next, and the
/// answer is read one cycle later.
const OFF_CYCLES: u32 = 4;

/// Largest fraction of the period, given as a divisor, for the learnt duration of preparation. The bus needs the rest
/// to deliver the answers of the last cycle.
const LONGEST_PREPARATION: u32 = 20;

/// Longest time for the thread to lock its memory and to demand its scheduling.
const BEGIN: Duration = Duration::from_secs(30);

/// Longest time for the drives to report that they have no power, after the command.
pub const POWER_OFF_WAIT: Duration = Duration::from_millis(500);

/// The time that cycles are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellTime {
    /// `CLOCK_MONOTONIC`: for drives that follow the wall clock.
    Wall,
    /// The nominal time of each cycle, for an emulated cell; the value is the time of the first cycle. A host that
    /// delays the servo delays the emulators by the same time, so the emulated time stands still while deadlines are
    /// missed. Missed deadlines are counted and have no other effect.
    Nominal(Instant),
}

/// Why a servo thread did not start. No cycle ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum StartError {
    /// The policy requires a setting that the host denies.
    #[error("{0}")]
    Denied(Denial),
    #[error("the servo thread cannot be made (errno {errno})")]
    Spawn { errno: i32 },
    /// If the thread begins later, it ends without a cycle.
    #[error("the servo thread has not begun after {} s: check the load and the memory of the host", waited.as_secs())]
    Silent { waited: Duration },
}

/// A running servo thread. Dropping this value leaves the thread running.
#[derive(Debug)]
pub struct Running {
    thread: JoinHandle<Finished>,
    words: Arc<Words>,
}

/// What a servo thread and its starter share.
#[derive(Debug, Default)]
struct Words {
    /// Number of ended cycles.
    cycles: AtomicU64,
    /// The starter waits for the thread no longer.
    left: AtomicBool,
}

impl Running {
    /// Whether the thread has ended.
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// Number of ended cycles, with cycles that panicked. The number stands still if the thread hangs.
    pub fn cycles(&self) -> u64 {
        self.words.cycles.load(Ordering::Relaxed)
    }

    /// Leaves a thread behind that hangs. If the thread comes back, it sends nothing and ends. A call to the drives in
    /// which the thread hangs is completed.
    pub fn leave(self) {
        self.words.left.store(true, Ordering::Relaxed);
    }

    /// Waits for the end of the thread.
    pub fn join(self) -> Finished {
        // The thread catches every panic of the functions it calls.
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

/// Result of a servo thread.
pub struct Finished {
    /// The servo, its drives off.
    pub servo: Servo,
    /// Punctuality of the cycles.
    pub timing: Timing,
    /// The cycles around the cycles with the greatest lateness, the worst first, and around the last request.
    pub spikes: Vec<Spike>,
    /// The denied requests.
    pub denied: Vec<Denial>,
    /// The panic that ended the run, if any.
    pub panicked: Option<Panicked>,
}

/// The source of a panic in a servo thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Panicked {
    /// `between` or `until`: the effectors were braked, then switched off (category 1).
    Caller,
    /// One cycle, or a drive in it: the effectors were braked, then switched off (category 1).
    Cycle,
    /// Two cycles: the stop after the first panic panicked too. The power was switched off at once (category 0).
    TwoCycles,
}

impl std::fmt::Debug for Finished {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Finished")
            .field("counters", &self.servo.counters())
            .field("timing", &self.timing)
            .field("denied", &self.denied)
            .field("panicked", &self.panicked)
            .finish_non_exhaustive()
    }
}

/// Polls the bring-up of every group once a period on the calling thread. After each poll, `between` is called with
/// the time of the next one.
///
/// The function ends because every wait inside a group's bring-up ends. A stop request ends it at once.
pub fn bring_up(servo: &mut Servo, mut between: impl FnMut(Instant)) -> Result<(), NotUp> {
    let mut deadline = now();
    loop {
        let progress = servo.bring_up(now());
        deadline += servo.period();
        between(deadline);
        if let Poll::Ready(result) = progress {
            return result;
        }
        sleep_until(deadline);
    }
}

/// Starts a thread that steps `servo` until `until` returns true after a cycle.
///
/// `between` is called with the next deadline in the slack after each cycle. An emulated bench advances its world
/// there. Time that `between` and `until` take beyond the slack is attributed to [`Cause::BetweenCycles`]. Setting
/// `trace_request`, now or later, keeps the cycles around that moment among [`Finished::spikes`], and the thread
/// clears the flag.
pub fn start(
    servo: Servo,
    realtime: Realtime,
    time: CellTime,
    trace_request: Arc<AtomicBool>,
    between: impl FnMut(Instant) + Send + 'static,
    until: impl FnMut(&Servo) -> bool + Send + 'static,
) -> Result<Running, StartError> {
    let (tell, told) = sync_channel(1);
    let words = Arc::new(Words::default());
    let shared = Arc::clone(&words);
    let body = move || {
        let mut run = Run::new(servo, &realtime, time, trace_request, shared);
        let mut denied = demand(&realtime, run.period);
        let latency = CpuLatency::demand();
        denied.extend(latency.as_ref().err());
        let refused = realtime.policy == Policy::Require && !denied.is_empty();
        // The starter waits for this message. Without a starter, no caller could stop the thread.
        let heard = tell.send(denied.first().copied()).is_ok();
        if !refused && heard {
            run.go(between, until);
        }
        Finished { servo: run.servo, timing: run.timing, spikes: run.tracer.finish(), denied, panicked: run.panicked }
    };
    let spawned = Builder::new().name("servo".into()).stack_size(STACK).spawn(body);
    let thread = spawned.map_err(|e| StartError::Spawn { errno: e.raw_os_error().unwrap_or(0) })?;
    let running = Running { thread, words };
    match first_denial(&told, BEGIN) {
        Err(silent) => {
            running.leave();
            Err(silent)
        }
        Ok(Some(denial)) if realtime.policy == Policy::Require => {
            // It has nothing to do; with it the servo goes, and every port is closed.
            drop(running.join());
            Err(StartError::Denied(denial))
        }
        Ok(_) => Ok(running),
    }
}

/// The first denied request of a thread that begins within `longest`.
fn first_denial(told: &Receiver<Option<Denial>>, longest: Duration) -> Result<Option<Denial>, StartError> {
    match told.recv_timeout(longest) {
        Err(RecvTimeoutError::Timeout) => Err(StartError::Silent { waited: longest }),
        told => Ok(told.unwrap_or_default()),
    }
}

/// [`start`] and [`Running::join`] in one, without traces on request.
pub fn run(
    servo: Servo,
    realtime: Realtime,
    time: CellTime,
    between: impl FnMut(Instant) + Send + 'static,
    until: impl FnMut(&Servo) -> bool + Send + 'static,
) -> Result<Finished, StartError> {
    start(servo, realtime, time, Arc::default(), between, until).map(Running::join)
}

struct Run {
    servo: Servo,
    words: Arc<Words>,
    timing: Timing,
    panicked: Option<Panicked>,
    period: Duration,
    waiter: Waiter,
    suspend: SuspendWatch,
    /// Reads `CLOCK_BOOTTIME`.
    since_boot: fn() -> Instant,
    /// Duration of preparation, if the wake-up follows it.
    preparation: Option<LearntQuantile>,
    /// Deadline of the next cycle, on the wall clock.
    deadline: Instant,
    first: Instant,
    time: CellTime,
    /// Number of the next cycle.
    number: u64,
    account: Account,
    tracer: Tracer,
    /// Learnt bound that all but one in 1000 steps keep.
    usual: LearntQuantile,
    before: Before,
    /// Lateness at the skipped slots, and the use of the time before.
    skipped: Option<(Duration, Spent)>,
}

impl Run {
    fn new(servo: Servo, realtime: &Realtime, time: CellTime, request: Arc<AtomicBool>, words: Arc<Words>) -> Self {
        let period = servo.period();
        let timing = Timing::default();
        Self {
            servo,
            words,
            timing,
            panicked: None,
            period,
            waiter: Waiter::new(realtime, period),
            suspend: SuspendWatch::default(),
            since_boot,
            preparation: (realtime.wait != Wait::Plain)
                .then(|| LearntQuantile::new(Duration::ZERO, period / LONGEST_PREPARATION)),
            deadline: Instant::ZERO,
            first: Instant::ZERO,
            time,
            number: 0,
            account: Account::open(),
            tracer: Tracer::new(request),
            usual: LearntQuantile::new(Duration::ZERO, period / 2),
            before: Before::default(),
            skipped: None,
        }
    }

    fn go(&mut self, mut between: impl FnMut(Instant), mut until: impl FnMut(&Servo) -> bool) {
        let begun = now();
        self.deadline = begun + self.period;
        self.first = self.deadline;
        (self.before.sync, self.before.done, self.before.called) = (begun, begun, begun);
        let mut over = false;
        while !over && self.cycle() {
            let caller = catch_unwind(AssertUnwindSafe(|| {
                between(self.next());
                until(&self.servo)
            }));
            over = caller.unwrap_or_else(|_| {
                self.panicked = Some(Panicked::Caller);
                true
            });
        }
        self.wind_down(between);
        let ended = matches!(self.servo.cell_state(), CellState::Off | CellState::Held);
        if self.panicked == Some(Panicked::TwoCycles) || !ended {
            self.cut_power();
        }
        self.timing.account = self.account.reads;
        self.timing.wait = WaitReport { preparation: self.preparation(), ..self.waiter.report() };
    }

    /// Whether the starter waits for this thread no longer.
    fn is_left(&self) -> bool {
        self.words.left.load(Ordering::Relaxed)
    }

    fn preparation(&self) -> Duration {
        self.preparation.map_or(Duration::ZERO, |learnt| learnt.get())
    }

    /// Waits for the deadline and steps the servo; false if the step panicked, or if the starter waits no longer.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    fn cycle(&mut self) -> bool {
        let begun = now();
        let awake = self.wait(begun);
        self.check_suspension();
        let stepped = catch_unwind(AssertUnwindSafe(|| self.step(begun, &awake)));
        self.deadline += self.period;
        self.number += 1;
        if let CellTime::Nominal(next) = &mut self.time {
            *next += self.period;
        }
        if stepped.is_err() {
            self.servo.cycle_panicked();
            self.panicked = Some(match self.panicked {
                None | Some(Panicked::Caller) => Panicked::Cycle,
                Some(Panicked::Cycle | Panicked::TwoCycles) => Panicked::TwoCycles,
            });
        }
        self.before.called = now();
        self.words.cycles.fetch_add(1, Ordering::Relaxed);
        stepped.is_ok() && !self.is_left()
    }

    fn step(&mut self, begun: Instant, awake: &Awake) {
        if self.is_left() {
            return;
        }
        let reading = now();
        let due = self.cell_time(self.deadline.max(reading));
        self.servo.read(due);
        let read = now();
        self.servo.compute(due);
        let computed = now();
        if self.is_left() {
            return;
        }
        self.servo.write(due);
        let written = now();
        let (sending, gap) = self.waiter.spin(written, self.deadline);
        if self.is_left() {
            return;
        }
        self.servo.send(self.cell_time(sending));
        let done = now();
        // SYNC has left, and the rest runs in the slack.
        let (preparation, transfer) = (written.since(reading), done.since(sending));
        if let Some(learnt) = &mut self.preparation {
            learnt.observe(preparation);
        }
        self.timing.sync.record(sending.since(self.deadline));
        self.timing.step.record(preparation + transfer);
        self.timing.record_bus(&self.servo);
        self.servo.note_timing(due, sending.since(self.deadline), preparation + transfer);
        let before = self.waited(begun, awake);
        let spent = Spent {
            own: before.own + computed.since(read),
            bus: before.bus + read.since(reading) + written.since(computed),
            gap: before.gap.max(gap).max(reading.since(awake.at)),
            ..before
        };
        let late = sending.since(self.deadline);
        let late = self.explain(late, &spent, preparation + transfer);
        let (cycle, deadline, called, awake) = (self.number, self.deadline, self.before.called, *awake);
        let stamps =
            Stamps { cycle, deadline, called, begun, awake, reading, read, computed, written, sending, done, late };
        self.tracer.record(stamps);
        (self.before.sync, self.before.done) = (sending, done);
    }

    /// The time of the cycle, for `wall` on the wall clock.
    fn cell_time(&self, wall: Instant) -> Instant {
        match self.time {
            CellTime::Wall => wall,
            CellTime::Nominal(cycle) => cycle,
        }
    }

    /// Due time of the next cycle, in the time of the cycles.
    fn next(&self) -> Instant {
        self.cell_time(self.deadline)
    }

    /// Waits until it is time to prepare for the deadline. A deadline passed by half a period or more is skipped.
    fn wait(&mut self, begun: Instant) -> Awake {
        if begun < self.deadline - self.preparation() && begun.since(self.before.done) > self.period / LATE {
            // The kernel's counts during the caller's work made no cycle late.
            self.account.skip();
        }
        loop {
            let preparation = self.preparation();
            let awake = self.waiter.wait(self.deadline - preparation, preparation);
            if let Some(latency) = awake.wake_up_latency() {
                self.timing.wake_up.record(latency);
            }
            let late = awake.at.since(self.deadline);
            if late <= self.period / 2 {
                return awake;
            }
            // After a cycle that was equally late, there is no time to sleep, and that lateness was already counted.
            let inherited = awake.wake_up_latency().is_none() && self.before.late >= late / 2;
            if !inherited && self.skipped.is_none_or(|(before, _)| late > before) {
                self.skipped = Some((late, self.waited(begun, &awake)));
            }
            let slots = (late - self.period / 2).as_nanos() / self.period.as_nanos() + 1;
            let slots = u32::try_from(slots).unwrap_or(u32::MAX);
            self.count_missed(slots);
            self.deadline += self.period.saturating_mul(slots);
        }
    }

    /// Counts the periods of a suspension of the machine as missed deadlines, which the clock of the deadlines does not
    /// show.
    fn check_suspension(&mut self) {
        let before = now();
        let boot = (self.since_boot)();
        let asleep = self.suspend.observe(before, boot, now());
        let slots = (asleep + self.period / 2).as_nanos() / self.period.as_nanos();
        if slots > 0 {
            self.count_missed(u32::try_from(slots).unwrap_or(u32::MAX));
        }
    }

    fn count_missed(&mut self, slots: u32) {
        match self.time {
            CellTime::Wall => self.servo.missed(slots),
            CellTime::Nominal(_) => self.servo.slipped(slots),
        }
    }

    /// Brakes all effectors and switches them off, unless two cycles panic. The emulated world continues if possible.
    fn wind_down(&mut self, mut between: impl FnMut(Instant)) {
        if self.is_left() {
            return;
        }
        self.servo.stop_request().request();
        let mut alive = self.panicked != Some(Panicked::Caller);
        let end = self.deadline + self.servo.longest_stop() + POWER_OFF_WAIT;
        let mut cycles = 0;
        while (cycles < OFF_CYCLES || self.servo.cell_state() != CellState::Off) && self.deadline < end {
            if !self.cycle() && (self.is_left() || self.panicked == Some(Panicked::TwoCycles)) {
                return;
            }
            cycles += 1;
            if alive && catch_unwind(AssertUnwindSafe(|| between(self.next()))).is_err() {
                self.panicked = self.panicked.or(Some(Panicked::Caller));
                alive = false;
            }
        }
    }

    /// Switches off the power of every axis, period by period. If this panics too, the drives react to silence.
    fn cut_power(&mut self) {
        for _ in 0..CUTS {
            sleep_until(self.deadline);
            if self.is_left() {
                return;
            }
            let _ = catch_unwind(AssertUnwindSafe(|| {
                self.servo.cut_power(self.cell_time(now()));
            }));
            self.deadline += self.period;
            if let CellTime::Nominal(next) = &mut self.time {
                *next += self.period;
            }
        }
    }
}

#[cfg(test)]
mod tests;
