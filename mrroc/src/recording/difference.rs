//! Comparison of a replay with its recording, message by message.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::{self, Display, Formatter};

use can::Instant;
use prost::Message;
use serde::Serialize;

use super::messages::{BusEvent, LineData, RobotCycle, RobotFault};
use super::reader::Stored;
use super::samples::DeviceSample;

/// Most differences of the first differing cycle that are listed.
const MOST: usize = 200;

/// A value that differs between a recording and its replay.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// Channel of the recording, for example `/robot/irb6/cycle`.
    pub channel: String,
    /// The value, for example `axis 2 commanded`.
    pub value: String,
    /// The value in the recording.
    pub recorded: String,
    /// The value in the replay.
    pub replayed: String,
}

impl Display for Difference {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { channel, value, recorded, replayed } = self;
        write!(f, "{channel} {value}: recorded {recorded}, replayed {replayed}")
    }
}

/// Kind of an output channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Robot,
    Bus,
    Line,
    Fault,
    Device,
}

/// The recorded outputs that were not replayed yet.
pub(super) struct Comparison {
    expected: BTreeMap<u16, (Kind, String, VecDeque<Stored>)>,
    /// The differences of the first cycle that has some.
    pub(super) found: Vec<Difference>,
    /// Equal messages.
    pub(super) equal: u64,
}

impl Comparison {
    pub(super) fn new() -> Self {
        Self { expected: BTreeMap::new(), found: Vec::new(), equal: 0 }
    }

    /// Adds a channel without messages.
    pub(super) fn add_channel(&mut self, channel: u16, kind: Kind, topic: &str) {
        self.expected.insert(channel, (kind, topic.to_owned(), VecDeque::new()));
    }

    /// Adds a recorded output.
    pub(super) fn expect(&mut self, message: Stored) {
        if let Some((_, _, messages)) = self.expected.get_mut(&message.channel) {
            messages.push_back(message);
        }
    }

    /// Compares an output of the replay with the next one of the recording.
    pub(super) fn replayed(&mut self, channel: u16, time: Instant, body: &[u8]) {
        let Some((kind, topic, messages)) = self.expected.get_mut(&channel) else { return };
        match messages.pop_front() {
            Some(message) if message.time == time && message.body == body => self.equal += 1,
            Some(message) => {
                let mut differences = Vec::new();
                if message.time != time {
                    differences.push(of(topic, "time", message.time, time));
                }
                differences.extend(fields(*kind, topic, &message.body, body));
                if differences.is_empty() {
                    differences.push(of(topic, "encoding", format!("{:?}", message.body), format!("{body:?}")));
                }
                self.note(differences);
            }
            None => {
                let difference = of(topic, "output", "nothing", shown(*kind, body));
                self.note([difference]);
            }
        }
    }

    /// Number of the recorded outputs that were not compared yet.
    pub(super) fn pending(&self) -> usize {
        self.expected.values().map(|(_, _, messages)| messages.len()).sum()
    }

    /// Finds the recorded outputs before `now` that the replay does not have.
    pub(super) fn missing_before(&mut self, now: Instant) {
        self.missing(|message| message.time < now);
    }

    /// Finds all recorded outputs that the replay does not have.
    pub(super) fn missing_to_the_end(&mut self) {
        self.missing(|_| true);
    }

    fn missing(&mut self, is_due: impl Fn(&Stored) -> bool) {
        let mut found = Vec::new();
        for (kind, topic, messages) in self.expected.values_mut() {
            while let Some(message) = messages.front().filter(|message| is_due(message)) {
                if found.len() < MOST {
                    found.push(of(topic, "output", shown(*kind, &message.body), "nothing"));
                }
                messages.pop_front();
            }
        }
        self.note(found);
    }

    fn note(&mut self, differences: impl IntoIterator<Item = Difference>) {
        let room = MOST.saturating_sub(self.found.len());
        self.found.extend(differences.into_iter().take(room));
    }
}

fn of(topic: &str, value: &str, recorded: impl Display, replayed: impl Display) -> Difference {
    Difference {
        channel: topic.to_owned(),
        value: value.to_owned(),
        recorded: recorded.to_string(),
        replayed: replayed.to_string(),
    }
}

/// The fields that differ.
fn fields(kind: Kind, topic: &str, recorded: &[u8], replayed: &[u8]) -> Vec<Difference> {
    if kind != Kind::Robot {
        return vec![of(topic, "output", shown(kind, recorded), shown(kind, replayed))];
    }
    let [recorded, replayed] = [recorded, replayed].map(|body| values(&RobotCycle::decode(body).unwrap_or_default()));
    let pairs = recorded.iter().zip(&replayed).filter(|(recorded, replayed)| recorded != replayed);
    pairs.map(|((value, recorded), (_, replayed))| of(topic, value, recorded, replayed)).collect()
}

/// The values of a cycle by name. Numbers are shown with all digits.
fn values(cycle: &RobotCycle) -> Vec<(String, String)> {
    let mut values = vec![
        ("cycle".to_owned(), cycle.cycle.to_string()),
        ("dt_ns".to_owned(), cycle.dt_ns.to_string()),
        ("phase".to_owned(), cycle.phase.clone()),
        ("faulted".to_owned(), cycle.faulted.to_string()),
    ];
    for (number, axis) in cycle.axis.iter().enumerate() {
        let mut value = |name: &str, value: String| values.push((format!("axis {} {name}", number + 1), value));
        value("commanded", axis.commanded.to_string());
        value("displacement", axis.displacement.to_string());
        value("command", axis.command.clone());
        value("set_point", axis.set_point.to_string());
        value("set_point_torque", axis.set_point_torque.to_string());
        value("excitation", axis.excitation.to_string());
        value("measured", axis.measured.to_string());
        value("expected", format!("{:?}", axis.expected));
        value("increments", axis.increments.to_string());
        value("velocity", axis.velocity.to_string());
        value("torque", axis.torque.to_string());
        value("homing", axis.homing.clone());
    }
    values
}

/// An output in words.
fn shown(kind: Kind, body: &[u8]) -> String {
    match kind {
        Kind::Robot => RobotCycle::decode(body).map_or_else(|_| "?".into(), |it| format!("cycle {}", it.cycle)),
        Kind::Bus => {
            let entry = BusEvent::decode(body).ok().and_then(|event| event.entry(Instant::ZERO));
            match entry.map(|entry| entry.event) {
                Some(can::TraceEvent::Frame(traced)) => traced.frame.to_string(),
                other => format!("{other:?}"),
            }
        }
        Kind::Line => {
            let data = LineData::decode(body).unwrap_or_default().data;
            data.iter().map(|byte| format!("{byte:02x}")).collect()
        }
        Kind::Device => match DeviceSample::decode(body) {
            Ok(sample) if sample.values.is_empty() => "no valid sample".to_owned(),
            Ok(sample) => format!("sample {}: {:?}", sample.number, sample.values),
            Err(_) => "?".to_owned(),
        },
        Kind::Fault => {
            let fault = RobotFault::decode(body).unwrap_or_default();
            match (fault.axis.as_str(), fault.cause.as_str()) {
                (_, "") => "no fault".to_owned(),
                ("", cause) => cause.to_owned(),
                (axis, cause) => format!("axis {axis}: {cause}"),
            }
        }
    }
}
