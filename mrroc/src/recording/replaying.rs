//! A replay under way: the messages of a recording go through the drivers and the servo as they are read.
//!
//! The memory has the messages of two drains of the queues of the recorded run at most, whatever the length of the
//! recording. A drain writes the journal of the servo, then buses and lines, and then cycles of robots. Behind a drain,
//! all messages of its calls are there, except for those of the last call, which may have been under way.

use std::collections::VecDeque;
use std::path::Path;
use std::task::Poll;

use anyhow::{Context, bail};
use can::candump::Direction;
use can::{Instant, Port, ReplayFeed, ReplayPort, TraceEntry, TraceEvent, TraceReader, Tracer};
use drive::Word;
use drive::device::DeviceSamples;
use prost::Message;
use serial::{Line, LineEntry, LineEvent, LineFeed, LineTraceReader, LineTracer, ReplayLine};
use servo::{EffectorLink, JournalEvent, JournalReader, Order, Record, Servo, SpeedOverride};

use super::difference::{Comparison, Difference, Kind};
use super::entries::{Entry, entries};
use super::messages::{BusEvent, Call, LineData, RobotCycle, RobotFault, RobotOrder, Word as WordMessage};
use super::reader::{End, Reader, Stored};
use super::replay::{Place, Replay};
use super::samples::DeviceSample;
use super::sources::{Layout, words};
use crate::cell::CellFile;
use crate::{run, setup};
use can::counted_as;

/// Frames and telegrams of one cycle at a port or line, at most.
const TRACE: usize = 1 << 12;

/// Most messages without a call of the servo. The queues of a run have fewer.
const BACKLOG: usize = 300_000;

/// A call of the servo with what came before it.
struct Step {
    now: Instant,
    call: Call,
    orders: Vec<RobotOrder>,
    words: Vec<WordMessage>,
}

/// A replayed port or line: the end that adds recorded results, and the end that reads the results of the replay.
struct Traced<F, R> {
    feed: F,
    reader: R,
}

/// A replay under way.
pub(super) struct Replaying {
    servo: Servo,
    links: Vec<EffectorLink>,
    words: Vec<Word>,
    speed: SpeedOverride,
    journal: JournalReader,
    records: rtrb::Consumer<Record>,
    buses: Vec<Traced<ReplayFeed, TraceReader>>,
    lines: Vec<Traced<LineFeed, LineTraceReader>>,
    layout: Layout,
    file: CellFile,
    /// The samples of the devices of other crates.
    samples: Vec<DeviceSamples>,
    /// Calls that were not replayed yet.
    steps: VecDeque<Step>,
    /// Whether the last message was not of the journal, so that a message of the journal begins the next drain.
    is_drained: bool,
    comparison: Comparison,
    /// Result of the last poll of the bring-up.
    up: Option<Poll<Result<(), servo::NotUp>>>,
    /// The last replayed call.
    place: Option<Place>,
    /// The replay ended before the recording.
    is_over: bool,
    body: Vec<u8>,
    result: Replay,
}

impl Replaying {
    /// A replay of the recording `path`, whose channels were read, through the drivers of the cell `file`.
    pub(super) fn new(path: &Path, reader: &Reader, file: &CellFile) -> anyhow::Result<Self> {
        let layout = Layout::of(file);
        let topics = layout.channels().iter().map(|channel| channel.topic.as_str());
        if !topics.eq(reader.channels().values().map(|(topic, _)| topic.as_str())) {
            if let Some(missing) = reader.missing() {
                bail!("{missing}: the channels before are not those of the cell, and no cycle can be replayed");
            }
            bail!("the cell has other robots, axes, buses or lines than the recording");
        }
        let cell = &file.cell;
        let mut comparison = Comparison::new();
        let mut add = |channel: u16, kind| {
            comparison.add_channel(channel, kind, &layout.channels()[usize::from(channel)].topic);
        };
        add(layout.faults(), Kind::Fault);
        (0..cell.robot.len()).for_each(|robot| add(layout.robot(robot), Kind::Robot));
        (0..cell.bus.len()).for_each(|bus| add(layout.bus(bus), Kind::Bus));
        (0..layout.lines()).for_each(|line| add(layout.line(line), Kind::Line));
        (0..cell.device.len()).for_each(|device| add(layout.device(device), Kind::Device));

        let text = |key: &str| reader.facts().texts.get(key).cloned().unwrap_or_default();
        let result = Replay {
            file: path.to_owned(),
            recorded_by: text("version"),
            cell: cell.name.clone(),
            bench: text("bench"),
            cycles: 0,
            end_s: 0.0,
            equal: 0,
            cut: None,
            damaged: None,
            last_cycle: None,
            differs_in: None,
            differences: Vec::new(),
        };
        let (ports, buses) = (0..cell.bus.len()).map(|_| traced_port()).unzip();
        let mut traced = (0..layout.lines()).map(|_| traced_line());
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
            samples: std::mem::take(&mut devices.samples),
            layout,
            file: file.clone(),
            steps: VecDeque::new(),
            is_drained: false,
            comparison,
            up: None,
            place: None,
            is_over: false,
            body: Vec::new(),
            result,
        })
    }

    /// Replays the messages `first` and all later ones of `reader`.
    pub(super) fn go(mut self, mut reader: Reader, first: Option<Vec<Stored>>) -> anyhow::Result<Replay> {
        let mut chunk = first;
        while let Some(messages) = chunk {
            match entries(&self.layout, reader.channels(), messages) {
                Ok(entries) => {
                    for (message, entry) in entries {
                        self.take(message, entry)?;
                    }
                }
                Err(damage) => reader.damage_at(damage.byte, damage.what),
            }
            if !self.is_over && self.backlog() > BACKLOG {
                self.leave_backlog()?;
            }
            if self.is_over {
                break;
            }
            chunk = reader.chunk()?;
        }
        if !self.is_over {
            self.end(reader.end())?;
        }
        if let (None, true, Some(missing)) = (&self.place, self.comparison.found.is_empty(), reader.missing()) {
            bail!("{missing}: no cycle before can be replayed");
        }
        let place = self.place.unwrap_or(Place { cycle: None, time_s: 0.0 });
        self.result.cut = reader.cut().map(str::to_owned);
        self.result.damaged = reader.damage().cloned();
        (self.result.equal, self.result.end_s) = (self.comparison.equal, place.time_s);
        self.result.last_cycle = place.cycle;
        self.result.differences = self.comparison.found;
        self.result.differs_in = (!self.result.differences.is_empty()).then_some(place);
        Ok(self.result)
    }

    /// Takes the next message, and replays the calls of a drain that ends before the message.
    fn take(&mut self, message: Stored, entry: Entry) -> anyhow::Result<()> {
        let is_of_journal = self.layout.is_of_journal(message.channel);
        if is_of_journal && self.is_drained {
            self.play(1)?;
        }
        self.is_drained = !is_of_journal;
        match entry {
            Entry::Call(call) => {
                self.steps.push_back(Step { now: message.time, call, orders: Vec::new(), words: Vec::new() });
            }
            Entry::Order(order) => self.latest().context("an order precedes the first call")?.orders.push(order),
            Entry::Word(word) => self.latest().context("a word precedes the first call")?.words.push(word),
            Entry::Lost(lost) => {
                let entries = counted_as(lost.entries, "entry", "entries");
                bail!("{entries} of the recording found no room, so it cannot be replayed")
            }
            Entry::Line(line, entry) => {
                self.lines[line].feed.push(entry);
                if is_sent_bytes(&entry) {
                    self.comparison.expect(message);
                }
            }
            Entry::Bus(bus, entry) => {
                self.buses[bus].feed.push(entry);
                if is_sent_frame(&entry) {
                    self.comparison.expect(message);
                }
            }
            Entry::Other => self.comparison.expect(message),
        }
        Ok(())
    }

    /// The last call, to which orders and words belong.
    fn latest(&mut self) -> Option<&mut Step> {
        self.steps.back_mut()
    }

    /// Replays the calls, except for the last `kept` calls.
    fn play(&mut self, kept: usize) -> anyhow::Result<()> {
        while self.steps.len() > kept && !self.is_over {
            let Some(step) = self.steps.pop_front() else { break };
            self.step(&step)?;
        }
        Ok(())
    }

    /// Replays what is left behind the last message.
    fn end(&mut self, end: End) -> anyhow::Result<()> {
        match end {
            // The last drain may be incomplete.
            End::Broken => Ok(()),
            End::UnderWay => {
                self.play(1)?;
                if let Some(last) = self.steps.front().map(|step| step.now).filter(|_| !self.is_over) {
                    self.comparison.missing_before(last);
                }
                Ok(())
            }
            End::Whole => {
                self.play(0)?;
                if !self.is_over {
                    self.comparison.missing_to_the_end();
                }
                Ok(())
            }
        }
    }

    /// Number of messages that wait for a call of the servo.
    fn backlog(&self) -> usize {
        let buses = self.buses.iter().map(|bus| bus.feed.unread()).sum::<usize>();
        let lines = self.lines.iter().map(|line| line.feed.unread()).sum::<usize>();
        buses + lines + self.comparison.pending() + self.steps.len()
    }

    /// Ends the replay of a recording without calls of the servo for its outputs.
    fn leave_backlog(&mut self) -> anyhow::Result<()> {
        self.is_over = true;
        self.comparison.missing_to_the_end();
        if self.comparison.found.is_empty() {
            bail!("more than {BACKLOG} messages have no call of the servo, so the recording cannot be replayed");
        }
        Ok(())
    }

    /// Replays a call, unless the replay ends before the call.
    fn step(&mut self, step: &Step) -> anyhow::Result<()> {
        self.comparison.missing_before(step.now);
        // A cycle with a difference is completed, so that its frames are compared too.
        if !self.comparison.found.is_empty() && step.call.kind != "sent" {
            self.is_over = true;
            return Ok(());
        }
        let place = self.place.get_or_insert(Place { cycle: None, time_s: 0.0 });
        place.time_s = step.now.since(Instant::ZERO).as_secs_f64();
        if step.call.kind == "cycle" {
            place.cycle = Some(step.call.cycle);
            if let Some(problem) = not_up(&self.file, self.up.take()) {
                self.comparison.found.push(problem);
                self.is_over = true;
                return Ok(());
            }
        }
        let progress = self.call(step)?;
        if step.call.kind == "bring_up" {
            self.up = Some(progress);
        }
        self.compare();
        Ok(())
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
            while let Some(entry) = self.buses[bus].reader.read_entry() {
                if is_sent_frame(&entry) {
                    self.output(self.layout.bus(bus), entry.now, &BusEvent::of(&entry));
                }
            }
        }
        for line in 0..self.lines.len() {
            while let Some(entry) = self.lines[line].reader.read() {
                if is_sent_bytes(&entry) {
                    self.output(self.layout.line(line), entry.now, &LineData::of(&entry));
                }
            }
        }
        for device in 0..self.samples.len() {
            while let Some((at, sample)) = self.samples[device].take() {
                let message = DeviceSample::of(sample.as_ref(), self.layout.devices()[device]);
                self.output(self.layout.device(device), at, &message);
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

fn traced_port() -> (Box<dyn Port>, Traced<ReplayFeed, TraceReader>) {
    let (port, feed) = ReplayPort::fed();
    let (port, reader) = Tracer::new(port, TRACE);
    (Box::new(port), Traced { feed, reader })
}

fn traced_line() -> (Box<dyn Line>, Traced<LineFeed, LineTraceReader>) {
    let (line, feed) = ReplayLine::fed();
    let (line, reader) = LineTracer::new(line, TRACE);
    (Box::new(line), Traced { feed, reader })
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn a_message_of_an_undeclared_channel_is_refused() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
        let file = CellFile::read(path).unwrap();
        let layout = Layout::of(&file);
        let mut reader = Reader::new(Box::new(Cursor::new(mcap::MAGIC))).unwrap();
        reader.declare((0..).zip(layout.channels()).map(|(id, it)| (id, (it.topic.clone(), it.message.to_owned()))));
        let data = LineData { kind: "bytes".to_owned(), ..LineData::default() };
        let channel = layout.channels().len() as u16;
        let message = Stored { channel, time: Instant::ZERO, body: data.encode_to_vec(), chunk: 100 };
        let replaying = Replaying::new(Path::new("it"), &reader, &file).unwrap();
        let error = replaying.go(reader, Some(vec![message])).err().map(|error| error.to_string());
        let said = "damaged at byte 100 (a message of an unknown channel: the channel is not declared): no cycle \
                    before can be replayed";
        assert_eq!(error.as_deref(), Some(said));
    }
}
