//! Requests and answers of both protocols as one stream.

use serial::hi_moxa::{self, Flags};
use serial::nfv2::{self, Answer as Item, Frame, Status};

use super::AxisCounters;
use super::config::Protocol;
use super::objects::Objects;
use crate::{Increments, Milliamperes};

/// Bytes of a cyclic NFv2 request: a set-point and three reads.
pub(super) const NFV2_REQUEST: usize = 15;

/// Bytes of the longest NFv2 answer to a request of this driver: position, current and status.
pub(super) const NFV2_ANSWER: usize = 19;

/// Bytes of an NFv2 answer with a position and either a current or a status.
const NFV2_SHORT_ANSWER: usize = 15;

/// An answer of a drive, in either protocol. A request that asks for the current or for the status alone has an answer
/// without the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Answer {
    pub(super) position: Increments,
    pub(super) current: Option<Milliamperes>,
    /// In the bits of NFv2, which has more bits.
    pub(super) status: Option<Status>,
}

impl Answer {
    /// Objects of the answer. The position alone is no answer.
    pub(super) fn objects(self) -> Objects {
        match (self.current, self.status) {
            (Some(_), None) => Objects::Current,
            (None, Some(_)) => Objects::Status,
            (Some(_), Some(_)) | (None, None) => Objects::All,
        }
    }
}

/// Finds answers among the bytes of a line.
///
/// NFv2 is searched byte by byte for a header that only an expected answer can have. After a wrong header, item or CRC
/// the search continues at the next byte, so any damage costs one answer.
///
/// The older protocol has no header. Its answers are cut by time, as the line is idle between two exchanges. The bytes
/// since the last request are the answer if they have its length. Other bytes are refused as a whole.
#[derive(Clone, Debug)]
pub(super) struct Stream {
    protocol: Protocol,
    address: u8,
    /// The beginning of what may become an answer.
    held: [u8; NFV2_ANSWER],
    length: usize,
    start: StartByte,
    /// Last address other than that of the drive.
    foreign: Option<u8>,
}

/// Knowledge of the first byte of the older protocol's answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StartByte {
    Unknown,
    Constant(u8),
    Varies,
}

/// Answers in one reading of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    /// The last answer; in NFv2 the last one with the objects of the last request, if there is one.
    pub(super) answer: Option<Answer>,
    pub(super) count: u32,
}

impl Stream {
    pub(super) fn new(protocol: Protocol, address: u8) -> Self {
        Self { protocol, address, held: [0; NFV2_ANSWER], length: 0, start: StartByte::Unknown, foreign: None }
    }

    /// Address of frames from another drive since the stream was new.
    pub(super) fn foreign(&self) -> Option<u8> {
        self.foreign
    }

    /// Takes the bytes of one reading. `owed` says how many requests were not answered yet, and `asked` the objects of
    /// the last one.
    pub(super) fn take(&mut self, bytes: &[u8], owed: u32, asked: Objects, counters: &mut AxisCounters) -> Found {
        match self.protocol {
            Protocol::Nfv2 => self.search(bytes, asked, counters),
            Protocol::HiMoxa => self.cut(bytes, owed, counters),
        }
    }

    fn search(&mut self, bytes: &[u8], asked: Objects, counters: &mut AxisCounters) -> Found {
        let mut found = Found::default();
        for &byte in bytes {
            self.held[self.length] = byte;
            self.length += 1;
            while let Some(frame) = self.next_frame(counters) {
                found.take(frame, asked);
            }
        }
        // Bytes that only look like a header may hide a shorter answer behind them.
        if found.count == 0 {
            while let Some(frame) = self.hidden_frame(counters) {
                found.take(frame, asked);
            }
        }
        found
    }

    /// The answer at the front of the bytes, if it is whole. Drops bytes that begin no answer.
    fn next_frame(&mut self, counters: &mut AxisCounters) -> Option<Answer> {
        // At most as many turns as bytes are held, each of which drops one.
        while self.length > 0 {
            let held = &self.held[..self.length];
            if !begins_answer(held) {
                self.consume(1);
                continue;
            }
            let whole = Frame::length(held).filter(|length| *length <= self.length)?;
            match Frame::parse(&held[..whole]).and_then(|frame| Some((frame.address, items(frame)?))) {
                Some((address, answer)) => {
                    self.consume(whole);
                    if address == self.address {
                        return Some(answer);
                    }
                    self.foreign = Some(address);
                    counters.foreign += 1;
                }
                None => {
                    counters.damaged += 1;
                    self.consume(1);
                }
            }
        }
        None
    }

    /// The first whole answer of the drive behind the front of the bytes. The bytes before it are dropped.
    fn hidden_frame(&mut self, counters: &mut AxisCounters) -> Option<Answer> {
        let (start, answer) = (1..self.length).find_map(|start| {
            let held = &self.held[start..self.length];
            let length = Frame::length(held).filter(|length| *length <= held.len())?;
            let frame = Frame::parse(&held[..length]).filter(|frame| frame.address == self.address)?;
            Some((start + length, items(frame)?))
        })?;
        counters.damaged += 1;
        self.consume(start);
        Some(answer)
    }

    fn consume(&mut self, count: usize) {
        self.held.copy_within(count..self.length, 0);
        self.length -= count;
    }

    fn cut(&mut self, bytes: &[u8], owed: u32, counters: &mut AxisCounters) -> Found {
        let before = std::mem::take(&mut self.length);
        let (count, whole) = match (before + bytes.len(), bytes.len()) {
            (0, _) => return Found::default(),
            // The rest of a torn answer never came, and this is the next answer.
            (_, hi_moxa::ANSWER) => (1, true),
            // An answer that the last reading cut in two, alone or with the next answer behind it.
            (all, 1..) => {
                let count = all / hi_moxa::ANSWER;
                let owed = owed.max(1) as usize;
                (count, all % hi_moxa::ANSWER == 0 && count <= owed)
            }
            (_, 0) => return Found::default(),
        };
        let mut answer = [0; hi_moxa::ANSWER];
        if whole {
            let last = bytes.len().min(hi_moxa::ANSWER);
            let (front, back) = answer.split_at_mut(hi_moxa::ANSWER - last);
            front.copy_from_slice(&self.held[..front.len()]);
            back.copy_from_slice(&bytes[bytes.len() - last..]);
            let answer = hi_moxa::Answer::decode(answer);
            if matches!(self.start, StartByte::Constant(start) if start != answer.start) {
                counters.damaged += 1;
                return Found::default();
            }
            return Found { answer: Some(translated(answer)), count: count as u32 };
        }
        counters.damaged += 1;
        if bytes.len() < hi_moxa::ANSWER {
            self.held[..bytes.len()].copy_from_slice(bytes);
            self.length = bytes.len();
        }
        Found::default()
    }

    /// Learns the start byte of answers while bring-up exchanges parameters.
    pub(super) fn learn(&mut self, bytes: &[u8]) {
        if let (Protocol::HiMoxa, &[start, ..]) = (self.protocol, bytes) {
            self.start = match self.start {
                StartByte::Unknown => StartByte::Constant(start),
                StartByte::Constant(known) if known == start => self.start,
                StartByte::Constant(_) | StartByte::Varies => StartByte::Varies,
            };
        }
    }
}

impl Found {
    fn take(&mut self, answer: Answer, asked: Objects) {
        self.count += 1;
        if self.answer.is_none_or(|before| before.objects() != asked) || answer.objects() == asked {
            self.answer = Some(answer);
        }
    }
}

/// Whether bytes may be the beginning of an answer to a request of this driver, from any drive.
fn begins_answer(bytes: &[u8]) -> bool {
    [NFV2_ANSWER, NFV2_SHORT_ANSWER].into_iter().any(|length| {
        let index = length as u8 - 1;
        bytes.iter().zip([nfv2::START, index, !index]).all(|(byte, right)| *byte == right)
    })
}

/// The position, and current or status or both, each at most once and nothing else.
fn items(frame: Frame) -> Option<Answer> {
    let (mut position, mut current, mut status) = (None, None, None);
    for item in frame.answers() {
        let before = match item.ok()? {
            Item::Position(counts) => position.replace(Increments(counts)).is_some(),
            Item::Current(raw) => current.replace(Milliamperes(raw)).is_some(),
            Item::Status(bits) => status.replace(bits).is_some(),
        };
        if before {
            return None;
        }
    }
    let answer = Answer { position: position?, current, status };
    (current.is_some() || status.is_some()).then_some(answer)
}

fn translated(answer: hi_moxa::Answer) -> Answer {
    let bits = [
        (Flags::UPPER_LIMIT, Status::UPPER_LIMIT),
        (Flags::LOWER_LIMIT, Status::LOWER_LIMIT),
        (Flags::HOME_SWITCH, Status::HOME_SWITCH),
        (Flags::INDEX, Status::INDEX),
        (Flags::POWER_STAGE_FAULT, Status::POWER_STAGE_FAULT),
        (Flags::OVERCURRENT, Status::OVERCURRENT),
        (Flags::ERROR, Status::ERROR),
        (Flags::SYNCHRONIZED, Status::SYNCHRONIZED),
    ];
    let set = bits.into_iter().filter(|(flag, _)| answer.flags.any(*flag));
    Answer {
        position: Increments(answer.position),
        current: Some(Milliamperes(answer.current)),
        status: Some(Status(set.fold(0, |status, (_, bit)| status | bit))),
    }
}

/// Address of the drive that answered `bytes` to a request in `protocol`; `None` if `bytes` are no answer.
pub(super) fn speaks(protocol: Protocol, bytes: &[u8]) -> Option<u8> {
    match protocol {
        Protocol::Nfv2 => {
            bytes.windows(NFV2_ANSWER).filter_map(Frame::parse).find_map(|frame| items(frame).map(|_| frame.address))
        }
        Protocol::HiMoxa => (bytes.len() == hi_moxa::ANSWER).then_some(0),
    }
}
