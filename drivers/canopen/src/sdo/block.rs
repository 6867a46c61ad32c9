//! The frames of SDO block transfer (CiA 301 §7.2.4.3.8 to §7.2.4.3.16).
//!
//! The data go in sub-blocks of up to 127 [`Segment`]s. The receiver acknowledges each sub-block, and a checksum ends the
//! transfer. The frames of the data's sender and receiver are the same in both directions:
//!
//! ```text
//!   download   client                                server
//!              InitiateDownload ───────────────────►
//!              ◄─────────────────── InitiateDownload (block size)
//!              Segment 1 ..= block size ───────────►
//!              ◄─────────────────── Acknowledge (last in order, next block size)
//!              EndDownload (checksum) ─────────────►
//!              ◄─────────────────── EndDownload
//!
//!   upload     InitiateUpload (block size) ────────►
//!              ◄─────────────────── InitiateUpload (of an ordinary upload, if short)
//!              StartUpload ────────────────────────►
//!              ◄─────────────────── Segment 1 ..= block size
//!              Acknowledge ────────────────────────►
//!              ◄─────────────────── EndUpload (checksum)
//!              EndUpload ──────────────────────────►
//! ```
//!
//! The first byte of a segment has any value but 0x00 and 0x80. The bytes of a segment therefore do not differ from those of
//! other requests and responses. The receiver of a sub-block tries [`Segment::decode`]; an abort (0x80) is the only
//! other frame there. In all other states the frame is a [`super::Request`] or [`super::Response`].

use can::{Frame, StandardId};
use crc::{CRC_16_XMODEM, Crc};

use super::layout::{addressed, object};
use crate::{Object, frame, payload};

/// The most segments of a sub-block. A block size outside 1 ..= this is refused with
/// [`AbortCode::BLOCK_SIZE`](super::AbortCode::BLOCK_SIZE).
pub const MAX_BLOCK_SIZE: u8 = 127;

/// The bytes of a segment.
pub const SEGMENT: usize = 7;

/// A request of the client in [`super::Request::Block`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Request {
    /// Begin to write an object of `size` bytes, if the client gives its size. `crc`: the client can make the checksum.
    InitiateDownload { object: Object, crc: bool, size: Option<u32> },
    /// All segments were acknowledged.
    EndDownload(End),
    /// Read an object, with `block_size` segments in the first sub-block. `crc`: the client can check the checksum. A
    /// server may answer an object of `threshold` bytes or less as an ordinary upload; 0 forbids that.
    InitiateUpload { object: Object, crc: bool, block_size: u8, threshold: u8 },
    /// Send the first sub-block.
    StartUpload,
    /// A sub-block of an upload came to its end.
    Acknowledge(Acknowledge),
    /// The upload is complete.
    EndUpload,
}

/// An answer of the server in [`super::Response::Block`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Response {
    /// Send the first sub-block, of `block_size` segments. `crc`: the server can check the checksum.
    InitiateDownload { object: Object, crc: bool, block_size: u8 },
    /// A sub-block of a download came to its end.
    Acknowledge(Acknowledge),
    /// The download is complete.
    EndDownload,
    /// The upload may start. `crc`: the server can make the checksum. `size`: number of bytes, if the server gives it.
    InitiateUpload { object: Object, crc: bool, size: Option<u32> },
    /// All segments were acknowledged.
    EndUpload(End),
}

/// Acknowledgement of a sub-block by its receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Acknowledge {
    /// The last segment that came in order, or 0. The segments after it are sent again.
    pub sequence: u8,
    /// Segments of the next sub-block.
    pub block_size: u8,
}

/// End of a block transfer by the sender of the data, after the last acknowledgement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct End {
    unused: u8,
    /// The [`checksum`] of all data if both sides support it, else 0.
    pub crc: u16,
}

impl End {
    /// The end of `size` bytes. No bytes at all travel as one segment that is all unused.
    pub const fn of(size: usize, crc: u16) -> Self {
        let used = size % SEGMENT;
        let unused = if size > 0 && used == 0 { 0 } else { (SEGMENT - used) as u8 };
        Self { unused, crc }
    }

    /// Unused bytes of the last segment, 0 ..= 7.
    pub const fn unused(self) -> usize {
        self.unused as usize
    }

    fn encode(self) -> [u8; 8] {
        let [low, high] = self.crc.to_le_bytes();
        [0xC1 | self.unused << 2, low, high, 0, 0, 0, 0, 0]
    }

    fn decode(bytes: [u8; 8]) -> Self {
        Self { unused: bytes[0] >> 2 & 0b111, crc: u16::from_le_bytes([bytes[1], bytes[2]]) }
    }
}

/// Seven bytes of a sub-block, under [`crate::cob::sdo_request`] or [`crate::cob::sdo_response`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    sequence: u8,
    /// Whether no segment follows, in this sub-block or another.
    pub last: bool,
    /// The data; of the last segment [`End::unused`] bytes are to be dropped.
    pub data: [u8; SEGMENT],
}

impl Segment {
    /// `None` for a sequence number outside 1 ..= 127.
    pub const fn new(sequence: u8, last: bool, data: [u8; SEGMENT]) -> Option<Self> {
        match sequence {
            1..=MAX_BLOCK_SIZE => Some(Self { sequence, last, data }),
            _ => None,
        }
    }

    /// Its number in its sub-block, 1 ..= 127.
    pub const fn sequence(self) -> u8 {
        self.sequence
    }

    /// The frame sent under `id`.
    pub fn encode(self, id: StandardId) -> Frame {
        let [a, b, c, d, e, f, g] = self.data;
        let first = u8::from(self.last) << 7 | self.sequence;
        frame(id, [first, a, b, c, d, e, f, g])
    }

    /// A frame within a sub-block. `None` for an abort, for sequence number 0, and for frames under another identifier or
    /// of another length.
    pub fn decode(frame: &Frame, id: StandardId) -> Option<Self> {
        let [first, data @ ..] = <[u8; 8]>::try_from(payload(frame, id)?).ok()?;
        Self::new(first & 0x7F, first & 0x80 != 0, data)
    }
}

/// The checksum of the data of a block transfer, unused bytes left out: CRC-16/XMODEM (CiA 301 §7.2.4.3.16).
pub fn checksum(data: &[u8]) -> u16 {
    static TABLE: Crc<u16> = Crc::<u16>::new(&CRC_16_XMODEM);
    TABLE.checksum(data)
}

impl Request {
    pub(super) fn encode(self) -> [u8; 8] {
        match self {
            Self::InitiateDownload { object, crc, size } => initiate(object, crc, size),
            Self::EndDownload(end) => end.encode(),
            Self::InitiateUpload { object, crc, block_size, threshold } => {
                addressed(0xA0 | crc_bit(crc), object, [block_size, threshold, 0, 0])
            }
            Self::StartUpload => [0xA3, 0, 0, 0, 0, 0, 0, 0],
            Self::Acknowledge(acknowledge) => acknowledge.encode(),
            Self::EndUpload => [0xA1, 0, 0, 0, 0, 0, 0, 0],
        }
    }

    /// `None` for a command specifier that is none of block transfer.
    pub(super) fn decode(bytes: [u8; 8]) -> Option<Self> {
        let (object, crc, size) = (object(bytes), has_crc(bytes), size(bytes));
        Some(match bytes[0] {
            0xA0 | 0xA4 => Self::InitiateUpload { object, crc, block_size: bytes[4], threshold: bytes[5] },
            0xA1 => Self::EndUpload,
            0xA2 => Self::Acknowledge(Acknowledge::decode(bytes)),
            0xA3 => Self::StartUpload,
            0xC0 | 0xC2 | 0xC4 | 0xC6 => Self::InitiateDownload { object, crc, size },
            first if is_end(first) => Self::EndDownload(End::decode(bytes)),
            _ => return None,
        })
    }
}

impl Response {
    pub(super) fn encode(self) -> [u8; 8] {
        match self {
            Self::InitiateDownload { object, crc, block_size } => {
                addressed(0xA0 | crc_bit(crc), object, [block_size, 0, 0, 0])
            }
            Self::Acknowledge(acknowledge) => acknowledge.encode(),
            Self::EndDownload => [0xA1, 0, 0, 0, 0, 0, 0, 0],
            Self::InitiateUpload { object, crc, size } => initiate(object, crc, size),
            Self::EndUpload(end) => end.encode(),
        }
    }

    /// `None` for a command specifier that is none of block transfer.
    pub(super) fn decode(bytes: [u8; 8]) -> Option<Self> {
        let (object, crc, size) = (object(bytes), has_crc(bytes), size(bytes));
        Some(match bytes[0] {
            0xA0 | 0xA4 => Self::InitiateDownload { object, crc, block_size: bytes[4] },
            0xA1 => Self::EndDownload,
            0xA2 => Self::Acknowledge(Acknowledge::decode(bytes)),
            0xC0 | 0xC2 | 0xC4 | 0xC6 => Self::InitiateUpload { object, crc, size },
            first if is_end(first) => Self::EndUpload(End::decode(bytes)),
            _ => return None,
        })
    }
}

impl Acknowledge {
    fn encode(self) -> [u8; 8] {
        [0xA2, self.sequence, self.block_size, 0, 0, 0, 0, 0]
    }

    fn decode(bytes: [u8; 8]) -> Self {
        Self { sequence: bytes[1], block_size: bytes[2] }
    }
}

const SIZE_GIVEN: u8 = 0b10;
const CRC_SUPPORTED: u8 = 0b100;

/// The first frame of the side that has the data.
fn initiate(object: Object, crc: bool, size: Option<u32>) -> [u8; 8] {
    let given = if size.is_some() { SIZE_GIVEN } else { 0 };
    let size = size.unwrap_or(0).to_le_bytes();
    addressed(0xC0 | crc_bit(crc) | given, object, size)
}

fn size(bytes: [u8; 8]) -> Option<u32> {
    let [first, _, _, _, size @ ..] = bytes;
    (first & SIZE_GIVEN != 0).then_some(u32::from_le_bytes(size))
}

/// `110n nn01`.
fn is_end(first: u8) -> bool {
    first & 0b1110_0011 == 0xC1
}

fn crc_bit(crc: bool) -> u8 {
    if crc { CRC_SUPPORTED } else { 0 }
}

fn has_crc(bytes: [u8; 8]) -> bool {
    bytes[0] & CRC_SUPPORTED != 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::DEVICE_NAME;
    use crate::parse;
    use crate::{NodeId, cob, sdo};

    const NODE: NodeId = NodeId::new(2).unwrap();
    const ACKNOWLEDGE: Acknowledge = Acknowledge { sequence: 126, block_size: 4 };

    fn end(unused: u8) -> End {
        End { unused, crc: 0x31C3 }
    }

    fn download(crc: bool, size: Option<u32>) -> Request {
        Request::InitiateDownload { object: DEVICE_NAME, crc, size }
    }

    fn upload(crc: bool, block_size: u8, threshold: u8) -> Request {
        Request::InitiateUpload { object: DEVICE_NAME, crc, block_size, threshold }
    }

    #[test]
    fn requests_are_these_bytes() {
        let table = [
            (download(true, Some(0x0001_0203)), "602#C608100003020100"),
            (download(false, Some(9)), "602#C208100009000000"),
            (download(true, None), "602#C408100000000000"),
            (download(false, None), "602#C008100000000000"),
            (Request::EndDownload(end(0)), "602#C1C3310000000000"),
            (Request::EndDownload(end(5)), "602#D5C3310000000000"),
            (Request::EndDownload(end(7)), "602#DDC3310000000000"),
            (upload(true, 127, 0), "602#A40810007F000000"),
            (upload(false, 1, 255), "602#A008100001FF0000"),
            (Request::StartUpload, "602#A300000000000000"),
            (Request::Acknowledge(ACKNOWLEDGE), "602#A27E040000000000"),
            (Request::EndUpload, "602#A100000000000000"),
        ];
        for (request, bytes) in table {
            let request = sdo::Request::Block(request);
            assert_eq!(request.encode(NODE).to_string(), bytes);
            assert_eq!(sdo::Request::decode(&parse(bytes), NODE), Some(request));
        }
    }

    #[test]
    fn responses_are_these_bytes() {
        let initiated = |crc, block_size| Response::InitiateDownload { object: DEVICE_NAME, crc, block_size };
        let upload = |crc, size| Response::InitiateUpload { object: DEVICE_NAME, crc, size };
        let table = [
            (initiated(true, 127), "582#A40810007F000000"),
            (initiated(false, 4), "582#A008100004000000"),
            (Response::Acknowledge(ACKNOWLEDGE), "582#A27E040000000000"),
            (Response::EndDownload, "582#A100000000000000"),
            (upload(true, Some(0x0001_0203)), "582#C608100003020100"),
            (upload(false, Some(9)), "582#C208100009000000"),
            (upload(true, None), "582#C408100000000000"),
            (upload(false, None), "582#C008100000000000"),
            (Response::EndUpload(end(6)), "582#D9C3310000000000"),
        ];
        for (response, bytes) in table {
            let response = sdo::Response::Block(response);
            assert_eq!(response.encode(NODE).to_string(), bytes);
            assert_eq!(sdo::Response::decode(&parse(bytes), NODE), Some(response));
        }
    }

    #[test]
    fn segments_are_a_number_and_seven_bytes_in_both_directions() {
        let data = [1, 2, 3, 4, 5, 6, 7];
        let table = [
            (1, false, "0101020304050607"),
            (127, false, "7F01020304050607"),
            (1, true, "8101020304050607"),
            (127, true, "FF01020304050607"),
        ];
        for id in [cob::sdo_request(NODE), cob::sdo_response(NODE)] {
            for (sequence, last, bytes) in table {
                let segment = Segment::new(sequence, last, data).unwrap();
                let text = format!("{:03X}#{bytes}", id.raw());
                assert_eq!(segment.encode(id).to_string(), text);
                assert_eq!(Segment::decode(&parse(&text), id), Some(segment));
            }
        }
        assert_eq!(Segment::new(0, false, data), None);
        assert_eq!(Segment::new(128, false, data), None);
    }

    #[test]
    fn no_abort_is_a_segment_though_every_other_request_could_be() {
        let abort = sdo::Request::Abort { object: DEVICE_NAME, code: sdo::AbortCode::CRC };
        let id = cob::sdo_request(NODE);
        assert_eq!(Segment::decode(&abort.encode(NODE), id), None);
        assert_eq!(Segment::decode(&parse("602#0001020304050607"), id), None);
        for request in [download(true, None), Request::StartUpload, Request::EndUpload] {
            let frame = sdo::Request::Block(request).encode(NODE);
            assert!(Segment::decode(&frame, id).is_some());
        }
    }

    #[test]
    fn other_specifiers_lengths_and_identifiers_are_refused() {
        for first in (0..=0x9F).chain(0xA5..=0xBF).chain(0xE0..=0xFF) {
            let bytes = [first, 0x08, 0x10, 0, 1, 0, 0, 0];
            assert_eq!(Request::decode(bytes), None, "{first:#04x}");
            assert_eq!(Response::decode(bytes), None, "{first:#04x}");
        }
        assert_eq!(Response::decode([0xA3, 0, 0, 0, 0, 0, 0, 0]), None);
        for text in ["602#A1000000000000", "603#A100000000000000", "602#"] {
            let frame = parse(text);
            assert_eq!(sdo::Request::decode(&frame, NODE), None, "{text}");
            assert_eq!(Segment::decode(&frame, cob::sdo_request(NODE)), None);
        }
    }

    #[test]
    fn bits_and_bytes_that_are_not_used_are_ignored() {
        let bytes = [0xD5, 0xC3, 0x31, 0xAA, 0x55, 0xAA, 0x55, 0xAA];
        assert_eq!(Request::decode(bytes), Some(Request::EndDownload(end(5))));
        let bytes = [0xC0, 0x08, 0x10, 0, 9, 0, 0, 0];
        let Some(Response::InitiateUpload { size, .. }) = Response::decode(bytes) else {
            panic!("it begins an upload");
        };
        assert_eq!(size, None);
    }

    #[test]
    fn the_last_segment_is_filled_up_with_unused_bytes() {
        let table = [(0, 7), (1, 6), (6, 1), (7, 0), (8, 6), (889, 0), (890, 6)];
        for (size, unused) in table {
            assert_eq!(End::of(size, 0).unused(), unused, "{size} bytes");
        }
    }

    #[test]
    fn the_checksum_is_crc_16_xmodem() {
        let table: [(&[u8], u16); 3] = [(b"123456789", 0x31C3), (b"", 0), (b"A", 0x58E5)];
        for (data, crc) in table {
            assert_eq!(checksum(data), crc);
        }
    }
}
