//! Conversations with emulated drives on a virtual bus in virtual time.

use std::time::Duration;

use can::timing::Bitrate;
use can::{Frame, Instant, Port, Received, StandardId, VirtualPort};
use canopen::lss::Identity;
use canopen::nmt::{Command, NmtState, Request};
use canopen::objects::{DEVICE_NAME, PRODUCER_HEARTBEAT, STATUSWORD};
use canopen::sdo::AbortCode;
use canopen::sync::Sync;
use canopen::{NodeId, Object};
use hil::epos4::{Epos4, Epos4Config};
use hil::{AxisConfig, BusId, Irp6Axis, World};
use master::lss::{Answer, Service};
use master::sdo::{SdoCause, SdoError};

use super::lss::Dialogue;
use super::nmt::{NodeReport, Told};
use super::pdo_map::MappingQuestions;
use super::scan::Scan;
use super::sdo;
use super::survey::Survey;
use super::talk::Conversation;
use super::words::Identification;

mod lss_slaves;

/// Step of the virtual time.
const TICK: Duration = Duration::from_micros(100);

/// Upper bound for the duration of every conversation.
const LONGEST: Duration = Duration::from_secs(10);

const TIMEOUT: Duration = Duration::from_millis(200);

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

/// A bus with emulated EPOS4 drives.
struct Stage {
    world: World,
    bus: BusId,
    port: VirtualPort,
    now: Instant,
    sent: Vec<Frame>,
}

impl Stage {
    fn with(nodes: &[u8]) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        for &raw in nodes {
            let config = Epos4Config::new(node(raw), AxisConfig::irp6(Irp6Axis::ALL[0]));
            world.add_device(bus, Box::new(Epos4::new(config)));
        }
        let mut stage = Self { world, bus, port, now: Instant::ZERO, sent: Vec::new() };
        // The drives boot.
        stage.pass(Duration::from_secs(1));
        stage
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
        self.world.advance(self.now);
        while !self.receive().is_empty() {}
    }

    fn receive(&mut self) -> Vec<Received> {
        let frame = Sync::default().encode();
        let mut received = [Received { frame, at: Instant::ZERO }; 64];
        let count = self.port.receive(self.now, &mut received).unwrap();
        received[..count].to_vec()
    }

    /// Runs a conversation until its end, and returns its duration.
    fn hold(&mut self, conversation: &mut impl Conversation) -> Duration {
        let began = self.now;
        let mut untaken = None;
        loop {
            conversation.handle_timeout(self.now);
            while let Some(frame) = untaken.take().or_else(|| conversation.poll_transmit(self.now)) {
                if self.port.send(self.now, &[frame]).unwrap() == 0 {
                    untaken = Some(frame);
                    break;
                }
                self.sent.push(frame);
            }
            if conversation.poll_timeout().is_none() {
                return self.now.since(began);
            }
            assert!(self.now.since(began) < LONGEST, "it does not end");
            self.now += TICK;
            self.world.advance(self.now);
            for Received { frame, at } in self.receive() {
                conversation.handle(&frame, at);
            }
        }
    }

    fn read(&mut self, from: u8, object: Object) -> Result<Vec<u8>, SdoError> {
        self.transfer(from, object, None)
    }

    fn transfer(&mut self, with: u8, object: Object, data: Option<&[u8]>) -> Result<Vec<u8>, SdoError> {
        self.transfer_by(false, with, object, data)
    }

    fn transfer_by(
        &mut self,
        blocks: bool,
        with: u8,
        object: Object,
        data: Option<&[u8]>,
    ) -> Result<Vec<u8>, SdoError> {
        let with = node(with);
        let client = sdo::start(with, object, data, blocks, TIMEOUT, self.now);
        let mut client = client.unwrap();
        self.hold(&mut client);
        let result = client.poll().unwrap();
        result.map(|transfer| transfer.data.to_vec())
    }

    fn tell(&mut self, request: Request) -> NodeReport {
        let mut told = Told::new(request, Duration::from_secs(2), self.now);
        self.hold(&mut told);
        told.report()
    }

    fn scan(&mut self) -> (Vec<String>, Duration) {
        let mut scan = Scan::new(TIMEOUT, self.now);
        let took = self.hold(&mut scan);
        let nodes = scan.into_nodes().map(|node| node.to_string());
        (nodes.collect(), took)
    }
}

#[test]
fn a_scan_of_a_whole_bus_takes_about_a_second_and_finds_everybody() {
    let everybody: Vec<u8> = (1..=127).collect();
    for (nodes, most) in [(&[][..], 1100), (&[1, 64, 127], 1100), (&everybody, 1500)] {
        let (found, took) = Stage::with(nodes).scan();
        assert_eq!(found.len(), nodes.len());
        assert!(took <= Duration::from_millis(most), "{took:?}");
        // The scan waits for heartbeats, which come once a second.
        assert!(took >= Duration::from_secs(1), "{took:?}");
    }
}

#[test]
fn a_scan_tells_who_a_node_is_and_what_its_heartbeat_says() {
    let mut stage = Stage::with(&[3, 5]);
    stage.transfer(5, PRODUCER_HEARTBEAT, Some(&700_u16.to_le_bytes())).unwrap();
    let (found, _) = stage.scan();
    assert!(found[0].starts_with("CiA 402, servo drive"), "{found:?}");
    assert!(found[0].contains(", maxon, product 0x"), "{found:?}");
    assert!(found[0].ends_with("NMT state unknown, sends no heartbeat"), "{found:?}");
    assert!(found[1].ends_with("pre-operational, heartbeat each 700 ms"), "{found:?}");
}

#[test]
fn a_stopped_node_is_found_by_its_heartbeat() {
    let mut stage = Stage::with(&[3]);
    stage.transfer(3, PRODUCER_HEARTBEAT, Some(&300_u16.to_le_bytes())).unwrap();
    assert!(stage.tell(Command::Stop.to(node(3))).confirmed());
    let (found, _) = stage.scan();
    assert_eq!(found, ["is heard and answers no SDO, stopped, heard each 300 ms"]);
}

#[test]
fn an_object_is_read_written_and_read_back() {
    let mut stage = Stage::with(&[3]);
    let value = 250_u16.to_le_bytes();
    assert_eq!(stage.read(3, PRODUCER_HEARTBEAT).unwrap(), [0, 0]);
    stage.transfer(3, PRODUCER_HEARTBEAT, Some(&value)).unwrap();
    assert_eq!(stage.read(3, PRODUCER_HEARTBEAT).unwrap(), value);
    let segmented = stage.read(3, DEVICE_NAME).unwrap();
    assert!(segmented.len() > 4);
    // The drive does not support block transfer, so the client uses ordinary transfer.
    let by_blocks = stage.transfer_by(true, 3, DEVICE_NAME, None);
    assert_eq!(by_blocks, Ok(segmented));
}

#[test]
fn a_refusal_ends_a_transfer_and_silence_does() {
    let mut stage = Stage::with(&[3]);
    let refused = |answer: Result<Vec<u8>, SdoError>, expected: AbortCode| match answer {
        Err(error) => assert_eq!(error.cause, SdoCause::Aborted { code: expected }),
        other => panic!("{other:?}"),
    };
    refused(stage.transfer(3, STATUSWORD, Some(&[0, 0])), AbortCode::READ_ONLY);
    refused(stage.read(3, Object::new(0x5FFF, 0)), AbortCode::NO_OBJECT);
    let silent = stage.read(4, STATUSWORD);
    let cause = silent.map_err(|error| error.cause);
    assert!(matches!(cause, Err(SdoCause::TimedOut { waited }) if waited >= 3 * TIMEOUT));
    // Three requests, each ended by an abort after its time-out.
    let to_4 = |frame: &&Frame| frame.to_string().starts_with("604#");
    assert_eq!(stage.sent.iter().filter(to_4).count(), 6);
}

#[test]
fn commands_are_confirmed_by_what_the_node_says_next() {
    let mut stage = Stage::with(&[3, 5]);
    // A node without a heartbeat only shows that it is not stopped.
    let told = stage.tell(Command::Start.to(node(3)));
    assert!(told.confirmed(), "{told:?}");
    assert_eq!(told.silent, Some((node(3), Some(Ok(0)))));
    let told = stage.tell(Command::Stop.to(node(3)));
    assert!(!told.confirmed(), "{told:?}");
    let told = stage.tell(Command::ResetNode.to(node(3)));
    assert!(told.confirmed(), "{told:?}");
    assert_eq!(told.heard, [(node(3), NmtState::Initialising)]);

    stage.pass(Duration::from_secs(1));
    stage.transfer(5, PRODUCER_HEARTBEAT, Some(&100_u16.to_le_bytes())).unwrap();
    let cases = [
        (Command::Start, NmtState::Operational),
        (Command::Stop, NmtState::Stopped),
        (Command::EnterPreOperational, NmtState::PreOperational),
        (Command::ResetCommunication, NmtState::Initialising),
    ];
    for (command, state) in cases {
        let told = stage.tell(command.to(node(5)));
        assert!(told.confirmed(), "{command:?} {told:?}");
        assert_eq!(told.heard, [(node(5), state)]);
    }
}

#[test]
fn a_node_that_another_master_guards_is_read_by_its_state_without_the_toggle_bit() {
    let now = Instant::ZERO;
    let mut told = Told::new(Command::Start.to(node(3)), TIMEOUT, now);
    while told.poll_transmit(now).is_some() {}
    told.handle(&parse("703#85"), now);
    let report = told.report();
    assert!(report.confirmed(), "{report:?}");
    assert_eq!(report.heard, [(node(3), NmtState::Operational)]);

    let mut scan = Scan::new(TIMEOUT, now);
    scan.handle(&parse("703#FF"), now);
    let found: Vec<_> = scan.into_nodes().map(|node| node.to_string()).collect();
    assert_eq!(found, ["is heard and answers no SDO, pre-operational"]);
}

#[test]
fn a_node_that_still_answers_sdo_did_not_stop() {
    let told = NodeReport {
        wanted: NmtState::Stopped,
        heard: Vec::new(),
        silent: Some((node(3), Some(Ok(0)))),
        booted: Vec::new(),
    };
    assert!(!told.confirmed());
}

#[test]
fn a_node_that_boots_under_its_new_node_id_obeyed_the_reset() {
    let mut stage = Stage::with(&[3]);
    let services = [(Service::ConfigureNodeId(Some(node(5))), TIMEOUT)];
    stage.hold(&mut Dialogue::with(None, &services, None, TIMEOUT));
    let told = stage.tell(Command::ResetCommunication.to(node(3)));
    assert_eq!((told.silent, told.booted.as_slice()), (Some((node(3), None)), &[node(5)][..]));
    assert!(told.confirmed());
    // A node that keeps its node-ID, and a node that is absent.
    assert_eq!(stage.tell(Command::ResetCommunication.to(node(5))).booted, []);
    assert!(!stage.tell(Command::ResetCommunication.to(node(3))).confirmed());
}

#[test]
fn an_abort_is_an_answer_of_a_node_without_heartbeat() {
    for (command, confirmed) in [(Command::Start, true), (Command::Stop, false)] {
        let now = Instant::ZERO;
        let mut told = Told::new(command.to(node(3)), TIMEOUT, now);
        while told.poll_transmit(now).is_some() {}
        // Object 0x1017 does not exist.
        told.handle(&parse("583#8017100000000206"), now);
        assert_eq!(told.poll_timeout(), None);
        let report = told.report();
        assert_eq!(report.silent, Some((node(3), Some(Ok(0)))));
        assert_eq!(report.confirmed(), confirmed, "{command:?}");
    }
}

#[test]
fn a_node_that_is_not_there_confirms_nothing() {
    let mut stage = Stage::with(&[3]);
    let commands =
        [Command::Start, Command::Stop, Command::EnterPreOperational, Command::ResetNode, Command::ResetCommunication];
    for command in commands {
        assert!(!stage.tell(command.to(node(4))).confirmed(), "{command:?}");
    }
    assert!(!Stage::with(&[]).tell(Command::ResetNode.to_all()).confirmed());
}

#[test]
fn all_nodes_are_told_at_once_and_each_is_heard() {
    let mut stage = Stage::with(&[3, 5]);
    let told = stage.tell(Command::ResetNode.to_all());
    assert!(told.confirmed(), "{told:?}");
    let booted = [(node(3), NmtState::Initialising), (node(5), NmtState::Initialising)];
    assert_eq!(told.heard, booted);
}

#[test]
fn nodes_tell_what_their_pdos_carry() {
    let mut stage = Stage::with(&[3]);
    let nodes = [3, 4].map(|raw| (node(raw), MappingQuestions::of(node(raw))));
    let mut survey = Survey::new(nodes.into_iter(), TIMEOUT);
    stage.hold(&mut survey);
    let mut answers = survey.into_answers();
    let (_, drive) = answers.next().unwrap();
    assert_eq!(drive.identification, Identification { vendor: Some(0xFB), device_type: Some(0x0002_0192) });
    let map = drive.into_map();
    // PDO 1 of each direction is enabled by default in an EPOS4.
    let of = |id: u16| map[&id].entries.iter().map(|entry| entry.object);
    assert_eq!(map.keys().copied().collect::<Vec<_>>(), [0x183, 0x203]);
    assert!(of(0x183).eq([STATUSWORD]));
    let (_, absent) = answers.next().unwrap();
    assert!(absent.identification == Identification::default() && absent.into_map().is_empty());
}

/// Runs a conversation in which each sent frame is answered at once. Returns the sent frames and the duration.
fn answered(
    conversation: &mut impl Conversation,
    mut answer: impl FnMut(&str) -> Vec<&'static str>,
) -> (Vec<String>, Duration) {
    let (mut now, mut said) = (Instant::ZERO, Vec::new());
    while now < Instant::ZERO + 3 * LONGEST {
        conversation.handle_timeout(now);
        while let Some(frame) = conversation.poll_transmit(now) {
            said.push(frame.to_string());
            for text in answer(&frame.to_string()) {
                conversation.handle(&parse(text), now);
            }
        }
        let Some(due) = conversation.poll_timeout() else {
            return (said, now.since(Instant::ZERO));
        };
        now = due.max(now + TICK);
    }
    panic!("it does not end: {said:?}");
}

/// Parses a frame in the notation of candump.
fn parse(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let byte = |at| u8::from_str_radix(&data[at..at + 2], 16).unwrap();
    let data: Vec<u8> = (0..data.len()).step_by(2).map(byte).collect();
    let id = u16::from_str_radix(id, 16).unwrap();
    Frame::new(StandardId::new(id).unwrap(), &data).unwrap()
}

#[test]
fn a_node_is_given_its_node_id_by_these_frames_and_boots() {
    let identity = Identity { vendor: 0xFB, product: 0x6150_0000, revision: 0x0170_0000, serial: 0x1234_5678 };
    let services = [(Service::ConfigureNodeId(Some(node(5))), TIMEOUT), (Service::Store, TIMEOUT)];
    let mut dialogue = Dialogue::with(Some(identity), &services, Some(node(5)), TIMEOUT);
    let mut modes = 0;
    let (said, _) = answered(&mut dialogue, |said| match &said[..6] {
        "7E5#43" => vec!["7E4#4400000000000000"],
        "7E5#11" => vec!["7E4#1100000000000000"],
        "7E5#17" => vec!["7E4#1700000000000000"],
        "7E5#04" => {
            modes += 1;
            if modes == 2 { vec!["705#00"] } else { vec![] }
        }
        _ => vec![],
    });
    let expected = [
        "7E5#0400000000000000",
        "7E5#40FB000000000000",
        "7E5#4100005061000000",
        "7E5#4200007001000000",
        "7E5#4378563412000000",
        "7E5#1105000000000000",
        "7E5#1700000000000000",
        "7E5#0400000000000000",
    ];
    assert_eq!(said, expected);
    assert!(dialogue.booted);
    assert!(dialogue.result().is_ok());
}

#[test]
fn a_dialogue_that_is_broken_off_sends_all_slaves_back_to_waiting_mode() {
    let mut dialogue = Dialogue::with(None, &[(Service::Store, TIMEOUT)], None, TIMEOUT);
    dialogue.handle_timeout(Instant::ZERO);
    while dialogue.poll_transmit(Instant::ZERO).is_some() {}
    let last = dialogue.break_off().map(|frame| frame.to_string());
    assert_eq!(last.as_deref(), Some("7E5#0400000000000000"));
}

#[test]
fn whatever_fails_all_slaves_are_back_in_waiting_mode_at_the_end() {
    let services = [(Service::ConfigureNodeId(Some(node(5))), TIMEOUT), (Service::Store, TIMEOUT)];
    for answer in [None, Some("7E4#1101000000000000")] {
        let mut dialogue = Dialogue::with(None, &services, Some(node(5)), TIMEOUT);
        let (said, took) = answered(&mut dialogue, |said| match &said[..6] {
            "7E5#11" => answer.into_iter().collect(),
            _ => vec![],
        });
        let expected = ["7E5#0400000000000000", "7E5#0401000000000000", "7E5#1105000000000000", "7E5#0400000000000000"];
        assert_eq!(said, expected);
        assert!(took <= 2 * TIMEOUT, "{took:?}");
        let (booted, result) = (dialogue.booted, dialogue.result());
        assert!(result.is_err() && !booted, "{result:?}");
    }
}

#[test]
fn a_bus_on_which_nobody_answers_has_no_node_without_a_node_id() {
    let timeout = Duration::from_millis(20);
    let mut nobody = Dialogue::scan(timeout);
    answered(&mut nobody, |_| vec![]);
    assert_eq!(nobody.result().unwrap()[1], Answer::Found(None));
    let mut anybody = Dialogue::anybody(timeout);
    let unconfigured = |said: &str| match &said[..6] {
        "7E5#4C" => vec!["7E4#5000000000000000"],
        _ => vec![],
    };
    answered(&mut anybody, unconfigured);
    assert!(anybody.result().unwrap().contains(&Answer::Unconfigured(true)));
}
