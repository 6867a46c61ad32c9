//! The thread that listens while a cell runs by the wall clock. It waits, but holds up nobody.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, Thread};
use std::time::Duration;

use anyhow::Context;

use super::{Wire, WireReport};
use crate::run::SMALL_STACK;

/// How often the listeners are read, at the least; their queues hold seconds.
const LOOK: Duration = Duration::from_millis(20);

/// Longest wait for what was heard once a run has ended.
const LAST_LOOK: Duration = Duration::from_secs(2);

/// A thread that listens, until this is dropped.
pub struct Listening {
    over: Arc<AtomicBool>,
    told: Receiver<Vec<WireReport>>,
    thread: Thread,
}

impl Listening {
    /// What was heard; nothing if the thread does not get the processor in time.
    pub fn finish(self) -> Vec<WireReport> {
        self.over.store(true, Ordering::Relaxed);
        self.thread.unpark();
        self.told.recv_timeout(LAST_LOOK).unwrap_or_default()
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

impl Wire {
    /// Begins to listen on a thread of its own.
    pub fn listen(mut self) -> anyhow::Result<Listening> {
        let over = Arc::new(AtomicBool::new(false));
        let (tell, told) = sync_channel(1);
        let last = over.clone();
        let body = move || {
            while !last.load(Ordering::Relaxed) {
                std::thread::park_timeout(LOOK);
                self.look();
            }
            // What came before the end was asked for is still in the queues.
            self.look();
            // Nobody waits any more if it took too long.
            let _ = tell.send(self.reports());
        };
        let thread = Builder::new()
            .name("listener".into())
            .stack_size(SMALL_STACK)
            .spawn(body)
            .context("no thread to listen to the buses can be made")?;
        Ok(Listening {
            over,
            told,
            thread: thread.thread().clone(),
        })
    }
}
