//! `mrroc lss scan` on a bus with slaves that deviate from CiA 305.

use std::collections::VecDeque;

use canopen::lss::{Fastscan, Mode, Part, Request as LssRequest, Response};
use hil::Device;
use master::lss::LssError;

use super::super::lss::Dialogue;
use super::*;

/// Time to wait for an answer to each request of a scan.
const QUESTION: Duration = Duration::from_millis(2);

/// Deviation of a slave from CiA 305.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Oddity {
    None,
    /// In configuration mode, the slave answers every request of a fastscan, as the slave of CANopenNode does
    /// (`CO_LSSslave.c`).
    AnswersConfigured,
    /// The slave answers every request of a fastscan in waiting mode as well.
    AnswersAlways,
    /// The end of a fastscan does not switch the slave into configuration mode.
    StaysWaiting,
}

/// A node without a node-ID that supports LSS only.
struct Slave {
    serial: u32,
    oddity: Oddity,
    mode: Mode,
    position: u8,
    answers: VecDeque<Frame>,
}

impl Slave {
    fn agrees(&mut self, question: Fastscan) -> bool {
        let Fastscan { number, bit, sub, next } = question;
        match (self.oddity, self.mode) {
            (Oddity::AnswersAlways, _) | (Oddity::AnswersConfigured, Mode::Configuration) => {
                return true;
            }
            (_, Mode::Configuration) => return false,
            (_, Mode::Waiting) => {}
        }
        if bit == 0x80 {
            self.position = 0;
            return true;
        }
        let part = Part::ALL.get(usize::from(sub));
        let Some(&part) = part.filter(|_| sub == self.position) else {
            return false;
        };
        let agrees = (identity(self.serial).get(part) ^ number) >> bit == 0;
        if agrees && bit == 0 {
            self.position = next;
            if next < sub && self.oddity != Oddity::StaysWaiting {
                self.mode = Mode::Configuration;
            }
        }
        agrees
    }
}

impl Device for Slave {
    fn handle(&mut self, frame: &Frame, _: Instant) {
        match LssRequest::decode(frame) {
            Some(LssRequest::SwitchGlobal(mode)) => self.mode = mode,
            Some(LssRequest::Fastscan(question)) if self.agrees(question) => {
                self.answers.push_back(Response::Identified.encode());
            }
            _ => {}
        }
    }
    fn poll_transmit(&mut self, _: Instant) -> Option<Frame> {
        self.answers.pop_front()
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
    fn handle_timeout(&mut self, _: Instant) {}
}

fn identity(serial: u32) -> Identity {
    Identity { vendor: 0x0000_0388, product: 1, revision: 0xFFFF_FFFF, serial }
}

/// Nodes that a scan of these slaves finds, in the order of the scan, and the error that ends it.
fn scan(slaves: &[(u32, Oddity)]) -> (Vec<Identity>, Option<LssError>) {
    let mut stage = Stage::with(&[3]);
    for &(serial, oddity) in slaves {
        let slave = Slave { serial, oddity, mode: Mode::Configuration, position: 0, answers: VecDeque::new() };
        stage.world.add_device(stage.bus, Box::new(slave));
    }
    let mut dialogue = Dialogue::scan(QUESTION);
    stage.hold(&mut dialogue);
    let last = stage.sent.last().map(|frame| frame.to_string());
    assert_eq!(last.as_deref(), Some("7E5#0400000000000000"), "all slaves are back in waiting mode");
    dialogue.found()
}

#[test]
fn every_node_is_found_once_though_some_answer_everything_once_they_are_found() {
    use Oddity::{AnswersConfigured, None, StaysWaiting};
    for oddity in [None, AnswersConfigured, StaysWaiting] {
        for other in [None, AnswersConfigured, StaysWaiting] {
            let table: [&[u32]; 5] = [&[], &[5], &[5, 6], &[u32::MAX, 0], &[0x80, 0x7F, 0xC0, 0x8000_0000]];
            for serials in table {
                let oddities = [oddity, other].into_iter().cycle();
                let slaves: Vec<_> = serials.iter().copied().zip(oddities).collect();
                let mut expected: Vec<_> = serials.iter().map(|serial| identity(*serial)).collect();
                expected.sort_by_key(|identity| identity.serial);
                assert_eq!(scan(&slaves), (expected, Option::None), "{slaves:?}");
            }
        }
    }
}

/// A drive without a node-ID that answers LSS requests after `delay`.
fn slow_drive(delay: Duration) -> Stage {
    let mut stage = Stage::with(&[3]);
    let config = Epos4Config::new(node(9), AxisConfig::irp6(Irp6Axis::ALL[0]));
    let config = Epos4Config { node: None, lss_delay: delay, power_on: stage.now, ..config };
    stage.world.add_device(stage.bus, Box::new(Epos4::new(config)));
    stage.pass(Duration::from_secs(1));
    stage
}

#[test]
fn an_answer_after_the_end_of_a_scan_is_noticed_with_its_delay() {
    let delay = Duration::from_millis(52);
    for (wait, finds) in [(20, false), (60, true)] {
        let mut stage = slow_drive(delay);
        let mut dialogue = Dialogue::scan(Duration::from_millis(wait));
        stage.hold(&mut dialogue);
        let late = dialogue.late();
        let (found, failed) = dialogue.found();
        assert_eq!((found.len(), failed), (usize::from(finds), None), "{wait} ms");
        assert_eq!(late.is_some(), !finds, "{wait} ms: {late:?}");
        if let Some(late) = late {
            assert!(late >= delay && late < delay + Duration::from_millis(3), "{late:?}");
        }
    }
    // Without a slow node, nothing is late.
    let mut stage = slow_drive(Duration::ZERO);
    let mut dialogue = Dialogue::scan(Duration::from_millis(20));
    stage.hold(&mut dialogue);
    assert_eq!(dialogue.late(), None);
}

#[test]
fn a_slave_that_answers_everything_in_either_mode_is_no_find_and_fails_the_scan() {
    use Oddity::{AnswersAlways, None};
    for slaves in [&[(5, AnswersAlways)][..], &[(4, None), (5, AnswersAlways)]] {
        assert_eq!(scan(slaves), (vec![], Some(LssError::Untrue)), "{slaves:?}");
    }
}
