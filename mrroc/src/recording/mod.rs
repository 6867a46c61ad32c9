//! Recordings of a run: every cycle, frame and telegram, and all that a replay needs.
//!
//! A recording is an MCAP file of the Protobuf messages in `messages`, with the frames of the buses in a candump log
//! beside it. `--record FILE.mcap` streams a whole run. The flight recorder keeps the last seconds in memory and writes
//! them after a fault and on request. Both are fed by the thread that writes the files of a run, from the queues of the
//! servo thread: the cycle stores fixed-size entries, and neither allocates nor waits for a file.
//!
//! Protobuf and not JSON, because a cycle of an axis has 60 bytes instead of 250, floating-point numbers are exact, and
//! tools such as PlotJuggler and Foxglove plot the fields of both.
//!
//! Read `Recorder` for what is written, [`replay`](self::replay()) for how a recording runs again.

mod contents;
#[cfg(test)]
pub(crate) mod damage_tests;
mod difference;
mod entries;
mod file;
mod flight;
mod input;
mod messages;
#[cfg(test)]
mod omission_tests;
#[cfg(test)]
mod part_tests;
mod reader;
mod replay;
mod replaying;
mod samples;
mod schema;
mod sources;
mod window;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use can::{Instant, InterfaceName, TraceEntry, TraceEvent, candump};
use prost::Message;
use serial::LineEntry;
use servo::{JournalEvent, JournalReader, Record};

use crate::bench::BenchKind;
use crate::cell::{CellFile, printable};
use crate::devices::OwnKind;
use crate::frame_order::FrameOrder;
use crate::outputs::Outputs;
use crate::row_file::{FileName, IncompleteFile, RowFile};
use crate::run::RunOptions;
use crate::streams;
use file::McapFile;
use messages::{BusEvent, Call, LineData, Lost, RobotCycle, RobotFault, RobotOrder, Timing, Word};
use samples::DeviceSample;
use window::Window;

pub use difference::Difference;
pub(crate) use file::Facts;
pub use flight::Flights;
pub use reader::Damage;
pub use replay::{Replay, ReplayOptions, replay};
pub(crate) use sources::{Layout, words};

/// Number of drains after which the file is completed on the disk: half a second at 20 ms.
const DRAINS: u32 = 25;

/// Time of the run after which the file is completed on the disk.
const FLUSH: Duration = Duration::from_millis(500);

/// The sinks of a recording.
pub(crate) struct Recorder {
    layout: Layout,
    facts: Facts,
    journal: JournalReader,
    /// Robots and axes, for faults in words.
    file: Arc<CellFile>,
    interfaces: Vec<InterfaceName>,
    stream: Option<Stream>,
    window: Option<Window>,
    flights: Option<Flights>,
    /// Next number of a message, by channel.
    numbers: Vec<u32>,
    body: Vec<u8>,
    latest: Instant,
    lost: u64,
    /// Number of the next cycle of each robot, and cycles that found no room.
    next: Vec<u64>,
    gaps: u64,
}

/// A recording of the whole run.
struct Stream {
    name: FileName,
    /// `None` after a failure.
    mcap: Option<McapFile>,
    /// The frames of the buses, in the order of time; `None` for a cell without a CAN bus.
    frames: Option<RowFile>,
    order: FrameOrder,
    drains: u32,
    flushed: Instant,
    /// Number of messages since the file was completed on the disk, and time of the first.
    pending: (u64, Option<Instant>),
    incomplete: Option<IncompleteFile>,
}

impl Recorder {
    /// A recorder of `journal` without sinks.
    pub(crate) fn new(file: &Arc<CellFile>, facts: Facts, journal: JournalReader, names: Vec<InterfaceName>) -> Self {
        let layout = Layout::of(file);
        Self {
            numbers: vec![0; layout.channels().len()],
            layout,
            facts,
            journal,
            file: Arc::clone(file),
            interfaces: names,
            stream: None,
            window: None,
            flights: None,
            body: Vec::with_capacity(4096),
            latest: Instant::ZERO,
            lost: 0,
            next: vec![0; file.cell.robot.len()],
            gaps: 0,
        }
    }

    /// Streams the whole run to `mcap` under the name `path`, and the frames of the buses to `frames`.
    pub(crate) fn stream_to(&mut self, path: &Path, mcap: File, frames: Option<File>) -> anyhow::Result<()> {
        let mcap = McapFile::new(mcap, &self.facts, self.layout.channels())?;
        let log = FileName::new("--record", &path.with_extension("log"), "frames");
        self.stream = Some(Stream {
            name: FileName::new("--record", path, "messages"),
            mcap: Some(mcap),
            frames: frames.map(|frames| RowFile::new(log, frames, "")).transpose()?,
            order: FrameOrder::default(),
            drains: 0,
            flushed: Instant::ZERO,
            pending: (0, None),
            incomplete: None,
        });
        Ok(())
    }

    /// Keeps the last seconds in memory, for `flights`.
    pub(crate) fn keep_window(&mut self, flights: Flights) {
        self.window = Some(Window::new(flights.span(), flights.messages(), flights.bytes()));
        self.flights = Some(flights);
    }

    /// Takes the journal of the servo.
    pub(crate) fn drain_journal(&mut self) {
        while let Some(entry) = self.journal.read() {
            let now = entry.now;
            match entry.event {
                JournalEvent::BringUp { stop } => self.call(now, &Call { stop, ..named("bring_up") }),
                JournalEvent::Cycle { number, missed, stop, rate } => {
                    self.call(now, &Call { cycle: number, missed, stop, rate, ..named("cycle") });
                }
                JournalEvent::Sent => self.call(now, &named("sent")),
                JournalEvent::Cut => self.call(now, &named("cut")),
                JournalEvent::Orders { effector, count } => {
                    for _ in 0..count {
                        let Some(order) = self.journal.order() else { break };
                        self.message(self.layout.orders(), now, &RobotOrder::of(effector, &order));
                    }
                }
                JournalEvent::Fault { effector, fault } => {
                    let message = RobotFault::of(&self.file, effector.into(), fault);
                    self.message(self.layout.faults(), now, &message);
                    if let (Some(flights), true) = (&mut self.flights, fault.is_some()) {
                        flights.fault_at(now);
                    }
                }
                JournalEvent::Word { index, value } => {
                    self.message(self.layout.words(), now, &Word { index: index.into(), value });
                }
                JournalEvent::Timing { late, step } => {
                    self.message(self.layout.timing(), now, &Timing::of(late, step));
                }
            }
        }
    }

    /// Takes a record of the servo.
    pub(crate) fn record(&mut self, record: &Record) {
        let robot = usize::from(record.effector);
        self.gaps += record.cycle.saturating_sub(self.next[robot]);
        self.next[robot] = record.cycle + 1;
        self.message(self.layout.robot(record.effector.into()), record.at, &RobotCycle::of(record));
    }

    /// Takes a result of the port of bus `bus`.
    pub(crate) fn bus(&mut self, bus: usize, entry: &TraceEntry) {
        self.message(self.layout.bus(bus), entry.now, &BusEvent::of(entry));
        if let (Some(stream), TraceEvent::Frame(traced)) = (&mut self.stream, entry.event) {
            stream.order.push(bus, traced);
        }
    }

    /// Takes a result of line `line`.
    pub(crate) fn line(&mut self, line: usize, entry: &LineEntry) {
        self.message(self.layout.line(line), entry.now, &LineData::of(entry));
    }

    /// Takes a sample of device `device`; `None`: its last sample is not valid any more.
    pub(crate) fn sample(&mut self, device: usize, at: Instant, sample: Option<&drive::device::DeviceSample>) {
        let message = DeviceSample::of(sample, self.layout.devices()[device]);
        self.message(self.layout.device(device), at, &message);
    }

    /// Completes a drain: writes what is due to the disk. `lost`: entries of all queues that found no room.
    pub(crate) fn drained(&mut self, lost: u64) {
        let lost = lost + self.journal.lost() + self.gaps;
        if lost > self.lost {
            self.lost = lost;
            self.message(self.layout.lost(), self.latest, &Lost { entries: lost });
        }
        if let Some(stream) = &mut self.stream {
            stream.write_frames(&self.interfaces, FrameOrder::next);
            stream.drains += 1;
            if stream.drains >= DRAINS || self.latest.since(stream.flushed) >= FLUSH {
                (stream.drains, stream.flushed) = (0, self.latest);
                stream.flush();
            }
        }
        if self.flights.as_mut().is_some_and(|flights| flights.is_due(self.latest)) {
            self.write_flight();
        }
    }

    /// Completes the files, and returns those that are incomplete. `faulted`: the run ended in a fault, of a robot or of the
    /// task.
    pub(crate) fn finish(mut self, lost: u64, faulted: bool) -> Vec<IncompleteFile> {
        self.drained(lost);
        if self.flights.as_ref().is_some_and(|flights| flights.is_wanted(faulted)) {
            self.write_flight();
        }
        self.stream.map_or_else(Vec::new, |stream| stream.finish(&self.interfaces))
    }

    fn write_flight(&mut self) {
        if let (Some(flights), Some(window)) = (&mut self.flights, &self.window) {
            flights.write(window, &self.facts, &self.layout, &self.interfaces);
        }
    }

    fn call(&mut self, now: Instant, call: &Call) {
        self.message(self.layout.calls(), now, call);
    }

    fn message(&mut self, channel: u16, time: Instant, message: &impl Message) {
        self.body.clear();
        // A vector grows as needed, so encoding cannot fail.
        let _ = message.encode(&mut self.body);
        self.latest = self.latest.max(time);
        let number = &mut self.numbers[usize::from(channel)];
        *number = number.wrapping_add(1);
        if let Some(window) = &mut self.window {
            window.push(channel, time, *number, &self.body);
        }
        if let Some(stream) = &mut self.stream {
            stream.write(channel, time, *number, &self.body);
        }
    }
}

impl Stream {
    fn write(&mut self, channel: u16, time: Instant, number: u32, body: &[u8]) {
        if let Some(incomplete) = &mut self.incomplete {
            incomplete.lost += 1;
        } else if let Some(mcap) = &mut self.mcap {
            self.pending = (self.pending.0 + 1, self.pending.1.or(Some(time)));
            let written = mcap.write(channel, time, number, body);
            self.note(written);
        }
    }

    /// Ends the recording at its first failure, with a warning. The run goes on.
    fn note(&mut self, written: anyhow::Result<()>) {
        let Err(error) = written else { return };
        let known = error.chain().find_map(|cause| cause.downcast_ref::<io::Error>());
        let other = io::Error::other(format!("{error:#}"));
        let (lost, first) = self.pending;
        self.incomplete
            .get_or_insert_with(|| IncompleteFile { lost, ..self.name.ends(known.unwrap_or(&other), first) });
        // The file keeps what was written, without its end.
        self.mcap = None;
    }

    fn flush(&mut self) {
        if let Some(mcap) = &mut self.mcap {
            let flushed = mcap.flush();
            self.note(flushed);
        }
        self.pending = (0, None);
        if let Some(frames) = &mut self.frames {
            frames.flush();
        }
    }

    /// Writes the frames that `next` takes from the order of frames.
    fn write_frames(
        &mut self,
        names: &[InterfaceName],
        next: impl Fn(&mut FrameOrder) -> Option<(usize, can::Traced)>,
    ) {
        while let Some((bus, traced)) = next(&mut self.order) {
            let line = candump_line(names[bus], traced);
            if let Some(frames) = &mut self.frames {
                frames.row(traced.at, |row| write!(row, "{line}"));
            }
        }
    }

    fn finish(mut self, names: &[InterfaceName]) -> Vec<IncompleteFile> {
        self.write_frames(names, FrameOrder::rest);
        if let Some(mcap) = self.mcap.take() {
            let finished = mcap.finish(true);
            self.note(finished);
        }
        self.incomplete.into_iter().chain(self.frames.and_then(|frames| frames.finish(0))).collect()
    }
}

fn named(kind: &str) -> Call {
    Call { kind: kind.to_owned(), ..Call::default() }
}

fn candump_line(interface: InterfaceName, traced: can::Traced) -> candump::Entry {
    candump::Entry { at: traced.at, interface, frame: traced.frame, direction: Some(traced.direction) }
}

/// A recording: its path, the file in MCAP, and the candump log beside it.
pub(crate) type Files<'a> = (&'a Path, File, Option<File>);

/// The files of a recording. A cell without a CAN bus has no candump log.
pub(crate) fn open<'a>(outputs: &mut Outputs, path: &'a Path, file: &CellFile) -> anyhow::Result<Files<'a>> {
    let mcap = outputs.open("--record", path)?;
    let log = path.with_extension("log");
    let has_buses = !file.cell.bus.is_empty();
    let log = has_buses.then(|| outputs.open("--record, its candump log", &log)).transpose()?;
    Ok((path, mcap, log))
}

/// The directory of the flight recorder, if the run has one.
pub(crate) fn flight_directory(file: &CellFile, options: &RunOptions) -> anyhow::Result<Option<PathBuf>> {
    let default = (options.bench == BenchKind::Card).then(|| PathBuf::from("."));
    let directory = match options.flight.clone() {
        Some(_) if file.cell.flight_recorder_s == 0 => {
            bail!("--flight needs flight_recorder_s above 0 in the cell file")
        }
        given => given.or(default).filter(|_| file.cell.flight_recorder_s > 0),
    };
    if let Some(directory) = &directory
        && !directory.is_dir()
    {
        bail!("--flight: {} is no directory", directory.display());
    }
    if let Some(directory) = &directory
        && let Err(error) = flight::probe(directory)
    {
        let place = directory.display();
        if options.flight.is_some() {
            bail!("--flight: {place}: no file can be made there: {error}: name another directory");
        }
        streams::warn(format_args!(
            "mrroc: the flight recorder can make no file in the working directory: {error}: name a directory by --flight"
        ));
    }
    Ok(directory)
}

/// Prefix of the keys of the facts that name kind and crate of a device of another crate.
const DEVICE: &str = "device ";

/// Text between kind and crate in such a fact. The name of a crate has no space, the name of a kind may have one.
const OF_CRATE: &str = " of the crate ";

/// The kind in a fact of a device.
fn kind_of(fact: &str) -> &str {
    fact.rsplit_once(OF_CRATE).map_or(fact, |(kind, _)| kind)
}

impl Facts {
    /// Refuses a recording with a kind of device that this program does not know.
    fn check_devices(&self) -> anyhow::Result<()> {
        for (name, kind) in self.texts.iter().filter_map(|(key, kind)| Some((key.strip_prefix(DEVICE)?, kind))) {
            if OwnKind::named(kind_of(kind)).is_err() {
                let (name, kind) = (printable(name), printable(kind));
                bail!("device {name} is of kind {kind}, which this program does not know: replay by a program with it");
            }
        }
        Ok(())
    }

    /// The version, the bench, the UTC of the zero of the run's times, and the files that a run reads.
    pub(crate) fn of_run(file: &CellFile, bench: BenchKind, utc_of_zero: Option<u64>) -> anyhow::Result<Self> {
        let directory = file.path.parent().unwrap_or(Path::new(""));
        let name = |path: &Path| path.strip_prefix(directory).unwrap_or(path).to_string_lossy().into_owned();
        let mut files = vec![(name(&file.path), file.text.clone().into_bytes())];
        for path in file.named_files() {
            let bytes = file.inputs().bytes(path).with_context(|| format!("{} was not read", path.display()))?;
            files.push((name(path), bytes.to_vec()));
        }
        let texts = [("version", env!("CARGO_PKG_VERSION")), ("bench", bench.name()), ("cell", &file.cell.name)];
        let mut texts: BTreeMap<_, _> = texts.map(|(key, text)| (key.to_owned(), text.to_owned())).into();
        texts.extend(file.cell.device.iter().map(|device| {
            let kind = format!("{}{OF_CRATE}{}", device.own.kind(), device.own.of_crate());
            (format!("{DEVICE}{}", device.keys.name), kind)
        }));
        Ok(Self { texts, utc_of_zero, files })
    }
}

/// A request to write the last seconds, from a signal or a program.
#[derive(Clone, Debug, Default)]
pub struct FlightRequest(pub Arc<AtomicBool>);

impl FlightRequest {
    /// Requests the file. The request is obeyed within some 20 ms.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }
}
