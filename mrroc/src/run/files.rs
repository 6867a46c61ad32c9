//! The files of a run: written in the loop in lockstep, by a thread of their own by the clock.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow};

use can::{TraceEvent, TraceReader};
use serial::LineTraceReader;
use servo::Record;

use super::Background;
use crate::recording::Recorder;
use crate::trace::{AxisLog, FrameLog, StepFile};
use crate::{cell::CellFile, report::Tracks};

/// Longest wait for the files of a run once it has ended.
const FILES_WAIT: Duration = Duration::from_secs(2);

/// The same for a recording, which may be long.
const RECORDING_WAIT: Duration = Duration::from_secs(10);

/// How often the files of a run are written, at the least.
const DRAIN: Duration = Duration::from_millis(20);

/// The records and the files of a run.
pub(super) struct Logs {
    pub(super) records: rtrb::Consumer<Record>,
    /// What passed at each port and each line, if it is traced.
    pub(super) buses: Vec<TraceReader>,
    pub(super) lines: Vec<LineTraceReader>,
    pub(super) recorder: Option<Recorder>,
    /// The run ended in a fault.
    pub(super) faulted: Arc<AtomicBool>,
    pub(super) tracks: Tracks,
    pub(super) frames: Option<FrameLog>,
    pub(super) axes: Option<AxisLog>,
    pub(super) steps: Option<StepFile>,
    /// Why the files are written no more.
    pub(super) failed: Option<anyhow::Error>,
}

impl Logs {
    /// Takes what came since the last call; whether all files can still be written. The robots are followed to the end of
    /// the run all the same.
    pub(super) fn drain(&mut self) -> bool {
        if let Some(recorder) = &mut self.recorder {
            recorder.drain_journal();
        }
        let mut written = self.drain_ports().context("the trace cannot be written");
        if let Some(steps) = self.steps.as_mut().filter(|_| self.failed.is_none()) {
            written = written.and(steps.drain().context("the steps cannot be written"));
        }
        let mut axes = self.axes.as_mut().filter(|_| self.failed.is_none());
        let mut recorded = Ok(());
        let count = self.records.slots();
        if let Ok(records) = self.records.read_chunk(count) {
            let (first, rest) = records.as_slices();
            for record in first.iter().chain(rest) {
                self.tracks.observe(record);
                if let Some(recorder) = &mut self.recorder {
                    recorder.record(record);
                }
                if let Some(axes) = axes.as_mut().filter(|_| recorded.is_ok()) {
                    recorded = axes.write(record);
                }
            }
            records.commit_all();
        }
        if let Some(axes) = axes.filter(|_| recorded.is_ok()) {
            recorded = axes.flush();
        }
        written = written.and(recorded.context("the record cannot be written"));
        let lost = self.lost();
        if let Some(recorder) = &mut self.recorder {
            recorder.drained(lost);
        }
        if let Err(error) = written {
            self.failed = Some(error);
        }
        self.failed.is_none()
    }

    /// Takes what passed at ports and lines. The recorder gets all, also after a failure of the trace.
    fn drain_ports(&mut self) -> io::Result<()> {
        let mut written = Ok(());
        for (bus, reader) in self.buses.iter_mut().enumerate() {
            while let Some(entry) = reader.read_entry() {
                if let Some(recorder) = &mut self.recorder {
                    recorder.bus(bus, &entry);
                }
                if let TraceEvent::Frame(traced) = &entry.event
                    && let Some(frames) = self.frames.as_mut().filter(|_| self.failed.is_none() && written.is_ok())
                {
                    written = frames.write(bus, traced);
                }
            }
        }
        for (line, reader) in self.lines.iter_mut().enumerate() {
            while let Some(entry) = reader.read() {
                if let Some(recorder) = &mut self.recorder {
                    recorder.line(line, &entry);
                }
            }
        }
        written
    }

    /// Entries of ports and lines that found no room.
    fn lost(&self) -> u64 {
        let buses = self.buses.iter().map(TraceReader::lost).sum::<u64>();
        buses + self.lines.iter().map(LineTraceReader::lost).sum::<u64>()
    }

    fn is_recorded(&self) -> bool {
        self.axes.is_some() || self.recorder.is_some()
    }

    /// Takes the rest: what became of the files, and of the robots.
    pub(super) fn finish(mut self) -> (anyhow::Result<()>, Tracks) {
        self.drain();
        let lost = self.lost();
        let recorded =
            self.recorder.map_or(Ok(()), |recorder| recorder.finish(lost, self.faulted.load(Ordering::Relaxed)));
        let frames = self.frames.filter(|_| self.failed.is_none());
        let lost = self.buses.iter().map(TraceReader::lost).sum::<u64>();
        let finished = frames.map(|mut frames| frames.flush().map(|()| lost)).transpose();
        let steps = self.steps.filter(|_| self.failed.is_none()).map(StepFile::finish).transpose();
        let steps = match steps.context("the steps cannot be written") {
            Ok(Some(lost @ 1..)) => Err(anyhow!("the steps lack {lost} events: the file was too slow")),
            Ok(_) => Ok(()),
            Err(error) => Err(error),
        };
        let written = match (self.failed, finished) {
            (Some(error), _) => Err(error),
            (None, Err(error)) => Err(error).context("the trace cannot be written"),
            (None, Ok(Some(lost @ 1..))) => Err(anyhow!("the trace lacks {lost} frames: the file was too slow")),
            (None, Ok(_)) => Ok(()),
        };
        (written.and(steps).and(recorded), self.tracks)
    }
}

/// The files of a run, written by a thread of its own: a file that takes nothing any more holds up nothing else.
pub(super) struct Writing {
    what: String,
    wait: Duration,
    thread: Background<(anyhow::Result<()>, Tracks)>,
}

impl Writing {
    /// Begins. A file that cannot be written raises `failed`.
    pub(super) fn start(logs: Logs, failed: Arc<AtomicBool>) -> anyhow::Result<Self> {
        let files = [("trace", logs.frames.is_some()), ("record", logs.is_recorded()), ("steps", logs.steps.is_some())];
        let kept: Vec<_> = files.into_iter().filter_map(|(file, kept)| kept.then_some(file)).collect();
        let what = if kept.is_empty() { "records".to_owned() } else { kept.join(" or the ") };
        let wait = if logs.recorder.is_some() { RECORDING_WAIT } else { FILES_WAIT };
        let drain = move |logs: &mut Logs| {
            failed.fetch_or(!logs.drain(), Ordering::Relaxed);
        };
        let thread = Background::start("files", DRAIN, logs, drain, Logs::finish);
        Ok(Self { what, wait, thread: thread.context("no thread to write the files can be made")? })
    }

    /// Writes the rest, unless that takes too long: then nothing is known of the robots either.
    pub(super) fn finish(self, file: &CellFile) -> (anyhow::Result<()>, Tracks) {
        self.thread.finish(self.wait).unwrap_or_else(|| {
            let late = anyhow!("the {} cannot be written in time", self.what);
            (Err(late), Tracks::new(file, false))
        })
    }
}
