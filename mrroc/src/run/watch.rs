//! Watch on the thread of a task: detects a task that does not return from its turn.

use std::panic::resume_unwind;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use anyhow::Context;
use controller::executor::{SystemError, Turns};

/// Time between two looks at a task.
pub(super) const LOOK: Duration = Duration::from_millis(100);

/// Number of looks that may find the same turn in progress.
const MOST_LOOKS: u32 = 100;

/// The turns of a task, as seen from another thread.
pub(super) struct Watch {
    turns: Turns,
    seen: Option<u64>,
    looks: u32,
}

impl Watch {
    /// A watch on a task with these turns.
    pub(super) fn of(turns: &Turns) -> Self {
        Self { turns: turns.clone(), seen: None, looks: 0 }
    }

    /// Looks at the task. Fails if [`MOST_LOOKS`] looks found the same turn in progress.
    pub(super) fn look(&mut self) -> Result<(), SystemError> {
        let turn = self.turns.in_progress();
        self.looks = if turn.is_some() && turn == self.seen { self.looks + 1 } else { 0 };
        self.seen = turn;
        if self.looks < MOST_LOOKS { Ok(()) } else { Err(SystemError::Hung { limit: LOOK * MOST_LOOKS }) }
    }
}

/// The result of `work`, which executes a task with these turns on a thread of its own. If the task hangs, the thread is
/// left behind.
pub(crate) fn returned<T: Send + 'static>(
    name: &str,
    turns: &Turns,
    work: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<T> {
    let mut watch = Watch::of(turns);
    let (tell, told) = sync_channel(1);
    let body = move || _ = tell.send(work());
    let thread =
        Builder::new().name(name.to_owned()).spawn(body).with_context(|| format!("no {name} thread can be made"))?;
    loop {
        match told.recv_timeout(LOOK) {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => watch.look()?,
            Err(RecvTimeoutError::Disconnected) => {
                let panic = thread.join().expect_err("a thread without a result has panicked");
                resume_unwind(panic);
            }
        }
    }
}
