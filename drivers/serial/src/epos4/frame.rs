//! Frames of an EPOS4 service port.

use super::{DLE, LONGEST, MAX_WORDS, STX};
use crate::epos2;

fn crc(opcode: u8, data: &[u8]) -> u16 {
    epos2::crc([(data.len() / 2) as u8, opcode], data)
}

/// A frame without byte stuffing: an opcode and up to [`MAX_WORDS`] data words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    opcode: u8,
    data: [u8; 2 * MAX_WORDS],
    length: usize,
}

impl Frame {
    /// A frame with these data; `None` if the data are too long. A zero byte fills the last word if necessary.
    pub fn new(opcode: u8, data: &[u8]) -> Option<Self> {
        (data.len() <= 2 * MAX_WORDS).then(|| Self::of(opcode, &[data]))
    }

    pub(super) fn of(opcode: u8, parts: &[&[u8]]) -> Self {
        let mut data = [0; 2 * MAX_WORDS];
        let mut length = 0;
        for part in parts {
            data[length..length + part.len()].copy_from_slice(part);
            length += part.len();
        }
        Self { opcode, data, length: length.next_multiple_of(2) }
    }

    /// Opcode of the request, or [`ANSWER`](super::ANSWER).
    pub fn opcode(&self) -> u8 {
        self.opcode
    }

    /// Data words as bytes, low byte first.
    pub fn data(&self) -> &[u8] {
        &self.data[..self.length]
    }

    /// Writes the frame in wire format to the front of `into`, and returns its length.
    pub fn encode(&self, into: &mut [u8; LONGEST]) -> usize {
        into[..2].copy_from_slice(&[DLE, STX]);
        let mut length = 2;
        let head = [self.opcode, (self.length / 2) as u8];
        let crc = crc(self.opcode, self.data()).to_le_bytes();
        for &byte in head.iter().chain(self.data()).chain(&crc) {
            into[length] = byte;
            length += 1;
            if byte == DLE {
                into[length] = DLE;
                length += 1;
            }
        }
        length
    }
}

/// Reason why received bytes are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// A new frame started inside this frame, or a single 0x90 occurred in it.
    #[error("frame was torn")]
    Torn,
    /// The length exceeds the maximum number of data words.
    #[error("{0} data words are more than a frame has")]
    TooLong(u8),
    /// The CRC was wrong.
    #[error("crc is wrong")]
    Crc,
}

/// Finds frames in a stream of bytes.
///
/// The caller monitors the time. If the frame time-out passes inside a frame, the caller calls
/// [`reset`](Deframer::reset).
#[derive(Clone, Debug)]
pub struct Deframer {
    /// Opcode, length, data and CRC.
    bytes: [u8; 2 + 2 * MAX_WORDS + 2],
    count: usize,
    state: Deframing,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Deframing {
    Outside,
    /// A 0x90 was received outside a frame.
    Starting,
    Inside,
    /// A 0x90 was received inside a frame, and its repetition is due.
    Doubling,
}

impl Default for Deframer {
    fn default() -> Self {
        Self::new()
    }
}

impl Deframer {
    /// A deframer outside any frame.
    pub fn new() -> Self {
        Self { bytes: [0; _], count: 0, state: Deframing::Outside }
    }

    /// Discards the start of a frame.
    pub fn reset(&mut self) {
        self.count = 0;
        self.state = Deframing::Outside;
    }

    /// Processes a byte. Returns the frame that the byte completes.
    pub fn take(&mut self, byte: u8) -> Option<Result<Frame, FrameError>> {
        match (self.state, byte) {
            (Deframing::Outside, DLE) => self.state = Deframing::Starting,
            (Deframing::Outside, _) => {}
            (Deframing::Starting, STX) => self.begin(),
            (Deframing::Starting, DLE) => {}
            (Deframing::Starting, _) => self.reset(),
            (Deframing::Inside, DLE) => self.state = Deframing::Doubling,
            (Deframing::Inside, byte) => return self.add(byte),
            (Deframing::Doubling, DLE) => {
                self.state = Deframing::Inside;
                return self.add(DLE);
            }
            // A start inside a frame: the first frame was torn, and the new frame is received.
            (Deframing::Doubling, STX) => {
                self.begin();
                return Some(Err(FrameError::Torn));
            }
            (Deframing::Doubling, _) => {
                self.reset();
                return Some(Err(FrameError::Torn));
            }
        }
        None
    }

    fn begin(&mut self) {
        self.count = 0;
        self.state = Deframing::Inside;
    }

    fn add(&mut self, byte: u8) -> Option<Result<Frame, FrameError>> {
        self.bytes[self.count] = byte;
        self.count += 1;
        let [opcode, words, ref rest @ ..] = self.bytes;
        if self.count < 2 {
            return None;
        }
        if usize::from(words) > MAX_WORDS {
            self.reset();
            return Some(Err(FrameError::TooLong(words)));
        }
        let length = 2 * usize::from(words);
        if self.count < 2 + length + 2 {
            return None;
        }
        let (data, rest) = rest.split_at(length);
        let right = crc(opcode, data).to_le_bytes() == [rest[0], rest[1]];
        let frame = Frame::of(opcode, &[data]);
        self.reset();
        Some(if right { Ok(frame) } else { Err(FrameError::Crc) })
    }
}
