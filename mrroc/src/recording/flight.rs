//! The flight recorder: files with the last seconds, after a fault and on request.

use std::fs::{self, File};
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
use crate::frame_order::FrameOrder;
use crate::streams;

/// Time of the run after a fault that the file contains.
const AFTER: Duration = Duration::from_secs(1);

/// Most files of one run after faults. The first faults show the cause, so their files are kept and later faults have
/// none. Requests are always obeyed, and do not count.
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
    /// Files so far.
    written: u32,
    /// Files after faults.
    after_faults: u32,
    /// A fault without a file was reported.
    reported: bool,
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
        // Calls, timing and orders; one message each per robot; frames and telegrams of both directions; samples.
        let others = frames + 3 * lines + cell.device.len();
        let messages = 4 + cell.robot.len() + others;
        let bytes = 4 * CALL + axes.map(|axes| ROBOT + axes * AXIS).sum::<usize>() + others * FRAME;
        Self {
            directory: directory.to_owned(),
            cell: cell.name.clone(),
            span,
            messages: cycles * messages,
            bytes: cycles * bytes,
            request,
            due: None,
            written: 0,
            after_faults: 0,
            reported: false,
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

    /// Notes a fault at `time`, and reports the first fault beyond the greatest number of files.
    pub(super) fn fault_at(&mut self, time: Instant) {
        if self.note_fault(time) {
            streams::warn(format_args!(
                "mrroc: the flight recorder has written {MOST} files after faults, and writes no file after this fault \
                 and later ones; SIGUSR1 still writes a file"
            ));
        }
    }

    /// Notes a fault at `time`. Faults within a second share a file. Returns whether this fault is the first one without
    /// a file.
    fn note_fault(&mut self, time: Instant) -> bool {
        if self.due.is_some() || self.after_faults < MOST {
            self.due.get_or_insert(time + AFTER);
            return false;
        }
        !std::mem::replace(&mut self.reported, true)
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
        self.begin_file();
        match self.write_file(window, facts, layout, names) {
            Ok(path) => streams::warn(format_args!("mrroc: the last {:?} are in {}", self.span, path.display())),
            Err(error) => streams::warn(format_args!(
                "mrroc: the last {:?} cannot be written: {error:#}: free space on the disk, or name another directory by --flight",
                self.span
            )),
        }
    }

    /// Counts a file. A file on request serves a fault as well that waits for its file.
    fn begin_file(&mut self) {
        self.written += 1;
        self.after_faults += u32::from(self.due.take().is_some());
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
        // A cell without a CAN bus has no log.
        let frames = match (!names.is_empty()).then(|| create(&log)).transpose() {
            Ok(frames) => frames,
            Err(error) => {
                let _ = fs::remove_file(&path);
                return Err(error).context(log.display().to_string());
            }
        };
        self.fill(mcap, frames, window, facts, layout, names).with_context(|| {
            let made = [Some(&path), (!names.is_empty()).then_some(&log)].into_iter().flatten();
            let left: Vec<_> = made.filter(|path| fs::remove_file(path).is_err()).collect();
            match left.is_empty() {
                true => format!("{}: the part that was written is removed", path.display()),
                false => format!("{}: the file is partial", path.display()),
            }
        })?;
        Ok(path)
    }

    fn fill(
        &self,
        mcap: File,
        frames: Option<File>,
        window: &Window,
        facts: &Facts,
        layout: &Layout,
        names: &[InterfaceName],
    ) -> anyhow::Result<()> {
        let mut order = FrameOrder::default();
        let mut facts = facts.clone();
        facts.texts.insert("whole".to_owned(), window.is_whole().to_string());
        let mut mcap = McapFile::new(mcap, &facts, layout.channels())?;
        window.try_each(|channel, time, number, body| {
            mcap.write(channel, time, number, body)?;
            let bus = (0..names.len()).find(|bus| layout.bus(*bus) == channel);
            if let Some(bus) = bus
                && let Some(entry) = BusEvent::decode(body)?.entry(time)
                && let TraceEvent::Frame(traced) = entry.event
            {
                order.push(bus, traced);
            }
            anyhow::Ok(())
        })?;
        if let Some(frames) = frames {
            let mut frames = BufWriter::new(frames);
            while let Some((bus, traced)) = order.rest() {
                writeln!(frames, "{}", candump_line(names[bus], traced))?;
            }
            frames.flush()?;
        }
        // The last call of the servo may be under way.
        mcap.finish(false)
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

/// Fails if no file can be made in `directory`: makes a file and removes it.
pub(super) fn probe(directory: &Path) -> std::io::Result<()> {
    let path = directory.join(format!(".mrroc-flight-{}", std::process::id()));
    drop(create(&path)?);
    fs::remove_file(path)
}

fn create(path: &Path) -> std::io::Result<File> {
    File::options().write(true).create_new(true).custom_flags(libc::O_NOFOLLOW).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_that_cannot_be_completed_leaves_no_file() {
        let file = crate::tasks::tests::two_arms();
        let directory = tempfile::tempdir().unwrap();
        let flights = Flights::new(&file, directory.path(), FlightRequest::default());
        let mut window = Window::new(Duration::from_secs(1), 10, 100);
        // The body of a frame that cannot be decoded fails as a full disk does, after the files were made.
        let layout = Layout::of(&file);
        window.push(layout.bus(0), Instant::ZERO, 1, &[0xFF]);
        let names = [InterfaceName::new("can0").unwrap()];
        let error = flights.write_file(&window, &Facts::default(), &layout, &names).unwrap_err();
        assert!(format!("{error:#}").contains("the part that was written is removed"), "{error:#}");
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_directory_without_writing_is_found_before_the_run() {
        assert!(probe(Path::new("/proc")).is_err());
        let directory = tempfile::tempdir().unwrap();
        probe(directory.path()).unwrap();
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[test]
    fn first_fault_beyond_the_greatest_number_of_files_is_reported_once() {
        let file = crate::tasks::tests::two_arms();
        let request = FlightRequest::default();
        let mut flights = Flights::new(&file, Path::new("."), request.clone());
        let mut now = Instant::ZERO;
        for fault in 0..MOST {
            now += 10 * AFTER;
            assert!(!flights.note_fault(now) && !flights.note_fault(now + AFTER / 2), "fault {fault}");
            assert!(!flights.is_due(now + AFTER / 2) && flights.is_due(now + AFTER), "fault {fault}");
            flights.begin_file();
            assert!(!flights.is_due(now + 5 * AFTER), "fault {fault}");
            // A file on request is no file after a fault.
            request.request();
            assert!(flights.is_due(now + 6 * AFTER), "fault {fault}");
            flights.begin_file();
        }
        now += 10 * AFTER;
        assert!(flights.note_fault(now), "reported");
        assert!(!flights.note_fault(now + 10 * AFTER), "not reported again");
        assert!(!flights.is_due(now + 20 * AFTER) && !flights.is_wanted(true));
        request.request();
        assert!(flights.is_due(now + 20 * AFTER), "a request is obeyed");
    }
}
