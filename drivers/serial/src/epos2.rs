//! Telegrams of maxon's EPOS2 on RS-232: sequences of words, in which the receiver acknowledges opcode and CRC by a
//! byte each.
//!
//! ```text
//! host    opcode              len-1  words…  crc            O              O
//! drive           O (ready)                        O  0x00     len-1  words…  crc
//! ```
//!
//! The sender sends an opcode and waits for the ready byte of the receiver. The number of data words less one follows,
//! then the words and a CRC, each low byte first. The receiver acknowledges the CRC. `F` in place of `O` ends the
//! exchange. An answer has opcode 0x00. Its first two words are an error code as of an SDO abort, zero for none.
//! Nothing is sent before the exchange is over or the frame time-out has passed. After an error, both sides wait for
//! the time-out.
//!
//! Layouts only. Not implemented, because no source describes them: segmented transfer (0x12 to 0x15), LSS (0x30, 0x31)
//! and frames through the gateway to CAN (0x20, 0x21). On USB, EPOS2 uses other frames.

use crc::{CRC_16_XMODEM, Crc};

use crate::epos4::Address;

/// Ready acknowledgement and end acknowledgement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Acknowledge {
    /// `O`.
    Okay = b'O',
    /// `F`: not ready, or the CRC was wrong.
    Failed = b'F',
}

impl Acknowledge {
    /// The byte on the line.
    pub const fn byte(self) -> u8 {
        self as u8
    }

    /// Decodes a byte; `None` for any other byte.
    pub const fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            b'O' => Some(Self::Okay),
            b'F' => Some(Self::Failed),
            _ => None,
        }
    }
}

/// Opcode of every answer.
pub const ANSWER: u8 = 0x00;

/// Maximum number of data words that the length byte can declare.
pub const MAX_WORDS: usize = 256;

/// Bytes between ready acknowledgement and end acknowledgement for a telegram of `words` words: the length byte, the
/// words and the CRC.
pub const fn body_length(words: usize) -> usize {
    1 + 2 * words + 2
}

/// CRC-16 with polynomial 0x1021 and initial value 0 over two bytes and data words; the high byte of each word comes
/// first.
pub(crate) fn crc(head: [u8; 2], words: &[u8]) -> u16 {
    static TABLE: Crc<u16> = Crc::<u16>::new(&CRC_16_XMODEM);
    let mut digest = TABLE.digest();
    digest.update(&head);
    let (words, _) = words.as_chunks::<2>();
    words.iter().for_each(|&[low, high]| digest.update(&[high, low]));
    digest.finalize()
}

/// A telegram in wire format, without acknowledgements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Telegram {
    opcode: u8,
    body: [u8; Self::LONGEST],
    length: usize,
}

impl Telegram {
    /// Six data words; the longest layout in this file has four.
    const LONGEST: usize = body_length(6);

    fn new(opcode: u8, data: &[u8]) -> Self {
        debug_assert!(data.len().is_multiple_of(2) && data.len() >= 2);
        let mut body = [0; Self::LONGEST];
        body[0] = (data.len() / 2 - 1) as u8;
        body[1..=data.len()].copy_from_slice(data);
        let crc = crc([opcode, body[0]], data).to_le_bytes();
        body[data.len() + 1..data.len() + 3].copy_from_slice(&crc);
        Self { opcode, body, length: data.len() + 3 }
    }

    /// The opcode, sent before the ready acknowledgement.
    pub fn opcode(&self) -> u8 {
        self.opcode
    }

    /// The bytes sent after the ready acknowledgement.
    pub fn body(&self) -> &[u8] {
        &self.body[..self.length]
    }
}

/// Reason why a telegram cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum Malformed {
    /// The telegram was damaged. [`Acknowledge::Failed`] is the answer to it.
    #[error("crc or length is wrong")]
    Damaged,
    /// The telegram is intact but has no meaning here.
    #[error("opcode {opcode:#04x} with {words} words is not understood")]
    Unknown { opcode: u8, words: usize },
}

/// Data words of an intact telegram. `body` holds the length byte, the words and the CRC.
fn data(opcode: u8, body: &[u8]) -> Result<&[u8], Malformed> {
    if let [count, words @ .., low, high] = body
        && body.len() == body_length(usize::from(*count) + 1)
        && crc([opcode, *count], words) == u16::from_le_bytes([*low, *high])
    {
        Ok(words)
    } else {
        Err(Malformed::Damaged)
    }
}

/// Request of the host. Node 0 is the device on the line. The device forwards requests for other nodes to its CAN bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Request {
    /// Reads an object of up to four bytes.
    Read(Address),
    /// Writes an object of up to four bytes, given by the low bytes of the value.
    Write(Address, u32),
    /// Sends an NMT command specifier (CiA 301 §7.2.8.3.1) to a node, 0 for all nodes. The command is not answered.
    Nmt { node: u16, command: u16 },
}

impl Request {
    /// The request in wire format.
    pub fn encode(self) -> Telegram {
        match self {
            Self::Read(address) => Telegram::new(0x10, &encode(address)),
            Self::Write(address, value) => {
                let ([i, j, k, l], [a, b, c, d]) = (encode(address), value.to_le_bytes());
                Telegram::new(0x11, &[i, j, k, l, a, b, c, d])
            }
            Self::Nmt { node, command } => {
                let ([n0, n1], [c0, c1]) = (node.to_le_bytes(), command.to_le_bytes());
                Telegram::new(0x0E, &[n0, n1, c0, c1])
            }
        }
    }

    /// Decodes a request from an opcode and the bytes after the ready acknowledgement of the device.
    pub fn decode(opcode: u8, body: &[u8]) -> Result<Self, Malformed> {
        match (opcode, data(opcode, body)?) {
            (0x10, &[i, j, k, l]) => Ok(Self::Read(decode([i, j, k, l]))),
            (0x11, &[i, j, k, l, a, b, c, d]) => {
                Ok(Self::Write(decode([i, j, k, l]), u32::from_le_bytes([a, b, c, d])))
            }
            (0x0E, &[n0, n1, c0, c1]) => {
                Ok(Self::Nmt { node: u16::from_le_bytes([n0, n1]), command: u16::from_le_bytes([c0, c1]) })
            }
            (opcode, data) => Err(Malformed::Unknown { opcode, words: data.len() / 2 }),
        }
    }

    /// Whether the device answers the request with a telegram.
    pub const fn is_answered(self) -> bool {
        !matches!(self, Self::Nmt { .. })
    }
}

fn encode(address: Address) -> [u8; 4] {
    let [low, high] = address.index.to_le_bytes();
    [low, high, address.subindex, address.node]
}

fn decode([low, high, subindex, node]: [u8; 4]) -> Address {
    Address { node, index: u16::from_le_bytes([low, high]), subindex }
}

/// Answer of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The value read. Bytes beyond the length of the object are zero.
    Value(u32),
    /// The value was written.
    Done,
    /// The request was refused with the code of an SDO abort or a code of maxon, 0x0F00_FFxx. The code is not 0.
    Refused(u32),
}

impl Answer {
    /// The answer in wire format. The refusal of a read is followed by a value of zero.
    pub fn encode(self, to: &Request) -> Telegram {
        let (code, value) = match self {
            Self::Value(value) => (0_u32, Some(value)),
            Self::Done => (0, None),
            Self::Refused(code) => (code, matches!(to, Request::Read { .. }).then_some(0)),
        };
        let [a, b, c, d] = code.to_le_bytes();
        match value.map(u32::to_le_bytes) {
            Some([e, f, g, h]) => Telegram::new(ANSWER, &[a, b, c, d, e, f, g, h]),
            None => Telegram::new(ANSWER, &[a, b, c, d]),
        }
    }

    /// Decodes an answer from the bytes after the host's ready acknowledgement of [`ANSWER`].
    pub fn decode(body: &[u8]) -> Result<Self, Malformed> {
        match *data(ANSWER, body)? {
            [0, 0, 0, 0] => Ok(Self::Done),
            [0, 0, 0, 0, a, b, c, d] => Ok(Self::Value(u32::from_le_bytes([a, b, c, d]))),
            [a, b, c, d] | [a, b, c, d, _, _, _, _] => Ok(Self::Refused(u32::from_le_bytes([a, b, c, d]))),
            ref data => Err(Malformed::Unknown { opcode: ANSWER, words: data.len() / 2 }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::epos4::tests::{CONTROLWORD, STATUSWORD};

    const READ: Request = Request::Read(STATUSWORD);
    const WRITE: Request = Request::Write(CONTROLWORD, 0x000F);

    #[test]
    fn requests_are_the_bytes_of_the_line() {
        let nmt = Request::Nmt { node: 1, command: 0x81 };
        let cases: [(Request, u8, &[u8]); 3] = [
            (READ, 0x10, &[0x01, 0x41, 0x60, 0x00, 0x01, 0xAB, 0xF0]),
            (WRITE, 0x11, &[0x03, 0x40, 0x60, 0x00, 0x01, 0x0F, 0x00, 0x00, 0x00, 0x52, 0xEF]),
            (nmt, 0x0E, &[0x01, 0x01, 0x00, 0x81, 0x00, 0x6B, 0x9C]),
        ];
        for (request, opcode, body) in cases {
            let telegram = request.encode();
            assert_eq!(telegram.opcode(), opcode);
            assert_eq!(telegram.body(), body, "{:02x?}", telegram.body());
            assert_eq!(Request::decode(opcode, body), Ok(request));
        }
    }

    #[test]
    fn answers_are_the_bytes_of_the_line() {
        let cases: [(Request, Answer, &[u8]); 4] = [
            (READ, Answer::Value(0x0137), &[0x03, 0, 0, 0, 0, 0x37, 0x01, 0, 0, 0xC5, 0x1B]),
            (WRITE, Answer::Done, &[0x01, 0, 0, 0, 0, 0x51, 0xAA]),
            (READ, Answer::Refused(0x0602_0000), &[0x03, 0, 0, 0x02, 0x06, 0, 0, 0, 0, 0x26, 0xE4]),
            (WRITE, Answer::Refused(0x0601_0002), &[0x01, 0x02, 0, 0x01, 0x06, 0xB6, 0x7E]),
        ];
        for (request, answer, body) in cases {
            let telegram = answer.encode(&request);
            assert_eq!(telegram.opcode(), ANSWER);
            assert_eq!(telegram.body(), body, "{:02x?}", telegram.body());
            assert_eq!(Answer::decode(body), Ok(answer));
        }
    }

    #[test]
    fn a_damaged_telegram_is_none() {
        let telegram = WRITE.encode();
        let body = telegram.body();
        for (index, bit) in (0..body.len()).flat_map(|index| (0..8).map(move |bit| (index, bit))) {
            let mut bytes = body.to_vec();
            bytes[index] ^= 1 << bit;
            assert_eq!(Request::decode(0x11, &bytes), Err(Malformed::Damaged));
        }
        for length in 0..body.len() {
            let damaged = Request::decode(0x11, &body[..length]);
            assert_eq!(damaged, Err(Malformed::Damaged));
        }
        let other = Request::decode(0x10, body);
        assert_eq!(other, Err(Malformed::Damaged), "the opcode is in the crc");
    }

    #[test]
    fn what_arrived_whole_and_means_nothing_is_said_so() {
        let unknown = Telegram::new(0x12, &[1, 2, 3, 4]);
        let expected = Malformed::Unknown { opcode: 0x12, words: 2 };
        assert_eq!(Request::decode(unknown.opcode(), unknown.body()), Err(expected));
        let short = Telegram::new(0x10, &[1, 2]);
        assert!(Request::decode(0x10, short.body()).is_err());
        let long = Telegram::new(ANSWER, &[0; 12]);
        assert!(Answer::decode(long.body()).is_err());
    }
}
