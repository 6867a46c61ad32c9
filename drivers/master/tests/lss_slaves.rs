//! The LSS master against scripted slaves, written here from the description of the protocol, byte by byte.

use std::time::Duration;

use can::{Frame, Instant, StandardId};
use canopen::NodeId;
use canopen::lss::{Identity, Mode};
use mrroc_master::lss::{Answer, LssError, Master, Service};
use proptest::prelude::*;

const TIME_OUT: Duration = Duration::from_millis(10);

#[derive(Clone, Debug)]
struct Slave {
    identity: [u32; 4],
    node_id: u8,
    /// How late it answers, ms; less than the time-out.
    delay: u64,
    configuring: bool,
    /// The part of the identity that a fastscan has come to.
    position: u8,
    /// Parts that a selective switch has named rightly so far.
    selected: u8,
    oddity: Oddity,
    /// Number of its answer to a fastscan that comes after the time-out, from 0.
    late: Option<usize>,
}

/// How a slave deviates from CiA 305.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Oddity {
    #[default]
    None,
    /// Once in configuration mode, it answers every question of a fastscan, as CANopenNode's slave does.
    AnswersConfigured,
    /// It answers every question of a fastscan in either mode.
    AnswersAlways,
    /// The end of a fastscan does not put it into configuration mode.
    StaysWaiting,
}

impl Slave {
    fn answers_anything(&self) -> bool {
        match self.oddity {
            Oddity::None | Oddity::StaysWaiting => false,
            Oddity::AnswersConfigured => self.configuring,
            Oddity::AnswersAlways => true,
        }
    }

    fn take(&mut self, request: [u8; 8]) -> Option<[u8; 8]> {
        let [specifier, first, ..] = request;
        let value = u32::from_le_bytes([request[1], request[2], request[3], request[4]]);
        let reply = |specifier| Some([specifier, 0, 0, 0, 0, 0, 0, 0]);
        match specifier {
            0x04 => self.configuring = first == 1,
            0x40..=0x43 => {
                let part = specifier - 0x40;
                let right = self.selected == part && self.identity[usize::from(part)] == value;
                self.selected = if right { part + 1 } else { 0 };
                if self.selected == 4 {
                    self.selected = 0;
                    self.configuring = true;
                    return reply(0x44);
                }
            }
            0x4C if self.node_id == 0xFF => return reply(0x50),
            0x51 if self.node_id == 0xFF && self.answers_anything() => return reply(0x4F),
            0x51 if self.node_id == 0xFF && !self.configuring => {
                let [bit, sub, next] = [request[5], request[6], request[7]];
                if bit == 0x80 {
                    self.position = 0;
                    return reply(0x4F);
                }
                let differ = self.identity[usize::from(self.position)] ^ value;
                if sub == self.position && differ >> bit == 0 {
                    if bit == 0 {
                        self.configuring = next < sub && self.oddity != Oddity::StaysWaiting;
                        self.position = next;
                    }
                    return reply(0x4F);
                }
            }
            _ if !self.configuring => {}
            0x11 => {
                let known = matches!(first, 1..=127 | 0xFF);
                if known {
                    self.node_id = first;
                }
                return Some([0x11, u8::from(!known), 0, 0, 0, 0, 0, 0]);
            }
            0x17 => return reply(0x17),
            0x5A..=0x5D => {
                let [a, b, c, d] = self.identity[usize::from(specifier - 0x5A)].to_le_bytes();
                return Some([specifier, a, b, c, d, 0, 0, 0]);
            }
            0x5E => return Some([0x5E, self.node_id, 0, 0, 0, 0, 0, 0]),
            _ => {}
        }
        None
    }
}

/// Runs a service to its end.
fn run(master: &mut Master, slaves: &mut [Slave], service: Service, now: &mut Instant) -> Result<Answer, LssError> {
    master.start(service, TIME_OUT, *now).expect("idle");
    let mut answers = vec![];
    loop {
        while let Some(frame) = master.poll_transmit(*now) {
            assert_eq!(frame.standard_data_id(), StandardId::new(0x7E5));
            let request = frame.data().try_into().expect("requests have eight bytes");
            for slave in slaves.iter_mut() {
                if let Some(answer) = slave.take(request) {
                    let id = StandardId::new(0x7E4).expect("11 bits");
                    let frame = Frame::new(id, &answer).expect("8 bytes");
                    let is_late = slave.late == Some(0);
                    slave.late = slave.late.and_then(|number| number.checked_sub(1));
                    let late = if is_late { TIME_OUT } else { Duration::ZERO };
                    answers.push((*now + Duration::from_millis(slave.delay) + late, frame));
                }
            }
            answers.sort_by_key(|(due, _)| *due);
        }
        if let Some(result) = master.poll() {
            return result;
        }
        let deadline = master.poll_timeout().expect("a service under way has a deadline");
        match answers.first() {
            Some(&(due, frame)) if due < deadline => {
                answers.remove(0);
                *now = due;
                master.handle(&frame, due);
            }
            _ => {
                *now = deadline;
                master.handle_timeout(deadline);
            }
        }
    }
}

fn identity([vendor, product, revision, serial]: [u32; 4]) -> Identity {
    Identity { vendor, product, revision, serial }
}

/// Numbers that often agree in their upper bits, and often altogether.
fn numbers() -> impl Strategy<Value = u32> {
    prop_oneof![Just(0), Just(0xFB), 0..4_u32, any::<u32>(), Just(u32::MAX)]
}

fn slaves() -> impl Strategy<Value = Vec<Slave>> {
    let identity = (numbers(), numbers(), numbers(), numbers());
    let slave = (identity, 0..10_u64, any::<bool>());
    proptest::collection::vec(slave, 0..5).prop_map(|slaves| {
        let mut slaves: Vec<_> = slaves
            .into_iter()
            .map(|((vendor, product, revision, serial), delay, configured)| Slave {
                identity: [vendor, product, revision, serial],
                node_id: if configured { 100 } else { 0xFF },
                delay,
                configuring: false,
                position: 0,
                selected: 0,
                oddity: Oddity::None,
                late: None,
            })
            .collect();
        slaves.sort_by_key(|slave| slave.identity);
        slaves.dedup_by_key(|slave| slave.identity);
        slaves
    })
}

proptest! {
    #[test]
    fn every_slave_without_a_node_id_is_found_and_gets_one(mut slaves in slaves()) {
        let mut master = Master::default();
        let mut now = Instant::ZERO;
        let unconfigured: Vec<_> =
            slaves.iter().filter(|slave| slave.node_id == 0xFF).map(|slave| slave.identity).collect();
        for (expected, node) in unconfigured.iter().zip(NodeId::all()) {
            let mut ask = |service| run(&mut master, &mut slaves, service, &mut now);
            prop_assert_eq!(ask(Service::IdentifyUnconfigured), Ok(Answer::Unconfigured(true)));
            prop_assert_eq!(ask(Service::Fastscan), Ok(Answer::Found(Some(identity(*expected)))));
            prop_assert_eq!(ask(Service::InquireIdentity), Ok(Answer::Identity(identity(*expected))));
            prop_assert_eq!(ask(Service::InquireNodeId), Ok(Answer::NodeId(None)));
            prop_assert_eq!(ask(Service::ConfigureNodeId(Some(node))), Ok(Answer::Done));
            prop_assert_eq!(ask(Service::Store), Ok(Answer::Done));
            prop_assert_eq!(ask(Service::SwitchGlobal(Mode::Waiting)), Ok(Answer::Done));
        }
        let mut ask = |service| run(&mut master, &mut slaves, service, &mut now);
        prop_assert_eq!(ask(Service::IdentifyUnconfigured), Ok(Answer::Unconfigured(false)));
        prop_assert_eq!(ask(Service::Fastscan), Ok(Answer::Found(None)));
        let given: Vec<_> = slaves.iter().filter(|slave| slave.node_id != 100).map(|slave| slave.node_id).collect();
        prop_assert_eq!(given, (1..=unconfigured.len() as u8).collect::<Vec<_>>());
    }

    #[test]
    fn a_slave_is_selected_by_its_whole_identity(mut slaves in slaves(), other in any::<[u32; 4]>()) {
        let mut master = Master::default();
        let mut now = Instant::ZERO;
        for at in 0..slaves.len() {
            let expected = identity(slaves[at].identity);
            let mut ask = |service| run(&mut master, &mut slaves, service, &mut now);
            prop_assert_eq!(ask(Service::SwitchSelective(expected)), Ok(Answer::Done));
            prop_assert_eq!(ask(Service::InquireIdentity), Ok(Answer::Identity(expected)));
            prop_assert_eq!(ask(Service::SwitchGlobal(Mode::Waiting)), Ok(Answer::Done));
        }
        if slaves.iter().all(|slave| slave.identity != other) {
            let service = Service::SwitchSelective(identity(other));
            let waited = TIME_OUT;
            prop_assert_eq!(
                run(&mut master, &mut slaves, service, &mut now),
                Err(LssError::TimedOut { service, waited })
            );
        }
    }
}

proptest! {
    #[test]
    fn every_slave_is_found_above_the_one_before(mut slaves in slaves(), odd in any::<bool>()) {
        for slave in &mut slaves {
            slave.oddity = if odd { Oddity::AnswersConfigured } else { Oddity::StaysWaiting };
        }
        let mut master = Master::default();
        let mut now = Instant::ZERO;
        let mut service = Service::Fastscan;
        let unconfigured: Vec<_> =
            slaves.iter().filter(|slave| slave.node_id == 0xFF).map(|slave| slave.identity).collect();
        for expected in unconfigured {
            let expected = identity(expected);
            let mut ask = |service| run(&mut master, &mut slaves, service, &mut now);
            prop_assert_eq!(ask(service), Ok(Answer::Found(Some(expected))));
            prop_assert_eq!(ask(Service::SwitchGlobal(Mode::Waiting)), Ok(Answer::Done));
            service = Service::FastscanAbove(expected);
        }
        prop_assert_eq!(run(&mut master, &mut slaves, service, &mut now), Ok(Answer::Found(None)));
    }

    #[test]
    fn a_slave_that_answers_everything_is_never_found_and_hides_the_others(
        mut slaves in slaves(), above in any::<[u32; 4]>(), always in any::<bool>(),
    ) {
        let Some(first) = slaves.first_mut() else { return Ok(()) };
        first.node_id = 0xFF;
        first.configuring = true;
        first.oddity = if always { Oddity::AnswersAlways } else { Oddity::AnswersConfigured };
        for service in [Service::Fastscan, Service::FastscanAbove(identity(above))] {
            let mut now = Instant::ZERO;
            let scanned = run(&mut Master::default(), &mut slaves, service, &mut now);
            prop_assert_eq!(scanned, Err(LssError::Untrue));
            prop_assert_eq!(now.since(Instant::ZERO), 3 * TIME_OUT);
        }
    }
}

#[test]
fn a_fastscan_takes_134_time_outs_and_one_for_each_number_that_is_odd() {
    let slave = Slave {
        identity: [0xFB, 0x6552_0000, 0x0170_0000, 0x1234_5678],
        node_id: 0xFF,
        delay: 1,
        configuring: false,
        position: 0,
        selected: 0,
        oddity: Oddity::None,
        late: None,
    };
    let mut now = Instant::ZERO;
    let found = run(&mut Master::default(), &mut [slave.clone()], Service::Fastscan, &mut now);
    assert_eq!(found, Ok(Answer::Found(Some(identity(slave.identity)))));
    assert_eq!(now.since(Instant::ZERO), 135 * TIME_OUT);
}

#[test]
fn a_late_answer_to_a_fastscan_gives_no_wrong_identity_and_hides_no_slave() {
    let slave = Slave {
        identity: [0xFA, 0x6552_0000, 0x0170_0000, 0x1234_5678],
        node_id: 0xFF,
        delay: 1,
        configuring: false,
        position: 0,
        selected: 0,
        oddity: Oddity::None,
        late: None,
    };
    let scanned = |late| {
        let mut slaves = [Slave { late: Some(late), ..slave.clone() }];
        run(&mut Master::default(), &mut slaves, Service::Fastscan, &mut Instant::from_nanos(0))
    };
    let mut failed = 0;
    for late in 0..200 {
        match scanned(late) {
            Ok(found) => assert_eq!(found, Answer::Found(Some(identity(slave.identity))), "answer {late}"),
            Err(LssError::Late | LssError::Vanished { .. }) => failed += 1,
            Err(error) => panic!("answer {late}: {error}"),
        }
    }
    // One answer per bit that is 0, and further ones.
    assert!(failed > 80, "{failed}");
    assert_eq!(scanned(0), Err(LssError::Late));
}
