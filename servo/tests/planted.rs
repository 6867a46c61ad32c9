//! Delays inserted into single cycles are attributed to their causes.
//!
//! Only cycles with an inserted delay are judged, and by their share, because the host of a test may delay others. The
//! tests need SCHED_FIFO up to priority 90. `MRROC_LEAVE_OUT=realtime` skips the cases that need it.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use can::clock::{now, sleep_until};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};
use mrroc_servo::thread::{self, Cause, CellTime, LateCycle, Realtime, Spike};
use mrroc_servo::*;

use crate::{alone, scripted};

/// The inserted delay: less than half a period, so that no slot is skipped.
const DELAY: Duration = Duration::from_micros(450);
/// An inserted delay that skips one slot. Its rest makes the next cycle late.
const LONG_DELAY: Duration = Duration::from_micros(1300);
/// Time before the deadline at which a wake-up is disturbed, while the thread sleeps.
const EARLY: Duration = Duration::from_micros(300);
/// Cycles between two inserted delays, and number of delays in one run. The tracer keeps the eight worst cycles, and a
/// skipped slot counts as two.
const EVERY: u64 = 20;
const PER_RUN: u64 = 3;
const RUNS: u64 = 14;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Plant {
    FloodedStep,
    SlowCounters,
    SlowBetween,
    SlowUntil,
    SpinningBus,
    BlockingBus,
    PageFaults,
    PreemptedStep,
    StarvedWakeUp,
    LongStarvedWakeUp,
    LongSleep,
}

/// The thread to delay, and the begin and end of the delay.
type HoldUp = (libc::pthread_t, Instant, Instant);

/// Time at which the handler of SIGUSR2 returns, ns.
static ASLEEP_UNTIL: AtomicU64 = AtomicU64::new(0);

/// Makes the interrupted thread oversleep.
extern "C" fn oversleep(_: libc::c_int) {
    sleep_until(Instant::from_nanos(ASLEEP_UNTIL.load(Ordering::Relaxed)));
}

/// Makes threads oversleep on request. With SCHED_FIFO, other threads of the host do not delay requests.
#[expect(unsafe_code, reason = "signals are the system's")]
fn stopper(orders: Receiver<HoldUp>) {
    // SAFETY: the handler reads an atomic number and the clock, and sleeps.
    unsafe { libc::signal(libc::SIGUSR2, oversleep as *const () as libc::sighandler_t) };
    let _ = thread::set_fifo(90);
    for (thread, from, to) in orders {
        ASLEEP_UNTIL.store(to.as_nanos(), Ordering::Relaxed);
        sleep_until(from);
        // SAFETY: the thread still runs cycles after the last request, or waits for its end.
        unsafe { libc::pthread_kill(thread, libc::SIGUSR2) };
    }
}

#[expect(unsafe_code, reason = "the thread's handle is the system's to tell")]
fn this_thread() -> libc::pthread_t {
    // SAFETY: the call takes no argument and touches no memory.
    unsafe { libc::pthread_self() }
}

fn is_planted(cycle: u64) -> bool {
    cycle % EVERY == EVERY / 2
}

fn spin_until(end: Instant) {
    while now() < end {
        std::hint::spin_loop();
    }
}

/// A drive group that delays a cycle.
struct Delaying {
    inner: Box<dyn DriveGroup>,
    plant: Plant,
    cycle: u64,
    /// Time of the delay.
    due: Instant,
    pages: Pages,
    hog: Sender<HoldUp>,
}

impl DriveGroup for Delaying {
    fn axes(&self) -> usize {
        self.inner.axes()
    }

    fn delay(&self) -> usize {
        self.inner.delay()
    }

    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        self.inner.bring_up(now)
    }

    fn wait(&mut self, now: Instant) {
        self.inner.wait(now);
    }

    fn read(&mut self, at: Instant, states: &mut [AxisState]) {
        self.inner.read(at, states);
        if is_planted(self.cycle) {
            let end = now() + DELAY;
            match self.plant {
                Plant::SpinningBus => spin_until(end),
                Plant::BlockingBus => sleep_until(end),
                Plant::PageFaults => self.pages.touch_until(end),
                Plant::PreemptedStep => {
                    let order = (this_thread(), now(), end);
                    self.hog.send(order).expect("the hog listens");
                }
                Plant::FloodedStep
                | Plant::SlowCounters
                | Plant::SlowBetween
                | Plant::SlowUntil
                | Plant::StarvedWakeUp
                | Plant::LongStarvedWakeUp
                | Plant::LongSleep => {}
            }
        }
    }

    fn write(&mut self, at: Instant, commands: &[AxisCommand]) {
        self.inner.write(at, commands);
    }

    fn send(&mut self, at: Instant) -> bool {
        self.cycle += 1;
        self.due = at + scripted::PERIOD;
        let delay = match self.plant {
            Plant::StarvedWakeUp => Some(DELAY),
            Plant::LongStarvedWakeUp | Plant::LongSleep => Some(LONG_DELAY),
            _ => None,
        };
        if let Some(delay) = delay.filter(|_| is_planted(self.cycle)) {
            let order = (this_thread(), self.due - EARLY, self.due + delay);
            self.hog.send(order).expect("the hog listens");
        }
        if self.plant == Plant::PageFaults {
            self.pages.forget();
        }
        self.inner.send(at)
    }

    fn counters(&self) -> GroupCounters {
        if self.plant == Plant::SlowCounters && is_planted(self.cycle) {
            spin_until(self.due + DELAY);
        }
        self.inner.counters()
    }
}

/// Shared pages that are resident but not in the page table. The first access to each page causes a fault, which
/// allocates no page.
struct Pages(usize);

impl Pages {
    const BYTES: usize = 32 << 20;

    #[expect(unsafe_code, reason = "pages are the kernel's")]
    fn new() -> Self {
        // SAFETY: a new mapping, which no other code uses.
        let start = unsafe {
            let start = libc::mmap(
                std::ptr::null_mut(),
                Self::BYTES,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED | libc::MAP_ANONYMOUS | libc::MAP_POPULATE,
                -1,
                0,
            );
            assert_ne!(start, libc::MAP_FAILED);
            assert_eq!(libc::madvise(start, Self::BYTES, libc::MADV_DONTNEED), 0);
            start
        };
        Self(start as usize)
    }

    #[expect(unsafe_code, reason = "pages are the kernel's")]
    fn touch_until(&mut self, end: Instant) {
        for page in (self.0..self.0 + Self::BYTES).step_by(4096) {
            // SAFETY: the page belongs to the mapping, which lives as long as this value.
            unsafe { (page as *mut u8).write_volatile(1) };
            if now() >= end {
                break;
            }
        }
    }

    #[expect(unsafe_code, reason = "pages are the kernel's")]
    fn forget(&mut self) {
        // SAFETY: the content of the mapping is not needed any more.
        let done = unsafe { libc::madvise(self.0 as *mut _, Self::BYTES, libc::MADV_DONTNEED) };
        assert_eq!(done, 0, "the mapping is not locked");
    }
}

impl Drop for Pages {
    #[expect(unsafe_code, reason = "pages are the kernel's")]
    fn drop(&mut self) {
        // SAFETY: no other code uses the mapping.
        unsafe { libc::munmap(self.0 as *mut _, Self::BYTES) };
    }
}

/// A thread of a higher priority than the servo's on the same CPU, which takes the CPU for given intervals.
fn hog(cpu: usize, orders: Receiver<HoldUp>) {
    let realtime = Realtime { priority: 90, cpu: Some(cpu), lock_memory: false, ..Realtime::PLAIN };
    assert_eq!(thread::demand(&realtime, scripted::PERIOD), [], "the hog needs them");
    for (_, from, to) in orders {
        sleep_until(from);
        spin_until(to);
    }
}

/// Number of orders that a servo needs [`DELAY`] to execute in one step.
fn flood() -> usize {
    const ORDERS: usize = 10_000;
    let mut config = scripted::config(2);
    config.effectors[0].queue = ORDERS;
    let (mut servo, mut links) = Servo::new(&config, vec![scripted::group(2).0]).expect("the configuration is sound");
    let mut step = || {
        for _ in 0..ORDERS {
            let pushed = links[0].orders.push(Order::ResetFault);
            pushed.expect("the step before carried out all");
        }
        let begun = now();
        servo.compute(begun);
        now().since(begun)
    };
    let least = (0..5).map(|_| step()).min().unwrap_or(DELAY);
    (ORDERS as u128 * DELAY.as_nanos() / least.as_nanos()) as usize
}

/// Number of delayed cycles attributed to `cause`, and number of all delayed cycles.
fn plant(plant: Plant, cause: Cause) -> (u64, u64) {
    let (mut right, mut planted) = (0, 0);
    let flood = flood();
    for _ in 0..RUNS {
        let mut config = scripted::config(2);
        config.max_missed_in_row = u32::MAX;
        config.effectors[0].queue = flood;
        let (inner, world) = scripted::group(2);
        world.lock().expect("nobody else has it yet").log = false;
        let (tell, told) = channel();
        let group = Delaying { inner, plant, cycle: 0, due: Instant::ZERO, pages: Pages::new(), hog: tell };
        let (servo, mut links) = Servo::new(&config, vec![Box::new(group)]).expect("the configuration is sound");
        let cpu = current_cpu();
        let hog = match plant {
            Plant::PreemptedStep | Plant::StarvedWakeUp | Plant::LongStarvedWakeUp => {
                Some(std::thread::spawn(move || hog(cpu, told)))
            }
            Plant::LongSleep => Some(std::thread::spawn(move || stopper(told))),
            _ => None,
        };
        // Waits until the hog waits.
        sleep_until(now() + Duration::from_millis(20));
        let realtime = Realtime {
            cpu: Some(cpu),
            lock_memory: false,
            margin: Some(Duration::from_micros(100)),
            ..Realtime::default()
        };
        let mut next_cycle = 0;
        let between = move |next: Instant| {
            next_cycle += 1;
            match plant {
                Plant::FloodedStep if is_planted(next_cycle) => {
                    while links[0].orders.push(Order::ResetFault).is_ok() {}
                }
                Plant::SlowBetween if is_planted(next_cycle) => spin_until(next + DELAY),
                _ => {}
            }
        };
        let mut cycles = 0;
        let until = move |_: &Servo| {
            cycles += 1;
            if plant == Plant::SlowUntil && is_planted(cycles) {
                spin_until(now() + scripted::PERIOD + DELAY);
            }
            cycles == EVERY * PER_RUN
        };
        let finished = thread::run(servo, realtime, CellTime::Wall, between, until).expect("nothing is required");
        let late = finished.timing.late;
        finished.spikes.iter().for_each(traced);
        let is_traced = |late: &LateCycle| {
            let mut cycles = finished.spikes.iter().flat_map(|spike| &spike.cycles);
            cycles.any(|one| one.late == Some(*late))
        };
        let named = |cycle| {
            let mut of_cycle = late.worst().filter(|one| one.cycle == cycle);
            let worst = of_cycle.next();
            worst.is_some_and(|one| one.cause == cause && is_traced(&one)) && of_cycle.all(|one| one.cause == cause)
        };
        right += (0..EVERY * PER_RUN).filter(|&cycle| is_planted(cycle) && named(cycle)).count() as u64;
        planted += PER_RUN;
        drop(finished.servo);
        if let Some(hog) = hog {
            hog.join().expect("SCHED_FIFO 90 on the servo's CPU is granted");
        }
    }
    (right, planted)
}

/// Checks the recording of a spike: the late cycle and the cycles around it are present, and each phase begins at the
/// end of the previous phase.
fn traced(spike: &Spike) {
    let late = spike.late.expect("nobody asked for one");
    let cycles = &spike.cycles;
    let place = cycles.iter().position(|one| one.cycle == late.cycle);
    let place = place.expect("the late cycle is in it");
    assert_eq!(cycles[place].late, Some(late));
    // The run ends with some further cycles.
    assert!(place >= 40.min(late.cycle as usize) && cycles.len() - place <= 17);
    let mut end = Instant::ZERO;
    for (number, cycle) in (cycles[0].cycle..).zip(cycles) {
        assert_eq!(cycle.cycle, number);
        assert!(end <= cycle.called && cycle.called <= cycle.begun, "{cycle:?}");
        end = cycle.begun;
        for (phase, ended) in cycle.phases() {
            assert!(end <= ended, "{phase}: {cycle:?}");
            end = ended;
        }
        assert_eq!(end, cycle.done);
        assert!(cycle.sending >= cycle.deadline, "{cycle:?}");
        let sync_late = cycle.sending.since(cycle.deadline);
        let words = cycle.late.map_or(Duration::ZERO, |late| late.late);
        assert!(words >= sync_late || sync_late <= scripted::PERIOD / 100);
    }
}

#[expect(unsafe_code, reason = "the current CPU is the kernel's to tell")]
fn current_cpu() -> usize {
    // SAFETY: the call takes no argument and touches no memory.
    unsafe { libc::sched_getcpu() }.max(0) as usize
}

/// Greatest number of attempts of one case.
const ATTEMPTS: usize = 8;

/// Time that the hypervisor has taken from all processors, in ticks.
fn stolen() -> u64 {
    let stat = std::fs::read_to_string("/proc/stat").expect("Linux");
    let fields = stat.lines().next().expect("the line of all processors").split_whitespace();
    fields.skip(1).nth(7).and_then(|ticks| ticks.parse().ok()).expect("a count of ticks")
}

/// Checks that nine of ten delayed cycles have the right cause, at the second attempt at the latest. An attempt from which
/// the hypervisor took time does not count, unless it is the last one of [`ATTEMPTS`].
fn check(cases: &[(Plant, Cause)]) {
    let _alone = alone();
    for &(planted, cause) in cases {
        let (mut seen, mut wrong) = (Vec::new(), 0);
        loop {
            let before = stolen();
            let (right, of) = plant(planted, cause);
            if 10 * right >= 9 * of {
                break;
            }
            let taken = stolen() - before;
            seen.push((right, of, taken));
            wrong += usize::from(taken == 0);
            assert!(
                wrong < 2 && seen.len() < ATTEMPTS,
                "{planted:?}: named {cause:?} in (number, of planted cycles, stolen ticks) {seen:?}"
            );
            sleep_until(now() + Duration::from_secs(1));
        }
    }
}

#[test]
fn what_the_thread_does_itself_and_an_overslept_wake_up_are_named() {
    check(&[
        (Plant::FloodedStep, Cause::OwnStep),
        (Plant::SlowCounters, Cause::OwnStep),
        (Plant::SlowBetween, Cause::BetweenCycles),
        (Plant::SlowUntil, Cause::BetweenCycles),
        (Plant::SpinningBus, Cause::Bus),
        (Plant::BlockingBus, Cause::Bus),
        (Plant::PageFaults, Cause::PageFault),
        // The rest of the delay after the skipped slot is no work of the thread.
        (Plant::LongSleep, Cause::LateWakeUp),
    ]);
}

#[test]
fn a_thread_that_takes_the_cpu_is_named() {
    let left_out = std::env::var("MRROC_LEAVE_OUT").unwrap_or_default();
    if left_out.split(',').any(|part| part == "realtime") {
        println!("left out: realtime");
        return;
    }
    let denied = std::thread::spawn(|| thread::set_fifo(90)).join().expect("it does not panic");
    assert_eq!(denied, Ok(()), "grant it, or leave it out: MRROC_LEAVE_OUT=realtime");
    check(&[
        (Plant::PreemptedStep, Cause::Preempted),
        // The thread was ready at the requested time, but another thread ran.
        (Plant::StarvedWakeUp, Cause::Preempted),
        (Plant::LongStarvedWakeUp, Cause::Preempted),
    ]);
}
