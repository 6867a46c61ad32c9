//! The process of a guardian: its states, its loop, and its start before `main`.
//!
//! | state | the guardian | left by |
//! |---|---|---|
//! | waiting | looks at the counter | the first completed cycle |
//! | watching | looks at the counter | the permitted silence |
//! | stopping | writes the telegrams at each look | a completed cycle: watching |
//! | last telegrams | writes the telegrams at each look, 20 times | the 20th time: over |
//! | over | ends | |
//!
//! In every state, the controller's order to end leads to over. The end of the controller's process, or the
//! controller's order to stop, leads from every state but over to the last telegrams. [`State::next`] is the transition
//! function.
//!
//! A hardware watchdog gets one byte per [`WATCHDOG`] while the guardian is waiting or watching. At an orderly end, the
//! watchdog gets the letter V, which switches the watchdog off. After every other end, the watchdog expires. In a state
//! without bytes, the watchdog expires if the state lasts longer than its time-out.
//!
//! The loop does not allocate. A round writes one telegram per line and does not wait. Before the first telegram,
//! unsent bytes of a line are discarded. A line that is still sending the previous telegram does not get another
//! telegram.

#![expect(unsafe_code, reason = "system calls before main, without the standard library")]

use std::io;
use std::os::fd::RawFd;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::shared::{Denied, LineOrders, Orders, Phase, Words};

/// Rounds of telegrams after the end of the controller.
const LAST_ROUNDS: u32 = 20;

/// Permitted silence between the end of the servo thread and the order to end.
const LEAVING: Duration = Duration::from_millis(500);

/// Interval of bytes to a hardware watchdog.
const WATCHDOG: Duration = Duration::from_millis(100);

/// States of a guardian. Times are on `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// No cycle was completed.
    Waiting,
    /// `cycles` were completed, the last one was seen at `since`.
    Watching { cycles: u64, since: Duration },
    /// The drives are being stopped, `since` as before.
    Stopping { cycles: u64, since: Duration },
    /// The last telegrams, of which `rounds` were begun.
    Last { rounds: u32 },
    /// The guardian ends.
    Over,
}

/// What a guardian sees at a look.
#[derive(Clone, Copy, Debug)]
struct Seen {
    cycles: u64,
    phase: Phase,
    /// The process of the controller has ended.
    alone: bool,
}

impl State {
    /// The state after a look at `now`.
    fn next(self, seen: Seen, now: Duration, silence: Duration) -> Self {
        let silence = match (seen.phase, seen.alone, self) {
            (_, _, Self::Over) | (Phase::End, _, _) => return Self::Over,
            (Phase::Stop, _, _) | (_, true, _) | (_, _, Self::Last { .. }) => return self.next_last(),
            (Phase::Leave, false, _) => silence.max(LEAVING),
            (Phase::Run, false, _) => silence,
        };
        match self {
            Self::Waiting if seen.cycles == 0 => self,
            Self::Watching { cycles, since } if cycles == seen.cycles => {
                if now.saturating_sub(since) < silence {
                    self
                } else {
                    Self::Stopping { cycles, since }
                }
            }
            Self::Stopping { cycles, .. } if cycles == seen.cycles => self,
            _ => Self::Watching { cycles: seen.cycles, since: now },
        }
    }

    fn next_last(self) -> Self {
        match self {
            Self::Last { rounds: LAST_ROUNDS.. } => Self::Over,
            Self::Last { rounds } => Self::Last { rounds: rounds + 1 },
            _ => Self::Last { rounds: 1 },
        }
    }

    /// Whether the guardian writes telegrams in this state.
    fn stops(self) -> bool {
        matches!(self, Self::Stopping { .. } | Self::Last { .. })
    }
}

/// Lets `command` inherit `descriptors` under their numbers.
pub(super) fn inherit(command: &mut Command, descriptors: Vec<RawFd>) {
    let keep = move || {
        for descriptor in &descriptors {
            // SAFETY: the call takes plain integers; the parent keeps the descriptors open until the child runs.
            if unsafe { libc::fcntl(*descriptor, libc::F_SETFD, 0) } < 0 {
                return Err(io::Error::last_os_error());
            }
        }
        Ok(())
    };
    // SAFETY: between fork and exec only async-signal-safe calls are made, and nothing is allocated.
    unsafe { command.pre_exec(keep) };
    // The function must be in every program that can start a guardian.
    std::hint::black_box(ENTRY);
}

/// The loader calls this function before `main`.
#[used]
#[unsafe(link_section = ".init_array")]
static ENTRY: extern "C" fn() = entry;

/// Turns a process with the variable of a guardian into a guardian. Other processes continue with `main`.
extern "C" fn entry() {
    // SAFETY: the name is a string with an end, and no other thread exists that could change the environment.
    let given = unsafe { libc::getenv(c"MRROC_GUARDIAN".as_ptr()) };
    if given.is_null() {
        return;
    }
    // SAFETY: a value of the environment is a string with an end.
    let memory = unsafe { libc::atoi(given) };
    let status = guard(memory);
    // SAFETY: ends the process; no destructor is needed.
    unsafe { libc::_exit(status) }
}

/// Exit status of a process that got no orders.
const NO_ORDERS: i32 = 2;

/// Messages on the standard error of the controller. A controller that was killed cannot report, and a controller that
/// hangs reports later.
const CONTROLLER_ENDED: &str = "mrroc: the controller has ended without switching its drives off: the guardian put all \
     drives that it guards into their error state; the next run brings them up\n";
const NO_ORDERS_GIVEN: &str =
    "mrroc: MRROC_GUARDIAN is set, but no controller has started this process as its guardian: unset it\n";
const NO_CYCLE: &str = "mrroc: no servo cycle: the guardian put all drives that it guards into their error state\n";

/// Writes a message to standard error, unless that would wait.
fn tell(message: &str) {
    let mut writable = libc::pollfd { fd: libc::STDERR_FILENO, events: libc::POLLOUT, revents: 0 };
    // SAFETY: one valid pollfd, and a write that reads as many bytes as stated. A pipe that is writable has room for a
    // page, which is longer than the messages.
    unsafe {
        if libc::poll(&raw mut writable, 1, 0) == 1 && writable.revents & libc::POLLOUT != 0 {
            libc::write(libc::STDERR_FILENO, message.as_ptr().cast(), message.len());
        }
    }
}

/// Guards the lines of the orders in the memory file `memory` until the end. Returns the exit status.
fn guard(memory: RawFd) -> i32 {
    // An ordinary file under this number is not mapped before its orders are checked.
    let given = Orders::read(memory).and_then(|orders| Some((orders, Words::map(memory).ok()?)));
    let Some((orders, words)) = given else {
        tell(NO_ORDERS_GIVEN);
        return NO_ORDERS;
    };
    words.denied.store(detach(&orders), Ordering::Relaxed);
    let mut state = State::Waiting;
    let mut watchdog = Watchdog { descriptor: orders.watchdog, due: Duration::ZERO };
    loop {
        words.looks.fetch_add(1, Ordering::Release);
        let alone = wait(orders.life, orders.look, state.stops());
        let (cycles, phase) = (words.cycles.load(Ordering::Acquire), Phase::of(words.phase.load(Ordering::Acquire)));
        let now = now();
        let before = state;
        state = state.next(Seen { cycles, phase, alone }, now, orders.silence);
        if let State::Watching { since, .. } | State::Stopping { since, .. } = before
            && state.stops() | before.stops()
        {
            words.silence_us.store(now.saturating_sub(since).as_micros() as u64, Ordering::Relaxed);
        }
        let begins = state.stops() && !before.stops();
        if begins {
            words.stops.fetch_add(1, Ordering::Release);
        }
        watchdog.serve(state, phase, now);
        match state {
            State::Over => {
                if alone && matches!(phase, Phase::Run | Phase::Leave) {
                    tell(CONTROLLER_ENDED);
                }
                leave(&orders);
                return 0;
            }
            _ if state.stops() => orders.lines().iter().for_each(|line| write(line, begins)),
            _ => {}
        }
        if begins && !alone && phase == Phase::Run {
            tell(NO_CYCLE);
        }
    }
}

/// Tells a controller that did not start this process that no telegram follows, and waits for the end of the controller.
/// A service that is bound to the guardian therefore ends first.
fn leave(orders: &Orders) {
    if orders.connection < 0 {
        return;
    }
    // SAFETY: the descriptor is of this process, and is not used again.
    unsafe { libc::close(orders.connection) };
    while !wait(orders.life, Duration::from_secs(1), false) {}
}

/// A hardware watchdog: a file that must be written again and again.
struct Watchdog {
    /// -1 without a watchdog.
    descriptor: RawFd,
    /// Time of the next byte.
    due: Duration,
}

impl Watchdog {
    /// The byte to be written in `state`, if any.
    fn byte(&mut self, state: State, phase: Phase, now: Duration) -> Option<u8> {
        match state {
            State::Waiting | State::Watching { .. } if now >= self.due => {
                self.due = now + WATCHDOG;
                Some(0)
            }
            State::Over if phase == Phase::End => Some(b'V'),
            _ => None,
        }
    }

    fn serve(&mut self, state: State, phase: Phase, now: Duration) {
        if self.descriptor < 0 {
            return;
        }
        if let Some(byte) = self.byte(state, phase, now) {
            // SAFETY: reads one byte of this function. An error is repeated by the next byte, or lets the watchdog run out.
            unsafe { libc::write(self.descriptor, (&raw const byte).cast(), 1) };
        }
    }
}

/// Waits for the next look, or for the end of the controller. Returns whether the controller has ended. The end of a pipe
/// is permanent, so a guardian that is `busy` after this end waits by time only.
fn wait(life: RawFd, look: Duration, busy: bool) -> bool {
    let mut ended = libc::pollfd { fd: life, events: 0, revents: 0 };
    let time =
        libc::timespec { tv_sec: look.as_secs() as libc::time_t, tv_nsec: libc::c_long::from(look.subsec_nanos()) };
    // SAFETY: one valid pollfd, a valid time, and no set of signals.
    let ready = unsafe { libc::ppoll(&raw mut ended, 1, &raw const time, std::ptr::null()) };
    let alone = ready > 0 && ended.revents != 0;
    if alone && busy {
        // SAFETY: a valid time, and no place for the rest.
        unsafe { libc::nanosleep(&raw const time, std::ptr::null_mut()) };
    }
    alone
}

/// The time of `CLOCK_MONOTONIC`.
fn now() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call fills the structure. This clock exists on every Linux.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// Writes the telegram of a line. Errors are ignored, because the next round tries again.
fn write(line: &LineOrders, begins: bool) {
    let (descriptor, telegram) = (line.descriptor, line.telegram());
    let mut unsent: libc::c_int = 0;
    // SAFETY: the first call takes integers, the second stores one int, and the third reads as many bytes as stated.
    unsafe {
        if begins {
            libc::tcflush(descriptor, libc::TCOFLUSH);
        } else if libc::ioctl(descriptor, libc::TIOCOUTQ, &raw mut unsent) == 0 && unsent > 0 {
            return;
        }
        libc::write(descriptor, telegram.as_ptr().cast(), telegram.len());
    }
}

/// Makes the guardian independent of its controller, and puts it above the servo. Returns what the host denied.
fn detach(orders: &Orders) -> u32 {
    let mut denied = 0;
    // SAFETY: all calls take plain integers or structures of this function, and change only this process, which has one
    // thread. Locking memory changes where pages are kept, not their content.
    unsafe {
        let mut all: libc::sigset_t = std::mem::zeroed();
        libc::sigfillset(&raw mut all);
        libc::sigprocmask(libc::SIG_BLOCK, &raw const all, std::ptr::null_mut());
        libc::setsid();
        libc::prctl(libc::PR_SET_NAME, c"mrroc-guardian".as_ptr());
        libc::prctl(libc::PR_SET_TIMERSLACK, 1 as libc::c_ulong);
        // Without CAP_SYS_RESOURCE this is denied, and only the small memory of the guardian protects it.
        let score = libc::open(c"/proc/self/oom_score_adj".as_ptr(), libc::O_WRONLY | libc::O_CLOEXEC);
        if score >= 0 {
            libc::write(score, c"-1000".as_ptr().cast(), 5);
            libc::close(score);
        }
        if libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) != 0 {
            denied |= Denied::MEMORY;
        }
        let above = libc::sched_param { sched_priority: i32::from(orders.priority).saturating_add(1).min(99) };
        if libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const above) != 0 {
            denied |= Denied::PRIORITY;
        }
    }
    denied
}

#[cfg(test)]
mod tests {
    use super::*;

    const SILENCE: Duration = Duration::from_millis(9);

    const fn at(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    const WAITING: State = State::Waiting;
    const WATCHING: State = State::Watching { cycles: 5, since: at(100) };
    const STOPPING: State = State::Stopping { cycles: 5, since: at(100) };
    const FIRST: State = State::Last { rounds: 1 };
    const FINAL: State = State::Last { rounds: LAST_ROUNDS };

    #[test]
    fn a_watchdog_gets_bytes_while_all_is_well_and_is_switched_off_by_an_orderly_end_only() {
        let mut watchdog = Watchdog { descriptor: -1, due: Duration::ZERO };
        for (state, phase, now, expected) in [
            (WAITING, Phase::Run, 1_000, Some(0)),
            (WAITING, Phase::Run, 1_099, None),
            (WATCHING, Phase::Run, 1_100, Some(0)),
            (STOPPING, Phase::Run, 2_000, None),
            (WATCHING, Phase::Leave, 2_001, Some(0)),
            (FIRST, Phase::Run, 3_000, None),
            (State::Over, Phase::Stop, 3_001, None),
            (State::Over, Phase::Run, 3_002, None),
            (State::Over, Phase::End, 3_003, Some(b'V')),
        ] {
            assert_eq!(watchdog.byte(state, phase, at(now)), expected, "{state:?} {phase:?} {now}");
        }
    }

    /// Each state, and the state after: the same count before and after the silence, another count, leaving before and
    /// after the time for leaving, the end of the controller, an order to stop, an order to end.
    #[test]
    fn every_look_in_every_state_leads_where_the_table_says() {
        let other = |now| State::Watching { cycles: 6, since: now };
        let seen = |cycles, phase, alone| Seen { cycles, phase, alone };
        let looks = [
            (seen(5, Phase::Run, false), at(108)),
            (seen(5, Phase::Run, false), at(109)),
            (seen(6, Phase::Run, false), at(130)),
            (seen(5, Phase::Leave, false), at(599)),
            (seen(5, Phase::Leave, false), at(600)),
            (seen(5, Phase::Run, true), at(101)),
            (seen(6, Phase::Stop, false), at(101)),
            (seen(5, Phase::End, true), at(101)),
        ];
        let (watching, stopping, over) = (WATCHING, STOPPING, State::Over);
        let second = State::Last { rounds: 2 };
        let table = [
            (WATCHING, [watching, stopping, other(at(130)), watching, stopping, FIRST, FIRST, over]),
            (STOPPING, [stopping, stopping, other(at(130)), stopping, stopping, FIRST, FIRST, over]),
            (FIRST, [second, second, second, second, second, second, second, over]),
            (FINAL, [over; 8]),
            (State::Over, [over; 8]),
        ];
        for (state, row) in table {
            for ((seen, now), next) in looks.into_iter().zip(row) {
                assert_eq!(state.next(seen, now, SILENCE), next, "{state:?} {seen:?} {now:?}");
            }
        }
        assert_eq!(WAITING.next(seen(0, Phase::Run, false), at(10_000), SILENCE), WAITING);
        assert_eq!(WAITING.next(seen(6, Phase::Run, false), at(130), SILENCE), other(at(130)));
        assert_eq!(WAITING.next(seen(0, Phase::Run, true), at(1), SILENCE), FIRST);
        assert_eq!(WAITING.next(seen(0, Phase::End, true), at(1), SILENCE), over);
        let writes = [WAITING, WATCHING, STOPPING, FIRST, State::Over].map(State::stops);
        assert_eq!(writes, [false, false, true, true, false]);
    }
}
