//! The files of a run: written in the loop in lockstep, by a thread of their own by the clock.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow};

use can::{TraceEvent, TraceReader};
use drive::device::DeviceSamples;
use serial::LineTraceReader;
use servo::Record;

use super::Background;
use super::recorded::Recorder;
use crate::row_file::{FileName, IncompleteFile};
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
    /// All samples of the devices of other crates.
    pub(super) samples: Vec<DeviceSamples>,
    pub(super) recorder: Option<Recorder>,
    /// The run ended in a fault.
    pub(super) faulted: Arc<AtomicBool>,
    pub(super) tracks: Tracks,
    pub(super) frames: Option<FrameLog>,
    pub(super) axes: Option<AxisLog>,
    pub(super) steps: Option<StepFile>,
}

impl Logs {
    /// Takes what came since the last call. A file that cannot be written ends with a warning, and the run goes on.
    pub(super) fn drain(&mut self) {
        if let Some(recorder) = &mut self.recorder {
            recorder.drain_journal();
        }
        self.drain_ports();
        if let Some(steps) = &mut self.steps {
            steps.drain();
        }
        // The samples of these records are in their rings already.
        let count = self.records.slots();
        self.drain_samples();
        if let Ok(records) = self.records.read_chunk(count) {
            let (first, rest) = records.as_slices();
            for record in first.iter().chain(rest) {
                self.tracks.observe(record);
                if let Some(recorder) = &mut self.recorder {
                    recorder.record(record);
                }
                if let Some(axes) = &mut self.axes {
                    axes.write(record);
                }
            }
            records.commit_all();
        }
        if let Some(axes) = &mut self.axes {
            axes.flush();
        }
        let lost = self.lost();
        if let Some(recorder) = &mut self.recorder {
            recorder.drained(lost);
        }
    }

    /// Takes what passed at ports and lines.
    fn drain_ports(&mut self) {
        for (bus, reader) in self.buses.iter_mut().enumerate() {
            while let Some(entry) = reader.read_entry() {
                if let Some(recorder) = &mut self.recorder {
                    recorder.bus(bus, &entry);
                }
                if let (TraceEvent::Frame(traced), Some(frames)) = (&entry.event, &mut self.frames) {
                    frames.write(bus, traced);
                }
            }
        }
        if let Some(frames) = &mut self.frames {
            frames.flush();
        }
        for (line, reader) in self.lines.iter_mut().enumerate() {
            while let Some(entry) = reader.read() {
                if let Some(recorder) = &mut self.recorder {
                    recorder.line(line, &entry);
                }
            }
        }
    }

    /// Takes the samples of devices. Rows of a cycle need the samples of the cycle.
    fn drain_samples(&mut self) {
        for (device, samples) in self.samples.iter_mut().enumerate() {
            while let Some((at, sample)) = samples.take() {
                self.tracks.sample(device, sample.as_ref());
                if let Some(recorder) = &mut self.recorder {
                    recorder.sample(device, at, sample.as_ref());
                }
                if let Some(axes) = &mut self.axes {
                    axes.sample(device, at, sample);
                }
            }
        }
    }

    /// Number of entries of ports and lines, and of samples, that were dropped because a ring was full.
    fn lost(&self) -> u64 {
        let buses = self.buses.iter().map(TraceReader::lost).sum::<u64>();
        let lines = self.lines.iter().map(LineTraceReader::lost).sum::<u64>();
        buses + lines + self.samples.iter().map(DeviceSamples::lost).sum::<u64>()
    }

    fn is_recorded(&self) -> bool {
        self.axes.is_some() || self.recorder.is_some()
    }

    /// Takes the rest: the files that are incomplete, and what became of the robots.
    pub(super) fn finish(mut self) -> Written {
        self.drain();
        let (lost, faulted) = (self.lost(), self.faulted.load(Ordering::Relaxed));
        let frames_lost = self.buses.iter().map(TraceReader::lost).sum::<u64>();
        let frames = self.frames.and_then(|frames| frames.finish(frames_lost));
        let axes = self.axes.and_then(AxisLog::finish);
        let steps = self.steps.and_then(StepFile::finish);
        let recorded = self.recorder.map_or_else(Vec::new, |recorder| recorder.finish(lost, faulted));
        let incomplete = frames.into_iter().chain(axes).chain(recorded).chain(steps).collect();
        Written { incomplete, late: None, tracks: self.tracks }
    }
}

/// What became of the files and the records of a run.
pub(super) struct Written {
    pub(super) incomplete: Vec<IncompleteFile>,
    /// The files that were not written in time.
    pub(super) late: Option<anyhow::Error>,
    pub(super) tracks: Tracks,
}

/// The name of the file of `option` in messages.
pub(super) fn named(option: &'static str, path: &Option<PathBuf>, entries: &'static str) -> FileName {
    FileName::new(option, path.as_deref().unwrap_or(Path::new("")), entries)
}

/// The option and the path of a file that cannot be begun.
pub(super) fn begun(option: &str, path: &Option<PathBuf>) -> String {
    format!("{option}: {}", path.as_deref().unwrap_or(Path::new("")).display())
}

/// The files of a run, written by a thread of its own: a file that takes nothing any more holds up nothing else.
pub(super) struct Writing {
    what: String,
    wait: Duration,
    thread: Background<Written>,
}

impl Writing {
    /// Begins.
    pub(super) fn start(logs: Logs) -> anyhow::Result<Self> {
        let files = [("trace", logs.frames.is_some()), ("record", logs.is_recorded()), ("steps", logs.steps.is_some())];
        let kept: Vec<_> = files.into_iter().filter_map(|(file, kept)| kept.then_some(file)).collect();
        let what = if kept.is_empty() { "records".to_owned() } else { kept.join(" or the ") };
        let wait = if logs.recorder.is_some() { RECORDING_WAIT } else { FILES_WAIT };
        let thread = Background::start("files", DRAIN, logs, Logs::drain, Logs::finish);
        Ok(Self { what, wait, thread: thread.context("no thread to write the files can be made")? })
    }

    /// Writes the rest, unless that takes too long: then nothing is known of the robots either.
    pub(super) fn finish(self, file: &CellFile) -> Written {
        self.thread.finish(self.wait).unwrap_or_else(|| {
            let late = anyhow!("the {} cannot be written in time", self.what);
            Written { incomplete: Vec::new(), late: Some(late), tracks: Tracks::new(file, false) }
        })
    }
}
