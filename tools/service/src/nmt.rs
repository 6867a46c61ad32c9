//! `mrroc nmt`: sends NMT commands to nodes, and verifies that the nodes obey.

use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use can::{Frame, Instant, clock};
use canopen::NodeId;
use canopen::heartbeat::Heartbeat;
use canopen::nmt::{Command, NmtState, Request, Target};
use canopen::objects::PRODUCER_HEARTBEAT;
use clap::{Args, ValueEnum};
use master::sdo::{self, SdoCause, SdoError};

use super::talk::Conversation;
use super::{Bus, BusArgs, Channel, Drive, node_id, say};

/// Time limit for the answer to an SDO request.
const ANSWER: Duration = Duration::from_millis(300);

/// NMT commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CommandName {
    /// Enter operational: PDOs are exchanged.
    Start,
    /// Enter stopped.
    Stop,
    /// Enter pre-operational.
    PreOperational,
    /// Reset the device. The drive loses its power and all parameters that were not stored.
    ResetNode,
    /// Reset the communication parameters to their stored values.
    ResetCommunication,
}

/// Options of `mrroc nmt`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    bus: BusArgs,
    /// The command.
    #[arg(value_enum)]
    order: CommandName,
    /// The node-ID, or `all`.
    #[arg(value_name = "NODE", value_parser = target)]
    target: Target,
    /// Time to wait for heartbeats and boot-up messages, ms.
    #[arg(long, value_name = "MS", default_value_t = 2000)]
    timeout: u64,
}

fn target(text: &str) -> Result<Target, String> {
    match text {
        "all" => Ok(Target::All),
        _ => node_id(text).map(Target::Node),
    }
}

impl CommandName {
    fn command(self) -> Command {
        match self {
            Self::Start => Command::Start,
            Self::Stop => Command::Stop,
            Self::PreOperational => Command::EnterPreOperational,
            Self::ResetNode => Command::ResetNode,
            Self::ResetCommunication => Command::ResetCommunication,
        }
    }
}

/// Sends an NMT command and reports the states of the nodes after it.
pub fn nmt(options: &Options) -> anyhow::Result<ExitCode> {
    let request = Request { command: options.order.command(), target: options.target };
    let timeout = Duration::from_millis(options.timeout);
    let mut bus = match options.bus.open_channel(timeout)? {
        Channel::Bus(bus) => bus,
        Channel::Drive(mut drive) => return tell(&mut drive, request),
    };
    let mut told = Told::new(request, timeout, clock::now());
    bus.hold(&mut told)?;
    let report = told.report();
    for line in report.lines(&bus) {
        say(line)?;
    }
    Ok(ExitCode::from(u8::from(!report.confirmed())))
}

/// Sends an NMT command over a service port, which carries neither heartbeats nor boot-up messages.
fn tell(drive: &mut Drive, request: Request) -> anyhow::Result<ExitCode> {
    let whom = match request.target {
        Target::All => "all nodes".to_owned(),
        Target::Node(node) => drive.name_of(node),
    };
    let told = drive.port.nmt(request, &drive.interrupted);
    match told.with_context(|| drive.interface.to_string())? {
        Ok(()) => {}
        Err(error) => match error.cause {
            SdoCause::Aborted { code } => bail!("{whom}: refused: {code}"),
            SdoCause::TimedOut { waited } => bail!("{whom}: timed out after {waited:?}: {}", drive.silence()),
            _ => return Err(error).context(whom),
        },
    }
    say(format_args!(
        "{whom}: told, and the drive on the line accepted it; its service port does not say what became of it"
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// Conversation of one NMT command: the command, then the heartbeats after it.
pub(super) struct Told {
    request: Request,
    /// NMT state that the command leads to.
    wanted: NmtState,
    frame: Option<Frame>,
    deadline: Instant,
    over: bool,
    /// NMT state last received from each node since the command. After a reset, a boot-up message is kept.
    heard: [Option<NmtState>; 128],
    /// Uploads the heartbeat period of the addressed node: only SDO detects a node without a heartbeat.
    client: Option<sdo::Client>,
    answer: Option<Result<u16, SdoError>>,
}

/// NMT states of the nodes after a command.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct NodeReport {
    pub(super) wanted: NmtState,
    /// Nodes that reported an NMT state, with the last state of each.
    pub(super) heard: Vec<(NodeId, NmtState)>,
    /// The addressed node, if it reported no NMT state, with its heartbeat period as read by SDO, ms.
    pub(super) silent: Option<(NodeId, Option<Result<u16, SdoError>>)>,
    /// The other nodes that booted after the reset of a node that did not boot. A node takes a new node-ID at its reset
    /// (CiA 305), and boots under it.
    pub(super) booted: Vec<NodeId>,
}

impl Told {
    /// A conversation that sends the command first, and then listens for at most `patience`.
    pub(super) fn new(request: Request, patience: Duration, now: Instant) -> Self {
        let wanted = match request.command {
            Command::Start => NmtState::Operational,
            Command::Stop => NmtState::Stopped,
            Command::EnterPreOperational => NmtState::PreOperational,
            Command::ResetNode | Command::ResetCommunication => NmtState::Initialising,
        };
        let client = match (request.target, wanted) {
            // A node that was reset sends a boot-up message. All nodes together cannot be addressed by SDO.
            (Target::All, _) | (_, NmtState::Initialising) => None,
            (Target::Node(node), _) => {
                let mut client = sdo::Client::new(node, ANSWER, 1);
                client.upload(PRODUCER_HEARTBEAT, now).expect("nothing is being transferred yet");
                Some(client)
            }
        };
        Self {
            request,
            wanted,
            frame: Some(request.encode()),
            deadline: now + patience,
            over: false,
            heard: [None; 128],
            client,
            answer: None,
        }
    }

    fn take_answer(&mut self) {
        let Some(result) = self.client.as_mut().and_then(sdo::Client::poll) else {
            return;
        };
        self.answer = Some(match result {
            // An abort counts as a period of 0 ms: a node without the object sends no heartbeat.
            Err(error) if matches!(error.cause, SdoCause::Aborted { .. }) => Ok(0),
            result => result.and_then(|transfer| transfer.number::<u16>()),
        });
        // The node sends no heartbeat, so the wait ends.
        if let Some(Ok(0)) = self.answer {
            self.over = true;
        }
    }

    pub(super) fn report(self) -> NodeReport {
        let heard = |node: NodeId| Some((node, self.heard[usize::from(node.raw())]?));
        let heard: Vec<_> = NodeId::all().filter(|node| self.request.concerns(*node)).filter_map(heard).collect();
        let silent = match self.request.target {
            Target::Node(node) if heard.is_empty() => Some((node, self.answer)),
            Target::Node(_) | Target::All => None,
        };
        let is_reset = self.wanted == NmtState::Initialising && silent.is_some();
        let booted = |node: &NodeId| self.heard[usize::from(node.raw())] == Some(NmtState::Initialising);
        let booted = NodeId::all().filter(|_| is_reset).filter(booted).collect();
        NodeReport { wanted: self.wanted, heard, silent, booted }
    }
}

impl Conversation for Told {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        // Frames from before the command say nothing about its effect.
        if self.frame.is_some() {
            return;
        }
        // Heartbeats, boot-up messages and answers to node guarding have the same form. The toggle bit is ignored.
        if let Some(heartbeat) = Heartbeat::decode(frame) {
            let (node, (state, _)) = (heartbeat.node, heartbeat.guarded());
            let heard = &mut self.heard[usize::from(node.raw())];
            // A heartbeat after the boot-up message must not hide the boot-up message.
            if *heard != Some(self.wanted) || self.wanted != NmtState::Initialising {
                *heard = Some(state);
            }
            self.over |= self.request.target == Target::Node(node) && state == self.wanted;
        }
        if let Some(client) = &mut self.client {
            client.handle(frame, now);
        }
        self.take_answer();
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let client = &mut self.client;
        self.frame.take().or_else(|| client.as_mut()?.poll_transmit(now))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let answer = self.client.as_ref().and_then(sdo::Client::poll_timeout);
        let due = answer.map_or(self.deadline, |due| due.min(self.deadline));
        (!self.over).then_some(due)
    }

    fn handle_timeout(&mut self, now: Instant) {
        if let Some(client) = &mut self.client {
            client.handle_timeout(now);
        }
        self.take_answer();
        self.over |= now >= self.deadline;
    }
}

impl NodeReport {
    /// Whether at least one node reported a state, and each reported state is the wanted state. A node without
    /// heartbeat that answers SDO is not stopped. Its answer confirms `Start` and `PreOperational`, but not `Stop`.
    pub(super) fn confirmed(&self) -> bool {
        match self.silent {
            Some(_) if self.booted.len() == 1 => true,
            Some((_, Some(Ok(0)))) => self.wanted != NmtState::Stopped,
            Some(_) => false,
            None => !self.heard.is_empty() && self.heard.iter().all(|(_, state)| *state == self.wanted),
        }
    }

    fn lines(&self, bus: &Bus) -> Vec<String> {
        let said = |(node, state): &(NodeId, NmtState)| {
            let name = bus.name_of(*node);
            match (*state, *state == self.wanted) {
                (NmtState::Initialising, true) => format!("{name}: booted"),
                (state, true) => format!("{name}: {state}"),
                (state, false) => format!("{name}: is {state}, and did not obey"),
            }
        };
        let mut lines: Vec<_> = self.heard.iter().map(said).collect();
        if let Some((node, answer)) = &self.silent {
            let others: Vec<_> = self.booted.iter().map(NodeId::to_string).collect();
            let what: &str = match (answer, self.wanted) {
                (_, NmtState::Initialising) if self.booted.len() == 1 => {
                    &format!("told, and booted as node {}, its new node-ID", others[0])
                }
                (_, NmtState::Initialising) if !others.is_empty() => {
                    &format!("told, and did not boot; the nodes {} booted", others.join(", "))
                }
                (_, NmtState::Initialising) => "told, and did not boot",
                (Some(Ok(0)), NmtState::Stopped) => "told, and still answers SDO, so it did not stop",
                (Some(Ok(0)), _) => "told; it sends no heartbeat (0x1017 is 0 or missing), and is not stopped",
                (Some(Ok(ms)), _) => &format!("told, and its heartbeat of {ms} ms was not heard"),
                (_, NmtState::Stopped) => "told; neither heartbeat nor SDO answer: stopped, or not there",
                _ => &format!("told, and neither a heartbeat nor an SDO answer came: {}", bus.silence()),
            };
            lines.push(format!("{}: {what}", bus.name_of(*node)));
        } else if self.heard.is_empty() {
            lines.push(format!("told, and nobody was heard: {}", bus.silence()));
        }
        lines
    }
}
