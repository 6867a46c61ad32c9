//! Frames of maxon's EPOS4 on USB and RS-232: byte-stuffed frames, and one answer for each request.
//!
//! ```text
//! 90 02 | opcode  len  words…  crc      every 0x90 after 02 is doubled; len: number of data words
//! ```
//!
//! Words are sent low byte first. The CRC is computed before byte stuffing, over len and opcode and then over each data
//! word with its high byte first. An answer has opcode 0x00. Its first two words are an error code as of an SDO abort,
//! zero for none (EPOS4 Communication Guide 2019-11, §2). The host sends nothing before the answer has arrived or the
//! frame time-out has passed (objects 0x2005 RS-232, 0x2006 USB).
//!
//! The payload of a request that names an object begins with the node, followed by index and sub-index. EPOS2 uses
//! another order. Layouts only: [`Frame`] and [`Deframer`] for any service, [`Request`] and [`Answer`] for the services
//! of the object dictionary and NMT. Not implemented: LSS, and CAN frames through the gateway.

mod frame;
#[cfg(test)]
pub(crate) mod tests;

pub use frame::{Deframer, Frame, FrameError};

use std::time::Duration;

/// First two bytes of a frame. Within the data, the first one is doubled.
const DLE: u8 = 0x90;
const STX: u8 = 0x02;

/// Opcode of every answer.
pub const ANSWER: u8 = 0x00;

/// Maximum number of data words of a frame.
pub const MAX_WORDS: usize = 143;

/// Maximum length of a frame on the line, bytes.
pub const LONGEST: usize = 2 + 2 * (2 + 2 * MAX_WORDS + 2);

/// Maximum number of bytes of an object in one segment.
pub const MAX_SEGMENT: usize = 254;

/// Factory setting of the frame time-out (objects 0x2005, 0x2006).
pub const TIME_OUT: Duration = Duration::from_millis(500);

/// An object of a node; node 0 is the device on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address {
    /// Node-ID.
    pub node: u8,
    /// Index of the object.
    pub index: u16,
    /// Sub-index of the object.
    pub subindex: u8,
}

impl Address {
    fn encode(self) -> [u8; 4] {
        let [low, high] = self.index.to_le_bytes();
        [self.node, low, high, self.subindex]
    }

    fn decode([node, low, high, subindex]: [u8; 4]) -> Self {
        Self { node, index: u16::from_le_bytes([low, high]), subindex }
    }
}

/// Request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Request<'a> {
    /// Reads an object of up to four bytes: [`Answer::Value`].
    Read(Address),
    /// Writes an object of up to four bytes, given by the low bytes of the value: [`Answer::Done`].
    Write(Address, u32),
    /// Starts to read an object in segments: [`Answer::Started`].
    InitiateSegmentedRead(Address),
    /// Reads the next segment: [`Answer::Segment`]. `toggle` alternates from segment to segment, starting with `false`.
    SegmentRead { toggle: bool },
    /// Starts to write an object of this length, bytes, in segments: [`Answer::Done`].
    InitiateSegmentedWrite(Address, u32),
    /// Writes the next segment of up to [`MAX_SEGMENT`] bytes: [`Answer::Taken`]. `toggle` alternates from segment to
    /// segment, starting with `false`; `last` completes the object.
    SegmentWrite { toggle: bool, last: bool, data: &'a [u8] },
    /// Sends an NMT command specifier (CiA 301 §7.2.8.3.1) to a node, 0 for all nodes: [`Answer::Done`].
    Nmt { node: u16, command: u16 },
}

const TOGGLE: u8 = 0x01;
const LAST: u8 = 0x02;

const fn control(toggle: bool, last: bool) -> u8 {
    (if toggle { TOGGLE } else { 0 }) | (if last { LAST } else { 0 })
}

impl<'a> Request<'a> {
    /// The request as a frame. A segment is cut after [`MAX_SEGMENT`] bytes.
    pub fn encode(self) -> Frame {
        match self {
            Self::Read(address) => Frame::of(0x60, &[&address.encode()]),
            Self::Write(address, value) => Frame::of(0x68, &[&address.encode(), &value.to_le_bytes()]),
            Self::InitiateSegmentedRead(address) => Frame::of(0x81, &[&address.encode()]),
            Self::SegmentRead { toggle } => Frame::of(0x62, &[&[control(toggle, false), 0]]),
            Self::InitiateSegmentedWrite(address, length) => {
                Frame::of(0x69, &[&address.encode(), &length.to_le_bytes()])
            }
            Self::SegmentWrite { toggle, last, data } => {
                let data = &data[..data.len().min(MAX_SEGMENT)];
                Frame::of(0x6A, &[&[data.len() as u8, control(toggle, last)], data])
            }
            Self::Nmt { node, command } => Frame::of(0x70, &[&node.to_le_bytes(), &command.to_le_bytes()]),
        }
    }

    /// Decodes a request; `None` for an unknown opcode or a wrong length.
    pub fn decode(frame: &'a Frame) -> Option<Self> {
        Some(match (frame.opcode(), frame.data()) {
            (0x60, &[a, b, c, d]) => Self::Read(Address::decode([a, b, c, d])),
            (0x68, &[a, b, c, d, e, f, g, h]) => {
                Self::Write(Address::decode([a, b, c, d]), u32::from_le_bytes([e, f, g, h]))
            }
            (0x81, &[a, b, c, d]) => Self::InitiateSegmentedRead(Address::decode([a, b, c, d])),
            (0x62, &[control, _]) => Self::SegmentRead { toggle: control & TOGGLE != 0 },
            (0x69, &[a, b, c, d, e, f, g, h]) => {
                Self::InitiateSegmentedWrite(Address::decode([a, b, c, d]), u32::from_le_bytes([e, f, g, h]))
            }
            (0x6A, [length, control, rest @ ..]) => Self::SegmentWrite {
                toggle: control & TOGGLE != 0,
                last: control & LAST != 0,
                data: unpadded(*length, rest)?,
            },
            (0x70, &[n0, n1, c0, c1]) => {
                Self::Nmt { node: u16::from_le_bytes([n0, n1]), command: u16::from_le_bytes([c0, c1]) }
            }
            _ => return None,
        })
    }
}

/// The first `length` bytes of `data`; `None` if `data` is shorter, or longer by more than one byte of padding.
fn unpadded(length: u8, data: &[u8]) -> Option<&[u8]> {
    let length = usize::from(length);
    (data.len() == length || data.len() == length + 1).then(|| &data[..length])
}

/// Answer of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Answer<'a> {
    /// The value read. Bytes beyond the length of the object are zero.
    Value(u32),
    /// The request was performed.
    Done,
    /// Length of the object, bytes, and its first segment.
    Started(u32, &'a [u8]),
    /// A further segment, with the toggle bit of the request; `last` completes the object.
    Segment { toggle: bool, last: bool, data: &'a [u8] },
    /// This many bytes of a segment were accepted. `toggle` is that of the request.
    Taken { toggle: bool, length: u8 },
    /// The request was refused with the code of an SDO abort or a code of maxon, 0x0F00_FFxx. The code is not 0.
    Refused(u32),
}

impl<'a> Answer<'a> {
    /// The answer as a frame. Data are cut after [`MAX_SEGMENT`] bytes.
    pub fn encode(self) -> Frame {
        let cut = |data: &'a [u8]| &data[..data.len().min(MAX_SEGMENT)];
        let okay = &[0; 4];
        match self {
            Self::Value(value) => Frame::of(ANSWER, &[okay, &value.to_le_bytes()]),
            Self::Done => Frame::of(ANSWER, &[okay]),
            Self::Started(length, data) => {
                let data = cut(data);
                let count = [data.len() as u8];
                Frame::of(ANSWER, &[okay, &length.to_le_bytes(), &count, data])
            }
            Self::Segment { toggle, last, data } => {
                let data = cut(data);
                let head = [data.len() as u8, control(toggle, last)];
                Frame::of(ANSWER, &[okay, &head, data])
            }
            Self::Taken { toggle, length } => Frame::of(ANSWER, &[okay, &[length, control(toggle, false)]]),
            Self::Refused(code) => Frame::of(ANSWER, &[&code.to_le_bytes()]),
        }
    }

    /// Decodes the answer to request `to`; `None` if the frame does not fit the request.
    ///
    /// A refusal may contain further data after its code.
    pub fn decode(frame: &'a Frame, to: &Request) -> Option<Self> {
        let [a, b, c, d, ref rest @ ..] = *frame.data() else {
            return None;
        };
        let code = u32::from_le_bytes([a, b, c, d]);
        if frame.opcode() != ANSWER {
            return None;
        }
        if code != 0 {
            return Some(Self::Refused(code));
        }
        Some(match (to, rest) {
            (Request::Read(_), &[a, b, c, d]) => Self::Value(u32::from_le_bytes([a, b, c, d])),
            (Request::Write(..) | Request::InitiateSegmentedWrite(..) | Request::Nmt { .. }, []) => Self::Done,
            (Request::InitiateSegmentedRead(_), [a, b, c, d, length, rest @ ..]) => {
                Self::Started(u32::from_le_bytes([*a, *b, *c, *d]), unpadded(*length, rest)?)
            }
            (Request::SegmentRead { .. }, [length, control, rest @ ..]) => Self::Segment {
                toggle: control & TOGGLE != 0,
                last: control & LAST != 0,
                data: unpadded(*length, rest)?,
            },
            (Request::SegmentWrite { .. }, &[length, control]) => Self::Taken { toggle: control & TOGGLE != 0, length },
            _ => return None,
        })
    }
}
