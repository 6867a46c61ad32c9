//! The flight recorder: files with the last seconds, after a fault and on request.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};
use can::{Instant, InterfaceName, TraceEvent};
use prost::Message;

use super::file::{Facts, McapFile};
use super::messages::BusEvent;
use super::sources::Layout;
use super::window::Window;
use super::{FlightRequest, candump_line};
use crate::cell::CellFile;
use crate::streams;

/// Time of the run after a fault that the file contains.
const AFTER: Duration = Duration::from_secs(1);

/// Most files of one run after faults. Requests are always obeyed.
const MOST: u32 = 20;

/// Greatest number in the name of a file.
const LAST: u32 = 9999;

/// Most bytes of a robot's cycle without its axes.
const ROBOT: usize = 48;

/// Most bytes of one cycle of an axis.
const AXIS: usize = 128;

/// Most bytes of a frame or a telegram.
const FRAME: usize = 64;

/// Usual bytes of a call, a timing, and a share of the orders.
const CALL: usize = 96;

/// Where and when the last seconds are written.
pub struct Flights {
    directory: PathBuf,
    cell: String,
    span: Duration,
    messages: usize,
    bytes: usize,
    request: FlightRequest,
    /// Time at which the file of the last fault is written.
    due: Option<Instant>,
    written: u32,
}

impl Flights {
    /// Files in `directory`, which exists, with the seconds that the cell asks for.
    pub fn new(file: &CellFile, directory: &Path, request: FlightRequest) -> Self {
        let cell = &file.cell;
        let span = Duration::from_secs(cell.flight_recorder_s.into());
        let cycles = (span.as_nanos() / cell.period().as_nanos()) as usize + 1;
        let axes = cell.robot.iter().map(|robot| robot.axis.len());
        let frames: usize = (0..cell.bus.len()).map(|bus| 2 * cell.frames_per_cycle(bus)).sum();
        let lines: usize = Layout::of(file).lines();
        // Calls, timing and orders; one message each per robot; frames and telegrams of both directions.
        let messages = 4 + cell.robot.len() + frames + 3 * lines;
        let bytes = 4 * CALL + axes.map(|axes| ROBOT + axes * AXIS).sum::<usize>() + (frames + 3 * lines) * FRAME;
        Self {
            directory: directory.to_owned(),
            cell: cell.name.clone(),
            span,
            messages: cycles * messages,
            bytes: cycles * bytes,
            request,
            due: None,
            written: 0,
        }
    }

    pub(super) fn span(&self) -> Duration {
        self.span
    }

    pub(super) fn messages(&self) -> usize {
        self.messages
    }

    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Notes a fault at `time`. Faults within a second share a file.
    pub(super) fn fault_at(&mut self, time: Instant) {
        if self.written < MOST {
            self.due.get_or_insert(time + AFTER);
        }
    }

    /// Whether a file is due at `time` of the run.
    pub(super) fn is_due(&mut self, time: Instant) -> bool {
        self.request.take() || self.due.is_some_and(|due| time >= due)
    }

    /// Whether the end of the run needs a file: a fault has none yet.
    pub(super) fn is_wanted(&self, faulted: bool) -> bool {
        self.due.is_some() || faulted && self.written == 0
    }

    /// Writes the window to a new file, and says where or why not.
    pub(super) fn write(&mut self, window: &Window, facts: &Facts, layout: &Layout, names: &[InterfaceName]) {
        self.due = None;
        self.written += 1;
        match self.write_file(window, facts, layout, names) {
            Ok(path) => streams::warn(format_args!("mrroc: the last {:?} are in {}", self.span, path.display())),
            Err(error) => streams::warn(format_args!("mrroc: the last {:?} cannot be written: {error:#}", self.span)),
        }
    }

    fn write_file(
        &self,
        window: &Window,
        facts: &Facts,
        layout: &Layout,
        names: &[InterfaceName],
    ) -> anyhow::Result<PathBuf> {
        let (path, mcap) = self.new_file()?;
        let log = path.with_extension("log");
        let frames = create(&log).with_context(|| log.display().to_string())?;
        let mut frames = BufWriter::new(frames);
        let mut facts = facts.clone();
        facts.texts.insert("whole".to_owned(), window.is_whole().to_string());
        let mut mcap = McapFile::new(mcap, &facts, layout.channels())?;
        window.try_each(|channel, time, number, body| {
            mcap.write(channel, time, number, body)?;
            let bus = names.iter().enumerate().find(|(bus, _)| layout.bus(*bus) == channel);
            if let Some((_, name)) = bus
                && let Some(entry) = BusEvent::decode(body)?.entry(time)
                && let TraceEvent::Frame(traced) = entry.event
            {
                writeln!(frames, "{}", candump_line(*name, traced))?;
            }
            anyhow::Ok(())
        })?;
        frames.flush()?;
        mcap.finish()?;
        Ok(path)
    }

    /// A new file with the first free number. Nothing that exists is opened, and no link is followed.
    fn new_file(&self) -> anyhow::Result<(PathBuf, File)> {
        for number in 1..=LAST {
            let path = self.directory.join(format!("flight-{}-{number}.mcap", self.cell));
            match create(&path) {
                Ok(file) => return Ok((path, file)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).context(path.display().to_string()),
            }
        }
        bail!("{} is full of files of earlier flights", self.directory.display())
    }
}

fn create(path: &Path) -> std::io::Result<File> {
    File::options().write(true).create_new(true).custom_flags(libc::O_NOFOLLOW).open(path)
}
