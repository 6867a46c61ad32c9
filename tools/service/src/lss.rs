//! `mrroc lss`: assigns node-IDs to nodes that have none, and reads the identities of nodes.

use std::collections::VecDeque;
use std::fmt;
use std::process::ExitCode;
use std::time::Duration;

use can::{Frame, Instant, Port as _};
use canopen::NodeId;
use canopen::heartbeat::Heartbeat;
use canopen::lss::{Identity, Mode, Part, Request, Response};
use canopen::nmt::NmtState;
use clap::{Args, Subcommand};
use master::lss::{Answer, LssError, Master, Service};
use serde::Serialize;

use super::talk::Conversation;
use super::{BusArgs, node_id, say, value, words};
use mrroc::bench::interfaces::Interface;
use mrroc::streams;

/// Time that a slave has to store its configuration.
const STORING: Duration = Duration::from_secs(2);

/// Time that a node has to boot with its new node-ID.
const BOOTING: Duration = Duration::from_secs(2);

/// Switches all slaves to waiting mode. The command has no answer, and the time limits its sending.
const TO_WAITING: (Service, Duration) = (Service::SwitchGlobal(Mode::Waiting), Duration::from_millis(200));

/// Time after the last request of a scan during which a late answer is noticed.
const LATE: Duration = Duration::from_millis(500);

/// Maximum number of nodes on a bus.
const MOST_FOUND: usize = 127;

/// Actions of `mrroc lss`.
#[derive(Subcommand)]
pub enum Action {
    /// Find every node without a node-ID, by fastscan.
    Scan {
        /// The bus.
        #[command(flatten)]
        bus: BusArgs,
        /// Time to wait for an answer to each of the 134 requests per node, ms. The value must exceed the answer time
        /// of the slowest node plus the latency of the interface. An answer within 0.5 s after the scan causes a
        /// warning and exit status 1. A node that keeps answering after it was found, such as a CANopenNode slave,
        /// doubles the number of requests. [default: 20, or 50 on slcan]
        #[arg(long, value_name = "MS")]
        timeout: Option<u64>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Read the identity and the node-ID of a node.
    Inquire {
        /// The node.
        #[command(flatten)]
        slave: Slave,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Assign a node-ID to a node. A node without a node-ID boots with the new one. Any other node uses the new node-ID
    /// after its next reset of communication.
    SetNodeId {
        /// The node.
        #[command(flatten)]
        slave: Slave,
        /// The node-ID, or `none` to remove the node-ID.
        #[arg(value_parser = new_node_id)]
        node: NewNodeId,
        /// Have the node store the node-ID in non-volatile memory.
        #[arg(long)]
        store: bool,
    },
    /// Have a node store its node-ID and bit rate in non-volatile memory.
    Store {
        /// The node.
        #[command(flatten)]
        slave: Slave,
    },
}

/// Selection of a node.
#[derive(Args)]
pub struct Slave {
    #[command(flatten)]
    bus: BusArgs,
    /// Identity of the node, object 0x1018, as `mrroc lss scan` prints it.
    #[arg(long, value_name = "VENDOR:PRODUCT:REVISION:SERIAL", value_parser = identity, required_unless_present = "alone")]
    identity: Option<Identity>,
    /// The node is the only one on the bus. Every node on the bus obeys the command.
    #[arg(long, conflicts_with = "identity")]
    alone: bool,
    /// Time to wait for an answer, ms.
    #[arg(long, value_name = "MS", default_value_t = 200)]
    timeout: u64,
}

/// A node-ID, or none. Own type, because clap takes an `Option` for an optional argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NewNodeId(Option<NodeId>);

fn new_node_id(text: &str) -> Result<NewNodeId, String> {
    let node = (text != "none").then(|| node_id(text)).transpose()?;
    Ok(NewNodeId(node))
}

fn identity(text: &str) -> Result<Identity, String> {
    let number = |text| value::number(text).and_then(|number| u32::try_from(number).ok());
    let numbers: Option<Vec<u32>> = text.split(':').map(number).collect();
    match numbers.as_deref() {
        Some(&[vendor, product, revision, serial]) => Ok(Identity { vendor, product, revision, serial }),
        _ => Err("an identity is four numbers, such as 0xfb:0x61500000:0x1700000:0x12345678".into()),
    }
}

/// Runs the action.
pub fn lss(action: &Action) -> anyhow::Result<ExitCode> {
    match action {
        Action::Scan { bus, timeout, json } => scan(bus, timeout.map(Duration::from_millis), *json),
        Action::Inquire { slave, json } => inquire(slave, *json),
        Action::SetNodeId { slave, node, store } => set_node_id(slave, node.0, *store),
        Action::Store { slave } => {
            slave.ask(&[(Service::Store, STORING)], None)?;
            say("stored")?;
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// A node that was found, and its node-ID if it was asked for.
#[derive(Serialize)]
struct Found {
    identity: String,
    vendor: u32,
    vendor_name: Option<&'static str>,
    product: u32,
    revision: u32,
    serial: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    node: Option<u8>,
}

impl Found {
    fn of(identity: &Identity, node: Option<NodeId>) -> Self {
        Self {
            identity: Part::ALL.map(|part| format!("{:#010x}", identity.get(part))).join(":"),
            vendor: identity.vendor,
            vendor_name: words::vendor(identity.vendor),
            product: identity.product,
            revision: identity.revision,
            serial: identity.serial,
            node: node.map(NodeId::raw),
        }
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.node {
            Some(node) => write!(f, "node {node}: {}", self.identity),
            None => write!(f, "no node-ID: {}", self.identity),
        }
    }
}

/// Default time to wait for an answer to an LSS request. A serial adapter may hold an answer back for 16 ms, the
/// default of FTDI chips.
fn question(interface: &Interface) -> Duration {
    match interface {
        Interface::SocketCan(_) | Interface::Epos { .. } => Duration::from_millis(20),
        Interface::Slcan { .. } => Duration::from_millis(50),
    }
}

fn scan(bus: &BusArgs, timeout: Option<Duration>, json: bool) -> anyhow::Result<ExitCode> {
    #[derive(Serialize)]
    struct Unconfigured<'a> {
        unconfigured: &'a [Found],
    }
    let mut bus = bus.open()?;
    let timeout = timeout.unwrap_or_else(|| question(&bus.interface));
    let mut dialogue = Dialogue::scan(timeout);
    bus.hold(&mut dialogue)?;
    let late = dialogue.late();
    let (found, failed) = dialogue.found();
    let unconfigured: Vec<_> = found.iter().map(|found| Found::of(found, None)).collect();
    match (json, failed) {
        // The JSON object has no form for an incomplete list.
        (true, Some(error)) => return Err(error.into()),
        (true, None) => {
            say(serde_json::to_string(&Unconfigured { unconfigured: &unconfigured })?)?;
        }
        (false, None) if found.is_empty() && late.is_none() => {
            say(format_args!(
                "no node without a node-ID answered within {} ms: the nodes have node-IDs, do not know LSS, or answer \
                 later (--timeout)",
                timeout.as_millis()
            ))?;
        }
        (false, _) => {}
    }
    if failed.is_none() && found.is_empty() && bus.port.counters().received == 0 {
        streams::warn(format_args!("mrroc: {}", bus.silence()));
        return Ok(ExitCode::from(1));
    }
    if let Some(late) = late {
        streams::warn(format_args!("mrroc: {}", lateness(late, timeout)));
    }
    let complete = if late.is_none() { ExitCode::SUCCESS } else { ExitCode::from(1) };
    if json {
        return Ok(complete);
    }
    for found in unconfigured {
        let vendor = found.vendor_name.map(|name| format!(" ({name})"));
        say(format_args!("{found}{}", vendor.unwrap_or_default()))?;
    }
    failed.map_or(Ok(complete), |error| Err(error.into()))
}

/// Warning of an answer `late` after its request to a scan that waits for `timeout`.
fn lateness(late: Duration, timeout: Duration) -> String {
    // One and a half times the delay, rounded up to a multiple of 10 ms.
    let longer = (late.as_millis() * 3 / 2).div_ceil(10) * 10;
    format!(
        "a node without a node-ID answered {} ms after a request, and the scan waits {} ms: the list is incomplete, scan again \
         with --timeout {longer}",
        late.as_millis(),
        timeout.as_millis()
    )
}

fn inquire(slave: &Slave, json: bool) -> anyhow::Result<ExitCode> {
    let timeout = Duration::from_millis(slave.timeout);
    let services = [(Service::InquireIdentity, timeout), (Service::InquireNodeId, timeout)];
    let (answers, _) = slave.ask(&services, None)?;
    let found = answers.windows(2).find_map(|pair| match pair {
        [Answer::Identity(identity), Answer::NodeId(node)] => Some(Found::of(identity, *node)),
        _ => None,
    });
    found.map_or(Ok(ExitCode::SUCCESS), |found| streams::answer(&found, json))
}

fn set_node_id(slave: &Slave, node: Option<NodeId>, store: bool) -> anyhow::Result<ExitCode> {
    let mut services = vec![(Service::ConfigureNodeId(node), Duration::from_millis(slave.timeout))];
    if store {
        services.push((Service::Store, STORING));
    }
    let (_, booted) = slave.ask(&services, node)?;
    let stored = if store { " and stored" } else { "" };
    say(match (node, booted) {
        (None, _) => format!("node-ID taken away{stored}, from the next reset of communication on"),
        (Some(node), true) => format!("node {node}: configured{stored}, and booted"),
        (Some(node), false) => format!(
            "node {node}: configured{stored}; a node that had another node-ID takes it at its next reset of communication \
             (`mrroc nmt reset-communication`), and boots as node {node}"
        ),
    })?;
    Ok(ExitCode::SUCCESS)
}

impl Slave {
    /// Answers of the slave, and whether node `expected` boots afterwards.
    fn ask(&self, services: &[(Service, Duration)], expected: Option<NodeId>) -> anyhow::Result<(Vec<Answer>, bool)> {
        let mut bus = self.bus.open()?;
        let mut dialogue = Dialogue::with(self.identity, services, expected, Duration::from_millis(self.timeout));
        bus.hold(&mut dialogue)?;
        let booted = dialogue.booted;
        Ok((dialogue.result()?, booted))
    }
}

/// A sequence of LSS services. All slaves are back in waiting mode at its end, also after an error.
#[derive(Default)]
pub(super) struct Dialogue {
    master: Master,
    services: VecDeque<(Service, Duration)>,
    answers: Vec<Answer>,
    /// Nodes that a scan found, in ascending order of their identities.
    found: Vec<Identity>,
    failed: Option<LssError>,
    scanning: Option<Scanning>,
    /// Node whose boot-up message ends the dialogue.
    expected: Option<NodeId>,
    pub(super) booted: bool,
    /// Time at which the last request of a scan was sent.
    asked: Instant,
    /// Delay of an answer after the end of a scan.
    late: Option<Duration>,
    /// Whether a service is under way.
    busy: bool,
    ending: Ending,
}

/// State of a scan between two nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Scanning {
    /// Time to wait for an answer to each request.
    timeout: Duration,
    /// Whether all nodes stay in waiting mode during the scan, which then skips the identities already found.
    above: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Ending {
    /// Services are still to be performed.
    #[default]
    NotYet,
    /// All slaves are being switched to waiting mode.
    Waiting,
    /// A scan is over, and an answer may still come.
    Listening {
        until: Instant,
    },
    /// The expected node boots.
    Booting {
        until: Instant,
    },
    Over,
}

impl Dialogue {
    /// Services with the slave of `identity`, or with the only slave on the bus.
    pub(super) fn with(
        identity: Option<Identity>,
        services: &[(Service, Duration)],
        expected: Option<NodeId>,
        timeout: Duration,
    ) -> Self {
        let select = match identity {
            Some(identity) => Service::SwitchSelective(identity),
            None => Service::SwitchGlobal(Mode::Configuration),
        };
        let services = [TO_WAITING, (select, timeout)].into_iter().chain(services.iter().copied()).collect();
        Self { services, expected, ..Self::default() }
    }

    /// Scan for every slave without a node-ID. A slave that was found is in configuration mode and should be silent
    /// from then on. If such a slave is not silent, the scan continues with all slaves in waiting mode. Each pass then
    /// begins above the identity found last.
    pub(super) fn scan(timeout: Duration) -> Self {
        let services = [TO_WAITING, (Service::Fastscan, timeout)].into();
        Self { services, scanning: Some(Scanning { timeout, above: false }), ..Self::default() }
    }

    /// Query whether any slave has no node-ID.
    pub(super) fn anybody(timeout: Duration) -> Self {
        Self { services: [(Service::IdentifyUnconfigured, timeout)].into(), ..Self::default() }
    }

    /// Answers in the order of the services.
    pub(super) fn result(self) -> Result<Vec<Answer>, LssError> {
        self.failed.map_or(Ok(self.answers), Err)
    }

    /// Nodes that a scan found, in ascending order of their identities, and the error that ended the scan early, if
    /// any.
    pub(super) fn found(self) -> (Vec<Identity>, Option<LssError>) {
        (self.found, self.failed)
    }

    /// Delay of an answer that came after the end of a scan, which did not find its node.
    pub(super) fn late(&self) -> Option<Duration> {
        self.late
    }

    /// Processes the result of the present service and starts the next.
    fn go_on(&mut self, now: Instant) {
        if self.busy {
            let Some(result) = self.master.poll() else {
                return;
            };
            self.busy = false;
            self.take(result);
        }
        match self.ending {
            Ending::NotYet => {
                let next = self.services.pop_front();
                if next.is_none() {
                    self.ending = Ending::Waiting;
                }
                let (service, timeout) = next.unwrap_or(TO_WAITING);
                self.master.start(service, timeout, now).expect("the result of the service before was taken");
                self.busy = true;
            }
            Ending::Waiting if self.expected.is_some() && self.failed.is_none() && !self.booted => {
                self.ending = Ending::Booting { until: now + BOOTING };
            }
            Ending::Waiting if self.scanning.is_some() && self.failed.is_none() && self.late.is_none() => {
                self.ending = Ending::Listening { until: self.asked + LATE };
            }
            Ending::Waiting => self.ending = Ending::Over,
            Ending::Listening { .. } | Ending::Booting { .. } | Ending::Over => {}
        }
    }

    fn take(&mut self, result: Result<Answer, LssError>) {
        let last = self.found.last().copied();
        let Some(scanning) = &mut self.scanning else {
            return self.keep(result);
        };
        match result {
            // A slave in configuration mode keeps answering, or a slave that was found stayed in waiting mode.
            Err(LssError::Untrue) if last.is_some() && !scanning.above => scanning.above = true,
            Ok(Answer::Found(Some(found))) if last == Some(found) => scanning.above = true,
            Ok(Answer::Found(Some(found))) => self.found.push(found),
            other => return self.keep(other),
        }
        // The scan for the next slave.
        match self.found.last().filter(|_| scanning.above) {
            _ if self.found.len() >= MOST_FOUND => {}
            Some(last) => self.services.extend([TO_WAITING, (Service::FastscanAbove(*last), scanning.timeout)]),
            None => self.services.push_back((Service::Fastscan, scanning.timeout)),
        }
    }

    fn keep(&mut self, result: Result<Answer, LssError>) {
        match result {
            Ok(answer) => self.answers.push(answer),
            Err(error) => {
                self.failed.get_or_insert(error);
                self.services.clear();
            }
        }
    }
}

impl Conversation for Dialogue {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.master.handle(frame, now);
        let ended = matches!(self.ending, Ending::Waiting | Ending::Listening { .. });
        if ended && self.scanning.is_some() && Response::decode(frame) == Some(Response::Identified) {
            self.late.get_or_insert(now.since(self.asked));
            if let Ending::Listening { .. } = self.ending {
                self.ending = Ending::Over;
            }
        }
        let boot = Heartbeat::decode(frame).filter(|said| said.state == NmtState::Initialising);
        if boot.is_some_and(|said| Some(said.node) == self.expected) {
            self.booted = true;
            if let Ending::Booting { .. } = self.ending {
                self.ending = Ending::Over;
            }
        }
        self.go_on(now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.master.poll_transmit(now);
        if frame.as_ref().and_then(Request::decode).is_some_and(|request| matches!(request, Request::Fastscan(_))) {
            self.asked = now;
        }
        // Some services have no answer and are complete once sent.
        self.go_on(now);
        frame
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.ending {
            // A dialogue that has not started is due at once.
            Ending::NotYet | Ending::Waiting => Some(self.master.poll_timeout().unwrap_or(Instant::ZERO)),
            Ending::Listening { until } | Ending::Booting { until } => Some(until),
            Ending::Over => None,
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.master.handle_timeout(now);
        if let Ending::Listening { until } | Ending::Booting { until } = self.ending
            && now >= until
        {
            self.ending = Ending::Over;
        }
        self.go_on(now);
    }

    /// Slaves in configuration mode would answer the next master as if that master had selected them.
    fn break_off(&self) -> Option<Frame> {
        Some(Request::SwitchGlobal(Mode::Waiting).encode())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_answer_is_told_with_a_wait_that_is_long_enough() {
        let [late, timeout] = [Duration::from_micros(52_300), Duration::from_millis(20)];
        let text = lateness(late, timeout);
        assert!(text.contains("answered 52 ms after a request, and the scan waits 20 ms"), "{text}");
        assert!(text.ends_with("with --timeout 80"), "{text}");
    }

    #[test]
    fn a_question_outlasts_the_latency_of_its_interface() {
        for (interface, ms) in [("can0", 20), ("slcan:/dev/ttyUSB0", 50)] {
            let waits = question(&Interface::parse(interface));
            assert_eq!(waits, Duration::from_millis(ms), "{interface}");
        }
    }
}
