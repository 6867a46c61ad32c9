//! A thread that computes the first steps of one robot's generators.
//!
//! The thread has the ordinary priority, and is not waited for: a first step that never returns must not hold up the end
//! of a run.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::Builder;

use controller::ecp::{Plan, Planner};

use super::crew;

/// Why a thread for `work` cannot be made, and what to do. `locked`: the stack of a new thread is locked in memory.
pub(super) fn no_thread(work: &str, locked: bool) -> String {
    let remedy = match locked {
        true => {
            ", and its stack counts for the limit of locked memory: raise the limit (memlock unlimited, see `mrroc \
             doctor`), or set realtime.lock_memory = false"
        }
        false => ": check the limit of processes (ulimit -u)",
    };
    format!("no thread for {work} can be made{remedy}")
}

/// Handle of a planning thread, held by the controller.
pub(super) struct Worker {
    plans: SyncSender<Plan>,
    results: Receiver<Plan>,
    /// The plan that waits until the worker has taken the one before.
    waiting: Option<Plan>,
}

impl Worker {
    /// Starts the thread. The thread ends when this handle is dropped and the last plan is computed.
    pub(super) fn start() -> io::Result<Self> {
        let (plans, taken) = sync_channel::<Plan>(1);
        let (computed, results) = sync_channel(1);
        let crew = crew::current();
        let body = move || {
            let _member = crew::join(crew);
            for mut plan in taken {
                crew::point("planning");
                plan.compute();
                if computed.send(plan).is_err() {
                    return;
                }
            }
        };
        Builder::new().name("planning".into()).spawn(body)?;
        Ok(Self { plans, results, waiting: None })
    }

    fn offer(&mut self) {
        if let Some(plan) = self.waiting.take()
            && let Err(TrySendError::Full(plan)) = self.plans.try_send(plan)
        {
            self.waiting = Some(plan);
        }
    }
}

impl Planner for Worker {
    fn begin(&mut self, plan: Plan) {
        self.waiting = Some(plan);
        self.offer();
    }

    fn finished(&mut self) -> Option<Plan> {
        let plan = self.results.try_recv().ok();
        self.offer();
        plan
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_locked_memory_refuses_names_the_limit() {
        assert!(no_thread("rehearsals", true).contains("limit of locked memory: raise the limit"));
        assert!(no_thread("rehearsals", false).contains("limit of processes"));
    }
}
