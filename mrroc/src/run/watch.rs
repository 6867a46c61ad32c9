//! Watch on the thread of a task: detects a task that does not return from its turn, and a generator that does not return
//! from a step.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use controller::executor::{SystemError, Turns, Work};
use thiserror::Error;

use super::{NEWS, crew};

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
    watched(name, turns, |()| {}, move |_| work())
}

/// Like [`returned`]. `show` receives the news of the work on the calling thread, and the work waits for a slow `show`.
pub(super) fn watched<T: Send + 'static, N: Send + 'static>(
    name: &'static str,
    turns: &Turns,
    mut show: impl FnMut(N),
    work: impl FnOnce(&mut dyn FnMut(N)) -> T + Send + 'static,
) -> Result<T, NoResult> {
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
            Ok(Told::Result(result)) => return Ok(result),
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
