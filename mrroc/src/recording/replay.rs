//! Replay of a recording through the drivers and the servo, in the time of the recording.
//!
//! Ports and lines give the recorded results in the recorded calls. The servo gets the recorded orders, stop requests,
//! overrides and missed deadlines in their cycles, and drivers and laws the recorded words. The outputs are compared with
//! the recorded outputs message by message: cycles of robots, faults, sent frames and sent bytes.

use std::fmt::{self, Display, Formatter};
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::task::Poll;

use anyhow::{Context, anyhow, bail};
use can::candump::Direction;
use can::{Instant, Port, ReplayPort, TraceEntry, TraceEvent, TraceReader, Tracer};
use drive::Word;
use prost::Message;
use serde::Serialize;
use serial::{Line, LineEntry, LineEvent, LineTraceReader, LineTracer, ReplayLine};
use servo::{EffectorLink, JournalEvent, JournalReader, Order, Record, Servo, SpeedOverride};

use super::content::{Content, Damage};
use super::difference::{Comparison, Difference, Kind};
use super::entries::{Entry, entries};
use super::messages::{BusEvent, Call, LineData, RobotCycle, RobotFault, RobotOrder, Word as WordMessage};
use super::sources::{Layout, words};
use crate::cell::CellFile;
use crate::{input, run, setup};

/// Largest recording that is read.
const LARGEST: usize = 4 << 30;

/// Frames and telegrams of one cycle at a port or line, at most.
const TRACE: usize = 1 << 12;

/// What a recording is replayed with.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    /// A cell file in place of the recorded one.
    pub cell: Option<PathBuf>,
}

/// Result of a replay.
#[derive(Clone, Debug, Serialize)]
pub struct Replay {
    /// The recording.
    pub file: PathBuf,
    /// Version that made the recording.
    pub recorded_by: String,
    /// Name of the cell.
    pub cell: String,
    /// Bench of the recorded run.
    pub bench: String,
    /// Replayed cycles.
    pub cycles: u64,
    /// Time of the last replayed call, s.
    pub end_s: f64,
    /// Outputs that are equal bit for bit: cycles of robots, faults, frames and parts of telegrams.
    pub equal: u64,
    /// How the file ends, if it ends before its end. All whole chunks were replayed.
    pub cut: Option<String>,
    /// First damage of the file. Only the cycles before it were replayed.
    pub damaged: Option<Damage>,
    /// Number of the last replayed cycle, from 0; absent if only the bring-up was replayed.
    pub last_cycle: Option<u64>,
    /// Number and time of the first cycle with a difference; absent in a bring-up.
    pub differs_in: Option<Place>,
    /// The differences of this cycle; empty if all outputs are equal.
    pub differences: Vec<Difference>,
}

/// A place in a recording.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Place {
    /// Number of the cycle, from 0; absent in the bring-up.
    pub cycle: Option<u64>,
    /// Time, s.
    pub time_s: f64,
}

impl Replay {
    /// Whether all outputs are equal.
    pub fn is_equal(&self) -> bool {
        self.differences.is_empty()
    }
}

impl Display for Replay {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { recorded_by, cell, bench, cycles, equal, .. } = self;
        writeln!(f, "recording of cell {cell} on bench {bench} by mrroc {recorded_by}")?;
        let cycle = self.last_cycle.map_or_else(|| "no cycle".to_owned(), |cycle| format!("cycle {cycle}"));
        let reach = format!("replayed up to {cycle}, at {:.3} s", self.end_s);
        if let Some(cut) = &self.cut {
            writeln!(f, "the recording was cut: {cut}: {reach}")?;
        }
        if let Some(Damage { byte, what }) = &self.damaged {
            writeln!(f, "{}: damaged at byte {byte} ({what}): {reach}", self.file.display())?;
        }
        match (self.differs_in, self.differences.first()) {
            (Some(Place { cycle: Some(cycle), time_s }), Some(first)) => {
                writeln!(f, "differs first in cycle {cycle}, at {time_s:.6} s: {first}")
            }
            (Some(Place { time_s, .. }), Some(first)) => {
                writeln!(f, "differs in the bring-up at {time_s:.6} s: {first}")
            }
            _ => writeln!(f, "{cycles} cycles replayed, {equal} outputs equal bit for bit"),
        }
    }
}

/// Replays the recording `path`.
pub fn replay(path: &Path, options: &ReplayOptions) -> anyhow::Result<Replay> {
    let name = || path.display().to_string();
    let bytes = input::read(path, LARGEST).with_context(name)?;
    let content = match Content::read(&bytes) {
        Ok(content) => content,
        Err(error) => {
            let advised = match beside(path) {
                Some(advice) => anyhow!("{error:#}: {advice}"),
                None => error,
            };
            return Err(advised.context(name()));
        }
    };
    drop(bytes);
    if content.facts.texts.get("whole").is_some_and(|whole| whole != "true") {
        bail!(
            "{}: the file has only the last seconds of a run, and a replay needs all since the bring-up: record the run by \
             --record FILE.mcap",
            path.display()
        );
    }
    let directory = tempfile::tempdir().context("no directory for the recorded cell file")?;
    let file = match (&options.cell, missing(&content)) {
        (Some(cell), _) => CellFile::read(cell)?,
        (None, None) => recorded_cell(&content, directory.path()).with_context(name)?,
        // What is read of a damaged file before its damage may be incomplete.
        (None, Some(missing)) => recorded_cell(&content, directory.path()).context(missing).with_context(name)?,
    };
    let result = Replaying::new(path, content, &file).and_then(Replaying::go);
    result.with_context(name)
}

/// Why a file may lack parts that a replay needs; `None` for a complete file.
fn missing(content: &Content) -> Option<String> {
    let damage = content.damage.as_ref().map(|Damage { byte, what }| format!("damaged at byte {byte} ({what})"));
    damage.or(content.cut.as_ref().map(|cut| format!("the recording was cut: {cut}")))
}

/// The recording beside the candump log `path`, in words.
fn beside(path: &Path) -> Option<String> {
    let recording = path.with_extension("mcap");
    let is_log = path.extension().is_some_and(|extension| extension == "log");
    (is_log && recording.is_file())
        .then(|| format!("a candump log has only the frames of a recording: replay {}", recording.display()))
}

/// The recorded cell file with its device configuration files, in `directory`.
fn recorded_cell(content: &Content, directory: &Path) -> anyhow::Result<CellFile> {
    let mut cell = None;
    for (name, bytes) in &content.facts.files {
        let path = Path::new(name);
        if !path.components().all(|part| matches!(part, Component::Normal(_))) {
            continue;
        }
        let path = directory.join(path);
        fs::create_dir_all(path.parent().unwrap_or(directory))?;
        fs::write(&path, bytes)?;
        cell.get_or_insert(path);
    }
    CellFile::read(cell.context("no cell file can be read from the recording")?)
}

/// A call of the servo with what came before it.
struct Step {
    now: Instant,
    call: Call,
    orders: Vec<RobotOrder>,
    words: Vec<WordMessage>,
}

/// A replay under way.
struct Replaying {
    servo: Servo,
    links: Vec<EffectorLink>,
    words: Vec<Word>,
    speed: SpeedOverride,
    journal: JournalReader,
    records: rtrb::Consumer<Record>,
    buses: Vec<TraceReader>,
    lines: Vec<LineTraceReader>,
    layout: Layout,
    file: CellFile,
    steps: Vec<Step>,
    comparison: Comparison,
    body: Vec<u8>,
    result: Replay,
}

impl Replaying {
    fn new(path: &Path, mut content: Content, file: &CellFile) -> anyhow::Result<Self> {
        let layout = Layout::of(file);
        let topics = layout.channels().iter().map(|channel| channel.topic.as_str());
        if !topics.eq(content.channels.values().map(|(topic, _)| topic.as_str())) {
            if let Some(missing) = missing(&content) {
                bail!("{missing}: the channels before are not those of the cell, and no cycle can be replayed");
            }
            bail!("the cell has other robots, axes, buses or lines than the recording");
        }
        let cell = &file.cell;
        let messages = entries(&layout, &mut content);
        let mut comparison = Comparison::new(!content.complete);
        let mut add = |channel: u16, kind| {
            comparison.add_channel(channel, kind, &layout.channels()[usize::from(channel)].topic);
        };
        add(layout.faults(), Kind::Fault);
        (0..cell.robot.len()).for_each(|robot| add(layout.robot(robot), Kind::Robot));
        (0..cell.bus.len()).for_each(|bus| add(layout.bus(bus), Kind::Bus));
        (0..layout.lines()).for_each(|line| add(layout.line(line), Kind::Line));

        let text = |key: &str| content.facts.texts.get(key).cloned().unwrap_or_default();
        let result = Replay {
            file: path.to_owned(),
            recorded_by: text("version"),
            cell: cell.name.clone(),
            bench: text("bench"),
            cycles: 0,
            end_s: 0.0,
            equal: 0,
            cut: content.cut.clone(),
            damaged: content.damage.clone(),
            last_cycle: None,
            differs_in: None,
            differences: Vec::new(),
        };
        let mut steps = Vec::<Step>::new();
        let mut buses: Vec<Vec<TraceEntry>> = vec![Vec::new(); cell.bus.len()];
        let mut lines: Vec<Vec<LineEntry>> = vec![Vec::new(); layout.lines()];
        for (message, entry) in messages {
            match entry {
                Entry::Call(call) => {
                    steps.push(Step { now: message.time, call, orders: Vec::new(), words: Vec::new() });
                }
                Entry::Order(order) => steps.last_mut().context("an order precedes the first call")?.orders.push(order),
                Entry::Word(word) => steps.last_mut().context("a word precedes the first call")?.words.push(word),
                Entry::Lost(lost) => {
                    bail!("{} entries of the recording found no room, so it cannot be replayed", lost.entries)
                }
                Entry::Line(line, entry) => {
                    lines[line].push(entry);
                    if is_sent_bytes(&entry) {
                        comparison.expect(message);
                    }
                }
                Entry::Bus(bus, entry) => {
                    buses[bus].push(entry);
                    if is_sent_frame(&entry) {
                        comparison.expect(message);
                    }
                }
                Entry::Other => comparison.expect(message),
            }
        }
        if !content.complete {
            // The last call may have been under way.
            steps.pop();
        }
        if let (true, Some(missing)) = (steps.is_empty(), missing(&content)) {
            bail!("{missing}: no cycle before can be replayed");
        }
        let (ports, buses) = buses.into_iter().map(traced_port).unzip();
        let mut traced = lines.into_iter().map(traced_line);
        let mut readers = Vec::new();
        let mut take = |count: usize| -> Vec<Box<dyn Line>> {
            let lines = traced.by_ref().take(count).map(|(line, reader)| {
                readers.push(reader);
                line
            });
            lines.collect()
        };
        let bundles = cell.bus.len()..cell.bus.len() + cell.serial.len();
        let bundles = bundles.map(|group| take(cell.axes_on(group).count())).collect();
        let sensor_lines = take(usize::MAX);
        let mut devices = setup::devices(file, ports, bundles, sensor_lines, None)?;
        let config = setup::servo_config(file);
        let (mut servo, links) = Servo::new(&config, std::mem::take(&mut devices.groups))?;
        let force = setup::force_sensors(file, &devices.sensors, &links);
        setup::install_laws(file, &mut servo, &force)?;
        let words = words(&devices, &force);
        let speed = SpeedOverride::default();
        servo.follow_override(speed.clone());
        let taken = words.iter().map(|word| word.taken.clone()).collect();
        let orders = config.effectors.iter().map(|effector| effector.queue).sum();
        let journal = servo.keep_journal(TRACE, orders, taken);
        let records = servo.record(4 * cell.robot.len());
        Ok(Self {
            servo,
            links,
            words,
            speed,
            journal,
            records,
            buses,
            lines: readers,
            layout,
            file: file.clone(),
            steps,
            comparison,
            body: Vec::new(),
            result,
        })
    }

    fn go(mut self) -> anyhow::Result<Replay> {
        let (mut up, mut place) = (None, Place { cycle: None, time_s: 0.0 });
        for step in std::mem::take(&mut self.steps) {
            self.comparison.missing_before(step.now);
            // A cycle with a difference is completed, so that its frames are compared too.
            if !self.comparison.found.is_empty() && step.call.kind != "sent" {
                break;
            }
            place.time_s = step.now.since(Instant::ZERO).as_secs_f64();
            if step.call.kind == "cycle" {
                place.cycle = Some(step.call.cycle);
                if let Some(problem) = not_up(&self.file, up.take()) {
                    self.comparison.found.push(problem);
                    break;
                }
            }
            let progress = self.call(&step)?;
            if step.call.kind == "bring_up" {
                up = Some(progress);
            }
            self.compare();
        }
        (self.result.equal, self.result.end_s) = (self.comparison.equal, place.time_s);
        self.result.last_cycle = place.cycle;
        self.result.differences = self.comparison.found;
        self.result.differs_in = (!self.result.differences.is_empty()).then_some(place);
        Ok(self.result)
    }

    /// Repeats a call with what came before it.
    fn call(&mut self, step: &Step) -> anyhow::Result<Poll<Result<(), servo::NotUp>>> {
        let Step { now, call, .. } = step;
        for word in &step.words {
            let index = usize::try_from(word.index)?;
            let known = self.words.get_mut(index).context("the recording has a word that the cell lacks")?;
            (known.repeat)(word.value);
        }
        for order in &step.orders {
            let link = self.links.get_mut(usize::try_from(order.robot)?).context("an order to no robot of the cell")?;
            let order: Order = order.order().context("an unknown order")?;
            // A queue that is full here was not in the recording, so the outputs differ as well.
            let _ = link.orders.push(order);
        }
        if call.stop {
            self.servo.stop_request().request();
        }
        let mut progress = Poll::Pending;
        match call.kind.as_str() {
            "bring_up" => progress = self.servo.bring_up(*now),
            "cycle" => {
                self.speed.set(call.rate)?;
                if call.missed > 0 {
                    self.servo.missed(call.missed);
                }
                self.servo.prepare(*now);
                self.result.cycles += 1;
            }
            "sent" => self.servo.send(*now),
            "cut" => self.servo.cut_power(*now),
            other => bail!("unknown call {other:?}: the recording is of a newer version"),
        }
        Ok(progress)
    }

    /// Compares the outputs since the last call.
    fn compare(&mut self) {
        while let Some(entry) = self.journal.read() {
            match entry.event {
                JournalEvent::Orders { count, .. } => {
                    (0..count).for_each(|_| {
                        let _ = self.journal.order();
                    });
                }
                JournalEvent::Fault { effector, fault } => {
                    let message = RobotFault::of(&self.file, effector.into(), fault);
                    self.output(self.layout.faults(), entry.now, &message);
                }
                _ => {}
            }
        }
        while let Ok(record) = self.records.pop() {
            self.output(self.layout.robot(record.effector.into()), record.at, &RobotCycle::of(&record));
        }
        for bus in 0..self.buses.len() {
            while let Some(entry) = self.buses[bus].read_entry() {
                if is_sent_frame(&entry) {
                    self.output(self.layout.bus(bus), entry.now, &BusEvent::of(&entry));
                }
            }
        }
        for line in 0..self.lines.len() {
            while let Some(entry) = self.lines[line].read() {
                if is_sent_bytes(&entry) {
                    self.output(self.layout.line(line), entry.now, &LineData::of(&entry));
                }
            }
        }
        for link in &mut self.links {
            while link.reports.pop().is_ok() {}
        }
    }

    fn output(&mut self, channel: u16, time: Instant, message: &impl Message) {
        self.body.clear();
        // A vector grows as needed, so encoding cannot fail.
        let _ = message.encode(&mut self.body);
        self.comparison.replayed(channel, time, &self.body);
    }
}

/// The difference of a bring-up that ended in the recording and not in the replay.
fn not_up(file: &CellFile, progress: Option<Poll<Result<(), servo::NotUp>>>) -> Option<Difference> {
    let replayed = match progress? {
        Poll::Ready(Ok(())) => return None,
        Poll::Ready(Err(error)) => run::why_not_up(file, error).to_string(),
        Poll::Pending => "still under way".to_owned(),
    };
    let (channel, value) = ("/servo/calls".to_owned(), "bring-up".to_owned());
    Some(Difference { channel, value, recorded: "complete".to_owned(), replayed })
}

fn is_sent_frame(entry: &TraceEntry) -> bool {
    matches!(entry.event, TraceEvent::Frame(traced) if traced.direction == Direction::Sent)
}

fn is_sent_bytes(entry: &LineEntry) -> bool {
    entry.direction == Direction::Sent && matches!(entry.event, LineEvent::Bytes { .. })
}

fn traced_port(entries: Vec<TraceEntry>) -> (Box<dyn Port>, TraceReader) {
    let (port, reader) = Tracer::new(ReplayPort::new(entries), TRACE);
    (Box::new(port), reader)
}

fn traced_line(entries: Vec<LineEntry>) -> (Box<dyn Line>, LineTraceReader) {
    let (line, reader) = LineTracer::new(ReplayLine::new(entries), TRACE);
    (Box::new(line), reader)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::content::Stored;

    #[test]
    fn a_message_of_an_undeclared_channel_is_refused() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
        let file = CellFile::read(path).unwrap();
        let layout = Layout::of(&file);
        let channels = (0..).zip(layout.channels()).map(|(id, it)| (id, (it.topic.clone(), it.message.to_owned())));
        let data = LineData { kind: "bytes".to_owned(), ..LineData::default() };
        let channel = layout.channels().len() as u16;
        let message = Stored { channel, time: Instant::ZERO, body: data.encode_to_vec(), chunk: 100 };
        let content =
            Content { channels: channels.collect(), messages: vec![message], complete: true, ..Content::default() };
        let error = Replaying::new(Path::new("it"), content, &file).err().map(|error| error.to_string());
        let said = "damaged at byte 100 (a message of an unknown channel: the channel is not declared): no cycle before \
                    can be replayed";
        assert_eq!(error.as_deref(), Some(said));
    }
}
