//! `mrroc scan`: lists the nodes of a bus.

use std::fmt;
use std::time::Duration;

use anyhow::bail;
use can::{Frame, Instant, clock};
use canopen::heartbeat::Heartbeat;
use canopen::objects::{
    DEVICE_NAME, DEVICE_TYPE, PRODUCER_HEARTBEAT, PRODUCT_CODE, REVISION, SERIAL_NUMBER, VENDOR_ID,
};
use canopen::{NodeId, Object, nmt};
use clap::Args;
use master::lss::Answer;
use master::sdo::SdoCause;
use serde::Serialize;

use super::lss::Dialogue;
use super::survey::{Questions, Survey};
use super::talk::Conversation;
use super::value::Type;
use super::{BusArgs, Channel, Drive, words};

/// Minimum time to listen for heartbeats, the only sign of a node in NMT state stopped.
const LISTEN: Duration = Duration::from_secs(1);

/// Maximum time to wait for a heartbeat that a node has announced in object 0x1017.
const LONGEST_LISTEN: Duration = Duration::from_secs(3);

/// Time that nodes without a node-ID have to answer.
const LSS_ANSWER: Duration = Duration::from_millis(100);

/// Node-ID that addresses the drive on a service port, independent of its node-ID on the bus.
const ON_THE_LINE: u8 = 0;

/// Objects that are read from a node, in this order.
const ASKED: [Object; 7] =
    [DEVICE_TYPE, VENDOR_ID, PRODUCT_CODE, REVISION, SERIAL_NUMBER, PRODUCER_HEARTBEAT, DEVICE_NAME];

/// Options of `mrroc scan`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    bus: BusArgs,
    /// Time to wait for an answer of each node, ms.
    #[arg(long, value_name = "MS", default_value_t = 200)]
    timeout: u64,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// Requests the identity of every node-ID.
pub fn scan(options: &Options) -> anyhow::Result<Scanned> {
    let mut bus = match options.bus.open_channel(Duration::from_millis(options.timeout))? {
        Channel::Bus(bus) => bus,
        Channel::Drive(mut drive) => return identify(&mut drive),
    };
    let mut scan = Scan::new(Duration::from_millis(options.timeout), clock::now());
    bus.hold(&mut scan)?;
    let mut without_id = Dialogue::anybody(LSS_ANSWER);
    bus.hold(&mut without_id)?;
    let unconfigured = without_id.result()?.contains(&Answer::Unconfigured(true));
    let nodes: Vec<_> = scan.into_nodes().collect();
    if nodes.is_empty() && !unconfigured {
        bail!("no node answers: {}", bus.silence());
    }
    let name = |node: &Node| NodeId::new(node.node).map(|id| bus.name_of(id));
    Ok(Scanned { names: nodes.iter().filter_map(name).collect(), nodes, unconfigured })
}

/// Requests the identity of the drive on a service port.
fn identify(drive: &mut Drive) -> anyhow::Result<Scanned> {
    let mut identity = Identity::default();
    while let Some(object) = identity.next() {
        let ty = (object == DEVICE_NAME).then_some(Type::String);
        let answer = drive.transfer(ON_THE_LINE, object, None, ty)?;
        identity.answer(answer.as_deref().map_err(|error| error.cause));
    }
    let Some(node) = identity.into_node(ON_THE_LINE) else {
        bail!("no drive answers: {}", drive.silence());
    };
    Ok(Scanned { nodes: vec![node], unconfigured: false, names: vec![drive.interface.to_string()] })
}

/// Result of a scan.
#[derive(Serialize)]
pub struct Scanned {
    nodes: Vec<Node>,
    /// Whether any node that supports LSS has no node-ID.
    unconfigured: bool,
    /// Names of the nodes in the text.
    #[serde(skip)]
    names: Vec<String>,
}

impl fmt::Display for Scanned {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.unconfigured {
            writeln!(f, "there are nodes without a node-ID: `mrroc lss scan` finds them")?;
        }
        let mut nodes = self.names.iter().zip(&self.nodes);
        nodes.try_for_each(|(name, node)| writeln!(f, "{name}: {node}"))
    }
}

/// Requests to every node-ID, and heartbeats received during the scan.
pub(super) struct Scan {
    survey: Survey<Identity>,
    began: Instant,
    now: Instant,
}

impl Scan {
    pub(super) fn new(timeout: Duration, now: Instant) -> Self {
        let nodes = NodeId::all().map(|node| (node, Identity::default()));
        Self { survey: Survey::new(nodes, timeout), began: now, now }
    }

    /// Nodes that answered or sent a heartbeat, in ascending order.
    pub(super) fn into_nodes(self) -> impl Iterator<Item = Node> {
        self.survey.into_answers().filter_map(|(node, identity)| identity.into_node(node.raw()))
    }
}

impl Conversation for Scan {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        // An answer to node guarding carries the state with a toggle bit.
        if let Some(heartbeat) = Heartbeat::decode(frame)
            && let Some(asked) = self.survey.nodes.get_mut(&heartbeat.node)
        {
            asked.questions.heard(heartbeat.guarded().0, now);
        }
        self.survey.handle(frame, now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.survey.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let waited_for = self.survey.nodes.values().any(|asked| asked.questions.owes_a_heartbeat());
        let listen = self.began + if waited_for { LONGEST_LISTEN } else { LISTEN };
        let listening = (self.now < listen).then_some(listen);
        // The announced heartbeat ends the wait when it arrives.
        self.survey.poll_timeout().into_iter().chain(listening).min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        self.survey.handle_timeout(now);
    }
}

/// Requests to one node-ID, and the knowledge about the node.
#[derive(Debug, Default)]
struct Identity {
    /// Number of objects of [`ASKED`] that were answered or given up.
    asked: usize,
    silent: bool,
    /// Time of the last heartbeat.
    heard: Option<Instant>,
    node: Node,
}

impl Identity {
    fn heard(&mut self, state: nmt::NmtState, now: Instant) {
        self.node.heard_every_ms = self.heard.map(|before| now.since(before).as_millis());
        self.node.state = Some(state.to_string());
        self.heard = Some(now);
    }

    fn owes_a_heartbeat(&self) -> bool {
        self.heard.is_none() && self.node.heartbeat_ms.is_some_and(|ms| ms > 0)
    }

    fn into_node(self, node: u8) -> Option<Node> {
        (self.node.answers_sdo || self.heard.is_some()).then_some(Node { node, ..self.node })
    }
}

impl Questions for Identity {
    fn next(&self) -> Option<Object> {
        ASKED.get(self.asked).copied().filter(|_| !self.silent)
    }

    fn answer(&mut self, answer: Result<&[u8], SdoCause>) {
        let object = ASKED[self.asked];
        self.asked += 1;
        if let Err(SdoCause::TimedOut { .. }) = answer {
            self.silent = true;
            return;
        }
        let node = &mut self.node;
        node.answers_sdo = true;
        let Ok(data) = answer else { return };
        let number = super::value::unsigned(data).map(|raw| raw as u32);
        match object {
            DEVICE_TYPE => {
                node.device_type = number;
                node.profile = number.map(words::device_type);
            }
            VENDOR_ID => {
                node.vendor = number;
                node.vendor_name = number.and_then(words::vendor);
            }
            PRODUCT_CODE => node.product = number,
            REVISION => node.revision = number,
            SERIAL_NUMBER => node.serial = number,
            PRODUCER_HEARTBEAT => node.heartbeat_ms = number,
            _ => node.name = Some(String::from_utf8_lossy(data).trim_end_matches('\0').to_owned()),
        }
    }
}

/// A node that was found.
#[derive(Debug, Default, Serialize, PartialEq, Eq)]
pub(super) struct Node {
    node: u8,
    /// Whether the node answered an SDO request; otherwise only its heartbeat was received.
    answers_sdo: bool,
    device_type: Option<u32>,
    profile: Option<String>,
    name: Option<String>,
    vendor: Option<u32>,
    vendor_name: Option<&'static str>,
    product: Option<u32>,
    revision: Option<u32>,
    serial: Option<u32>,
    /// NMT state according to the heartbeat.
    state: Option<String>,
    /// Value of object 0x1017, ms; 0 if the node sends no heartbeat.
    heartbeat_ms: Option<u32>,
    /// Time between the last two received heartbeats, ms.
    heard_every_ms: Option<u128>,
}

impl fmt::Display for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.answers_sdo {
            f.write_str(self.profile.as_deref().unwrap_or("no device type"))?;
        } else {
            f.write_str("is heard and answers no SDO")?;
        }
        if let Some(name) = &self.name {
            write!(f, ", {name:?}")?;
        }
        match (self.vendor_name, self.vendor) {
            (Some(name), _) => write!(f, ", {name}")?,
            (None, Some(id)) => write!(f, ", vendor {id:#010x}")?,
            (None, None) => {}
        }
        let numbers = [("product", self.product), ("revision", self.revision), ("serial number", self.serial)];
        for (what, number) in numbers {
            if let Some(number) = number {
                write!(f, ", {what} {number:#010x}")?;
            }
        }
        write!(f, ", {}", self.state.as_deref().unwrap_or("NMT state unknown"))?;
        match (self.heartbeat_ms, self.heard_every_ms) {
            (Some(0), _) => f.write_str(", sends no heartbeat"),
            (Some(ms), _) => write!(f, ", heartbeat each {ms} ms"),
            (None, Some(ms)) => write!(f, ", heard each {ms} ms"),
            (None, None) => Ok(()),
        }
    }
}
