//! The thread that listens to the buses during a run in real time. The thread waits, but blocks no other thread.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, Thread};
use std::time::Duration;

use anyhow::Context;

use super::{Wire, WireReport};
use crate::run::SMALL_STACK;

/// Longest time between two readings of the listeners. Their queues hold the frames of some seconds.
const LOOK: Duration = Duration::from_millis(20);

/// Longest wait for the results at the end of a run.
const LAST_LOOK: Duration = Duration::from_secs(2);

/// A thread that listens until this value is dropped.
pub struct Listening {
    over: Arc<AtomicBool>,
    told: Receiver<Vec<WireReport>>,
    thread: Thread,
}

impl Listening {
    /// The results; empty if the thread does not get the processor in time.
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
    /// Starts to listen on a separate thread.
    pub fn listen(mut self) -> anyhow::Result<Listening> {
        let over = Arc::new(AtomicBool::new(false));
        let (tell, told) = sync_channel(1);
        let last = over.clone();
        let body = move || {
            while !last.load(Ordering::Relaxed) {
                std::thread::park_timeout(LOOK);
                self.look();
            }
            // Frames that arrived before the end are still in the queues.
            self.look();
            // The receiver may have stopped waiting.
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
