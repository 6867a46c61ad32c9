//! Watches on threads of a run. The watch on the thread of a task detects a task that does not return from its turn,
//! and a generator that does not return from a step. The watch on the servo thread detects that no cycle is completed.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use can::Instant;
use controller::executor::{SystemError, Turns, Work};
use thiserror::Error;

use super::{NEWS, crew};
use crate::cell::Cell;

/// Time between two looks at a task.
pub(super) const LOOK: Duration = Duration::from_millis(100);

/// Number of looks that may find the same turn or step in progress.
const MOST_LOOKS: u32 = 100;

/// The same for steps where the agents plan within their polls: a first step may take long.
const MOST_LOOKS_AT_PLANS: u32 = 700;

/// Number of looks that may find no new turn of the loop that executes the task. A turn contains turns of the task and
/// steps, so that those are reported first.
const MOST_ROUND_LOOKS: u32 = 150;

/// The turns of a task, as seen from another thread.
pub(super) struct Watch {
    turns: Turns,
    /// What the last look found in progress, and the number of looks that found it.
    seen: [(Option<u64>, u32); 2],
    most: [u32; 2],
    /// Greatest number of looks that found the same turn of the task in progress.
    longest: u32,
    /// Turns of the loop that executes the task, the number seen at the last look, and the number of looks that saw it.
    rounds: Option<Arc<AtomicU64>>,
    seen_rounds: (u64, u32),
}

impl Watch {
    /// A watch on a task with these turns. `plans_aside`: other threads compute the first steps.
    pub(super) fn of(turns: &Turns, plans_aside: bool) -> Self {
        let steps = if plans_aside { MOST_LOOKS } else { MOST_LOOKS_AT_PLANS };
        Self {
            turns: turns.clone(),
            seen: [(None, 0); 2],
            most: [MOST_LOOKS, steps],
            longest: 0,
            rounds: None,
            seen_rounds: (0, 0),
        }
    }

    /// Watches also the loop that counts its turns in `rounds`.
    pub(super) fn of_rounds(mut self, rounds: Arc<AtomicU64>) -> Self {
        self.rounds = Some(rounds);
        self
    }

    /// Looks at the task and at the steps of its generators. Fails if too many looks found the same one in progress.
    pub(super) fn look(&mut self) -> Result<(), Hung> {
        for ((work, seen), most) in [Work::Task, Work::Steps].into_iter().zip(&mut self.seen).zip(self.most) {
            let now = self.turns.in_progress(work);
            let looks = if now.is_some() && now == seen.0 { seen.1 + 1 } else { 0 };
            *seen = (now, looks);
            let limit = LOOK * most;
            if work == Work::Task {
                self.longest = self.longest.max(looks);
            }
            match work {
                _ if looks < most => {}
                Work::Task => return Err(SystemError::Hung { limit }.into()),
                Work::Steps => return Err(SystemError::HungInStep { limit }.into()),
            }
        }
        if let Some(rounds) = &self.rounds {
            let now = rounds.load(Ordering::Relaxed);
            let looks = if now == self.seen_rounds.0 { self.seen_rounds.1 + 1 } else { 0 };
            self.seen_rounds = (now, looks);
            if looks >= MOST_ROUND_LOOKS {
                return Err(Hung::Controller { waited: LOOK * MOST_ROUND_LOOKS });
            }
        }
        Ok(())
    }
}

/// Time without a servo cycle after which the thread is taken for hung, beyond the missed deadlines that the servo
/// tolerates. Each guardian permits at most this silence.
const SERVO_SILENCE: Duration = Duration::from_secs(1);

/// The same for a cell with emulated drives, whose time stands still while the thread does not run. One step of a world
/// may be long.
const EMULATED_SILENCE: Duration = Duration::from_secs(10);

/// Time without a servo cycle after which the servo thread of `cell` is taken for hung.
pub fn hang_limit(cell: &Cell, emulated: bool) -> Duration {
    let least = if emulated { EMULATED_SILENCE } else { SERVO_SILENCE };
    least + cell.period().saturating_mul(cell.max_missed_in_row)
}

/// Watch on a servo thread, by looks of another thread.
///
/// A suspension of the process or of the machine stops both threads, and the servo itself reports the missed deadlines.
/// The time between two looks therefore counts as at most [`LOOK`].
#[derive(Debug)]
pub(super) struct ServoWatch {
    limit: Duration,
    /// Time of the last look.
    looked: Instant,
    cycles: u64,
    /// Time for which the number of cycles has stood still while the watching thread ran.
    silent: Duration,
}

impl ServoWatch {
    /// A watch from `now` on.
    pub(super) fn of(limit: Duration, now: Instant) -> Self {
        Self { limit, looked: now, cycles: 0, silent: Duration::ZERO }
    }

    /// Looks at the number of ended cycles at `now`. Fails if the number has stood still for the limit.
    pub(super) fn look(&mut self, cycles: u64, now: Instant) -> Result<(), ServoHang> {
        let ran = now.since(self.looked).min(LOOK);
        self.looked = now;
        self.silent = if cycles == self.cycles { self.silent + ran } else { Duration::ZERO };
        self.cycles = cycles;
        if self.silent < self.limit { Ok(()) } else { Err(ServoHang { silent: self.silent, cycles }) }
    }
}

/// A servo thread that hangs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("thread servo hangs (no servo cycle for {silent:.1?})")]
pub struct ServoHang {
    /// Time without a servo cycle.
    pub silent: Duration,
    /// Number of ended cycles.
    pub cycles: u64,
}

impl ServoHang {
    /// What to check next.
    pub fn remedy(&self) -> &'static str {
        "check adapters and cycle laws"
    }
}

/// What hangs in a run.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub(crate) enum Hung {
    /// The task, or a generator of the task.
    #[error("{0}")]
    Task(#[from] SystemError),
    /// The thread that executes the task hangs elsewhere.
    #[error("thread controller did not come round for {waited:?}: check the host with `mrroc doctor`")]
    Controller {
        /// Duration of the look-out.
        waited: Duration,
    },
}

/// Reasons why work on a thread of its own has no result.
#[derive(Debug, Error)]
pub(crate) enum NoResult {
    /// The system has no thread for the work.
    #[error("no {name} thread can be made: {error}")]
    NoThread {
        /// Name of the work.
        name: &'static str,
        /// Error of the system.
        error: io::Error,
    },
    /// The task hangs in a turn, or a generator in a step.
    #[error("{0}")]
    Hung(Hung),
    /// The work panicked.
    #[error("the {name} panicked: {message}")]
    Panicked {
        /// Name of the work.
        name: &'static str,
        /// Message of the panic.
        message: String,
    },
}

/// Message of a thread that works.
enum Told<T, N> {
    News(N),
    Result(T),
}

/// The result of `work`, which executes a task with these turns on a thread of its own. If the task hangs, the thread is
/// left behind.
pub(crate) fn returned<T: Send + 'static>(
    name: &'static str,
    turns: &Turns,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, NoResult> {
    watched(name, turns, |()| {}, move |_| work()).map(|(result, _)| result)
}

/// Like [`returned`], with the time for which the longest turn of the task was seen in progress.
pub(crate) fn returned_after<T: Send + 'static>(
    name: &'static str,
    turns: &Turns,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<(T, Duration), NoResult> {
    watched(name, turns, |()| {}, move |_| work())
}

/// Like [`returned`]. `show` receives the news of the work on the calling thread, and the work waits for a slow `show`.
/// The time is that of [`returned_after`].
pub(super) fn watched<T: Send + 'static, N: Send + 'static>(
    name: &'static str,
    turns: &Turns,
    mut show: impl FnMut(N),
    work: impl FnOnce(&mut dyn FnMut(N)) -> T + Send + 'static,
) -> Result<(T, Duration), NoResult> {
    let mut watch = Watch::of(turns, false);
    let (tell, told) = sync_channel(NEWS);
    let crew = crew::current();
    let body = move || {
        let _member = crew::join(crew);
        // A caller that has given up receives nothing more.
        let result = work(&mut |news| _ = tell.send(Told::News(news)));
        _ = tell.send(Told::Result(result));
    };
    let thread = Builder::new().name(name.to_owned()).spawn(body);
    let thread = thread.map_err(|error| NoResult::NoThread { name, error })?;
    loop {
        match told.recv_timeout(LOOK) {
            Ok(Told::News(news)) => show(news),
            Ok(Told::Result(result)) => return Ok((result, LOOK * watch.longest)),
            Err(RecvTimeoutError::Timeout) => watch.look().map_err(NoResult::Hung)?,
            Err(RecvTimeoutError::Disconnected) => {
                let panic = thread.join().expect_err("a thread without a result has panicked");
                return Err(NoResult::Panicked { name, message: crew::message(&*panic) });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_millis(1_018);

    const fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    /// Looks after these times, ms, with these numbers of cycles. Returns the result of the last look, and asserts that
    /// the looks before find no hang.
    fn looks(looks: impl IntoIterator<Item = (u64, u64)>) -> Result<(), ServoHang> {
        let mut now = Instant::ZERO;
        let mut watch = ServoWatch::of(LIMIT, now);
        let mut found = Ok(());
        for (wait, cycles) in looks {
            assert_eq!(found, Ok(()), "{now:?}");
            now += ms(wait);
            found = watch.look(cycles, now);
        }
        found
    }

    #[test]
    fn a_servo_thread_without_a_cycle_is_reported_after_the_limit() {
        let silent = |wait, count| std::iter::repeat_n((wait, 7), count);
        let hang = |silent| Err(ServoHang { silent: ms(silent), cycles: 7 });
        assert_eq!(looks([(100, 7)].into_iter().chain(silent(100, 10))), Ok(()));
        assert_eq!(looks([(100, 7)].into_iter().chain(silent(100, 11))), hang(1_100));
        assert_eq!(looks([(100, 7)].into_iter().chain(silent(1, 1_018))), hang(1_018));
        // Before the first cycle.
        assert_eq!(looks(std::iter::repeat_n((100, 0), 11)), Err(ServoHang { silent: ms(1_100), cycles: 0 }));
        let once = silent(100, 10).chain([(100, 8)]).chain(std::iter::repeat_n((100, 8), 10));
        assert_eq!(looks([(100, 7)].into_iter().chain(once)), Ok(()), "one cycle begins the time anew");
    }

    #[test]
    fn a_pause_of_both_threads_is_no_hang_of_the_servo_thread() {
        let paused = |pauses| std::iter::repeat_n((5_000, 7), pauses);
        assert_eq!(looks([(100, 7)].into_iter().chain(paused(10))), Ok(()));
        // Cycles that go on after each pause.
        assert_eq!(looks((0..100).map(|number| (60_000, number))), Ok(()));
        assert_eq!(looks([(100, 7)].into_iter().chain(paused(11))), Err(ServoHang { silent: ms(1_100), cycles: 7 }));
    }

    #[test]
    fn the_limit_is_beyond_what_the_servo_tolerates_and_what_a_guardian_permits() {
        let file = crate::tasks::tests::two_arms();
        let tolerated = file.cell.period() * file.cell.max_missed_in_row;
        assert_eq!(hang_limit(&file.cell, false), ms(1_000) + tolerated);
        assert_eq!(hang_limit(&file.cell, true), ms(10_000) + tolerated);
        assert!(ms(crate::guardian::LONGEST_SILENCE_MS as u64) <= SERVO_SILENCE);
    }

    #[test]
    fn a_controller_that_does_not_come_round_is_reported_after_its_looks() {
        let rounds = Arc::new(AtomicU64::new(0));
        let mut watch = Watch::of(&Turns::default(), true).of_rounds(rounds.clone());
        for _ in 0..3 * MOST_ROUND_LOOKS {
            rounds.fetch_add(1, Ordering::Relaxed);
            assert_eq!(watch.look(), Ok(()));
        }
        for _ in 1..MOST_ROUND_LOOKS {
            assert_eq!(watch.look(), Ok(()));
        }
        assert_eq!(watch.look(), Err(Hung::Controller { waited: Duration::from_secs(15) }));
    }
}
