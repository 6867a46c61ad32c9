//! What maxon's EPOS4 speaks on USB and RS-232: stuffed frames, one answer for each request.
//!
//! ```text
//! 90 02 | opcode  len  words…  crc      every 0x90 behind 02 doubled; len: data words
//! ```
//!
//! Words go low byte first. The CRC covers len, opcode, and of each data word the high byte first, before
//! stuffing. An answer has opcode 0x00, and its first two words are an error code as of an SDO abort,
//! zero for none (EPOS4 Communication Guide 2019-11, §2). The host sends nothing before the answer has come
//! or the frame time-out has passed (objects 0x2005 RS-232, 0x2006 USB).
//!
//! A request whose payload names an object begins with the node, then index and sub-index: another order
//! than EPOS2's. Layouts only: [`Frame`] and [`Deframer`] for any service, [`Request`] and [`Answer`] for
//! those on the object dictionary and NMT. Left out: LSS and CAN frames through the gateway.

mod frame;

pub use frame::{Deframer, Frame, FrameError};

use std::time::Duration;

/// First byte of a frame, doubled where it is data.
const DLE: u8 = 0x90;

/// Second byte of a frame.
const STX: u8 = 0x02;

/// Opcode of every answer.
pub const ANSWER: u8 = 0x00;

/// The most data words of a frame.
pub const MAX_WORDS: usize = 143;

/// The most bytes a frame has on the line.
pub const LONGEST: usize = 2 + 2 * (2 + 2 * MAX_WORDS + 2);

/// The most bytes of an object in one segment.
pub const MAX_SEGMENT: usize = 254;

/// The frame time-out as delivered (objects 0x2005, 0x2006).
pub const TIME_OUT: Duration = Duration::from_millis(500);

/// An object of a node; node 0 is the device on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address {
    /// Node-ID.
    pub node: u8,
    /// Of the object.
    pub index: u16,
    /// Of the object.
    pub subindex: u8,
}

impl Address {
    fn encode(self) -> [u8; 4] {
        let [low, high] = self.index.to_le_bytes();
        [self.node, low, high, self.subindex]
    }

    fn decode([node, low, high, subindex]: [u8; 4]) -> Self {
        Self {
            node,
            index: u16::from_le_bytes([low, high]),
            subindex,
        }
    }
}

/// What the host asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request<'a> {
    /// Reads an object of up to four bytes: [`Answer::Value`].
    Read(Address),
    /// Writes an object of up to four bytes, which are the low ones: [`Answer::Done`].
    Write(Address, u32),
    /// Begins to read an object in segments: [`Answer::Started`].
    InitiateSegmentedRead(Address),
    /// Reads the next segment: [`Answer::Segment`].
    SegmentRead {
        /// Alternates, `false` in the first after the initiation.
        toggle: bool,
    },
    /// Begins to write an object of so many bytes in segments: [`Answer::Done`].
    InitiateSegmentedWrite(Address, u32),
    /// Writes the next segment of up to [`MAX_SEGMENT`] bytes: [`Answer::Taken`].
    SegmentWrite {
        /// Alternates, `false` in the first after the initiation.
        toggle: bool,
        /// Whether the object is complete with it.
        last: bool,
        /// The segment.
        data: &'a [u8],
    },
    /// Sends an NMT command: [`Answer::Done`].
    Nmt {
        /// Node-ID, 0 for all.
        node: u16,
        /// Command specifier (CiA 301 §7.2.8.2.1).
        command: u16,
    },
}

const TOGGLE: u8 = 0x01;
const LAST: u8 = 0x02;

const fn control(toggle: bool, last: bool) -> u8 {
    (if toggle { TOGGLE } else { 0 }) | (if last { LAST } else { 0 })
}

impl<'a> Request<'a> {
    /// The request as a frame; of a segment that is too long the first [`MAX_SEGMENT`] bytes.
    pub fn encode(self) -> Frame {
        match self {
            Self::Read(address) => Frame::of(0x60, &[&address.encode()]),
            Self::Write(address, value) => {
                Frame::of(0x68, &[&address.encode(), &value.to_le_bytes()])
            }
            Self::InitiateSegmentedRead(address) => Frame::of(0x81, &[&address.encode()]),
            Self::SegmentRead { toggle } => Frame::of(0x62, &[&[control(toggle, false), 0]]),
            Self::InitiateSegmentedWrite(address, length) => {
                Frame::of(0x69, &[&address.encode(), &length.to_le_bytes()])
            }
            Self::SegmentWrite { toggle, last, data } => {
                let data = &data[..data.len().min(MAX_SEGMENT)];
                Frame::of(0x6A, &[&[data.len() as u8, control(toggle, last)], data])
            }
            Self::Nmt { node, command } => {
                Frame::of(0x70, &[&node.to_le_bytes(), &command.to_le_bytes()])
            }
        }
    }

    /// What a device understands; `None` for an opcode it does not know or another length.
    pub fn decode(frame: &'a Frame) -> Option<Self> {
        Some(match (frame.opcode(), frame.data()) {
            (0x60, &[a, b, c, d]) => Self::Read(Address::decode([a, b, c, d])),
            (0x68, &[a, b, c, d, e, f, g, h]) => Self::Write(
                Address::decode([a, b, c, d]),
                u32::from_le_bytes([e, f, g, h]),
            ),
            (0x81, &[a, b, c, d]) => Self::InitiateSegmentedRead(Address::decode([a, b, c, d])),
            (0x62, &[control, _]) => Self::SegmentRead {
                toggle: control & TOGGLE != 0,
            },
            (0x69, &[a, b, c, d, e, f, g, h]) => Self::InitiateSegmentedWrite(
                Address::decode([a, b, c, d]),
                u32::from_le_bytes([e, f, g, h]),
            ),
            (0x6A, [length, control, rest @ ..]) => Self::SegmentWrite {
                toggle: control & TOGGLE != 0,
                last: control & LAST != 0,
                data: unpadded(*length, rest)?,
            },
            (0x70, &[n0, n1, c0, c1]) => Self::Nmt {
                node: u16::from_le_bytes([n0, n1]),
                command: u16::from_le_bytes([c0, c1]),
            },
            _ => return None,
        })
    }
}

/// The bytes that `length` claims, if they and at most a byte of padding are there.
fn unpadded(length: u8, data: &[u8]) -> Option<&[u8]> {
    let length = usize::from(length);
    (data.len() == length || data.len() == length + 1).then(|| &data[..length])
}

/// What a device answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer<'a> {
    /// The value read; what is longer than the object is zero.
    Value(u32),
    /// It is done.
    Done,
    /// An object of so many bytes begins with these.
    Started(u32, &'a [u8]),
    /// More of it.
    Segment {
        /// As in the request.
        toggle: bool,
        /// Whether the object is complete with it.
        last: bool,
        /// The segment.
        data: &'a [u8],
    },
    /// So many bytes of a segment were taken.
    Taken {
        /// As in the request.
        toggle: bool,
        /// Bytes.
        length: u8,
    },
    /// Refused, with the code of an SDO abort or one of maxon's own 0x0F00_FFxx; not 0.
    Refused(u32),
}

impl<'a> Answer<'a> {
    /// The answer as a frame; of data that are too long the first [`MAX_SEGMENT`] bytes.
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
            Self::Taken { toggle, length } => {
                Frame::of(ANSWER, &[okay, &[length, control(toggle, false)]])
            }
            Self::Refused(code) => Frame::of(ANSWER, &[&code.to_le_bytes()]),
        }
    }

    /// What a host takes from the answer to its request; `None` if it is no answer to that.
    ///
    /// A refusal may have anything behind its code.
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
            (
                Request::Write(..) | Request::InitiateSegmentedWrite(..) | Request::Nmt { .. },
                [],
            ) => Self::Done,
            (Request::InitiateSegmentedRead(_), [a, b, c, d, length, rest @ ..]) => Self::Started(
                u32::from_le_bytes([*a, *b, *c, *d]),
                unpadded(*length, rest)?,
            ),
            (Request::SegmentRead { .. }, [length, control, rest @ ..]) => Self::Segment {
                toggle: control & TOGGLE != 0,
                last: control & LAST != 0,
                data: unpadded(*length, rest)?,
            },
            (Request::SegmentWrite { .. }, &[length, control]) => Self::Taken {
                toggle: control & TOGGLE != 0,
                length,
            },
            _ => return None,
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    pub(crate) use super::frame::tests::encoded;
    use super::frame::tests::frames;
    use super::*;

    pub(crate) const STATUSWORD: Address = Address {
        node: 1,
        index: 0x6041,
        subindex: 0,
    };
    pub(crate) const HOME_POSITION: Address = Address {
        index: 0x30B0,
        ..STATUSWORD
    };
    pub(crate) const CONTROLWORD: Address = Address {
        index: 0x6040,
        ..STATUSWORD
    };
    pub(crate) const NAME: Address = Address {
        index: 0x1008,
        ..STATUSWORD
    };

    #[test]
    fn requests_are_the_bytes_of_the_line() {
        let cases: [(Request, &[u8]); 3] = [
            (
                Request::Read(HOME_POSITION),
                &[0x90, 0x02, 0x60, 0x02, 0x01, 0xB0, 0x30, 0x00, 0x2E, 0x62],
            ),
            (
                Request::Read(STATUSWORD),
                &[0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1],
            ),
            (
                Request::Write(CONTROLWORD, 0x000F),
                &[
                    0x90, 0x02, 0x68, 0x04, 0x01, 0x40, 0x60, 0x00, 0x0F, 0x00, 0x00, 0x00, 0xB3,
                    0x07,
                ],
            ),
        ];
        for (request, bytes) in cases {
            assert_eq!(encoded(&request.encode()), bytes, "{request:?}");
        }
    }

    #[test]
    fn answers_are_the_bytes_of_the_line() {
        let cases: [(Request, Answer, &[u8]); 2] = [
            (
                Request::Read(HOME_POSITION),
                Answer::Value(0x0000_9001),
                &[
                    0x90, 0x02, 0x00, 0x04, 0x00, 0x00, 0x00, 0x00, 0x01, 0x90, 0x90, 0x00, 0x00,
                    0x9A, 0x5C,
                ],
            ),
            (
                Request::Write(CONTROLWORD, 0x000F),
                Answer::Done,
                &[0x90, 0x02, 0x00, 0x02, 0x00, 0x00, 0x00, 0x00, 0x40, 0x8B],
            ),
        ];
        for (request, answer, bytes) in cases {
            assert_eq!(encoded(&answer.encode()), bytes, "{answer:?}");
            let frame = frames(bytes).remove(0).unwrap();
            assert_eq!(Answer::decode(&frame, &request), Some(answer));
        }
    }

    #[test]
    fn every_service_survives_the_line_both_ways() {
        let object: Vec<u8> = (0..=253).collect();
        let odd = &object[..41];
        let pairs = [
            (Request::Read(NAME), Answer::Value(u32::MAX)),
            (Request::Write(NAME, 0x9090_9090), Answer::Done),
            (
                Request::InitiateSegmentedRead(NAME),
                Answer::Started(300, &object),
            ),
            (
                Request::InitiateSegmentedRead(NAME),
                Answer::Started(41, odd),
            ),
            (
                Request::SegmentRead { toggle: true },
                Answer::Segment {
                    toggle: true,
                    last: true,
                    data: odd,
                },
            ),
            (Request::InitiateSegmentedWrite(NAME, 300), Answer::Done),
            (
                Request::SegmentWrite {
                    toggle: false,
                    last: false,
                    data: &object,
                },
                Answer::Taken {
                    toggle: false,
                    length: 254,
                },
            ),
            (
                Request::SegmentWrite {
                    toggle: true,
                    last: true,
                    data: odd,
                },
                Answer::Refused(0x0F00_FFBF),
            ),
            (
                Request::Nmt {
                    node: 0x90,
                    command: 0x81,
                },
                Answer::Done,
            ),
        ];
        for (request, answer) in pairs {
            let there = frames(&encoded(&request.encode())).remove(0).unwrap();
            assert_eq!(Request::decode(&there), Some(request));
            let back = frames(&encoded(&answer.encode())).remove(0).unwrap();
            assert_eq!(Answer::decode(&back, &request), Some(answer), "{request:?}");
        }
    }

    #[test]
    fn what_means_nothing_is_refused() {
        let frame = |opcode, data: &[u8]| Frame::new(opcode, data).unwrap();
        for (opcode, data) in [
            (0x10, &[1, 2, 3, 4][..]),
            (0x60, &[1, 2]),
            (0x6A, &[3, 0, 1, 2]),
            (0x6A, &[1, 0, 1, 2, 3, 4]),
            (0x70, &[]),
        ] {
            assert_eq!(Request::decode(&frame(opcode, data)), None, "{opcode:#x}");
        }
        let read = Request::Read(STATUSWORD);
        for (opcode, data) in [
            (ANSWER, &[0, 0][..]),
            (ANSWER, &[0, 0, 0, 0]),
            (0x60, &[0; 8]),
        ] {
            assert_eq!(Answer::decode(&frame(opcode, data), &read), None);
        }
        let refused = frame(ANSWER, &[0, 0, 2, 6, 9, 9]);
        assert_eq!(
            Answer::decode(&refused, &read),
            Some(Answer::Refused(0x0602_0000))
        );
    }
}
