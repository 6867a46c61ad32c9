//! The files of a run: written in the loop in lockstep, by a thread of their own by the clock.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, anyhow};

use super::SMALL_STACK;
use crate::trace::{AxisLog, FrameLog};

/// Longest wait for the files of a run once it has ended.
const FILES_WAIT: Duration = Duration::from_secs(2);

/// How often the files of a run are written, at the least.
const DRAIN: Duration = Duration::from_millis(20);

/// The files of a run.
pub(super) struct Logs {
    pub(super) frames: Option<FrameLog>,
    pub(super) axes: Option<AxisLog>,
}

impl Logs {
    pub(super) fn drain(&mut self) -> anyhow::Result<()> {
        if let Some(frames) = &mut self.frames {
            frames.drain().context("the trace cannot be written")?;
        }
        if let Some(axes) = &mut self.axes {
            axes.drain().context("the record cannot be written")?;
        }
        Ok(())
    }

    pub(super) fn finish(mut self) -> anyhow::Result<()> {
        self.drain()?;
        match self
            .frames
            .map(FrameLog::finish)
            .transpose()
            .context("the trace cannot be written")?
        {
            Some(lost @ 1..) => Err(anyhow!(
                "the trace lacks {lost} frames: the file was too slow"
            )),
            _ => Ok(()),
        }
    }
}

/// The files of a run, written by a thread of its own: a file that takes nothing any more holds up nothing else.
pub(super) struct Writing {
    what: &'static str,
    over: Arc<AtomicBool>,
    told: Receiver<anyhow::Result<()>>,
}

impl Writing {
    /// Begins. A file that cannot be written raises `failed`.
    pub(super) fn start(mut logs: Logs, failed: Arc<AtomicBool>) -> anyhow::Result<Self> {
        let what = match (&logs.frames, &logs.axes) {
            (_, None) => "trace",
            (None, Some(_)) => "record",
            (Some(_), Some(_)) => "trace or the record",
        };
        let over = Arc::new(AtomicBool::new(false));
        let (tell, told) = sync_channel(1);
        let last = over.clone();
        let thread = Builder::new().name("files".into()).stack_size(SMALL_STACK);
        let body = move || {
            let mut written = Ok(());
            while written.is_ok() && !last.load(Ordering::Relaxed) {
                std::thread::park_timeout(DRAIN);
                written = logs.drain();
            }
            failed.fetch_or(written.is_err(), Ordering::Relaxed);
            // Nobody listens any more if it took too long.
            let _ = tell.send(written.and_then(|()| logs.finish()));
        };
        thread
            .spawn(body)
            .context("no thread to write the files can be made")?;
        Ok(Self { what, over, told })
    }

    /// Writes the rest, unless that takes too long.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        self.over.store(true, Ordering::Relaxed);
        self.told
            .recv_timeout(FILES_WAIT)
            .unwrap_or_else(|_| Err(anyhow!("the {} cannot be written in time", self.what)))
    }
}
