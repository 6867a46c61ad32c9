//! Frames of an ultrasonic matrix: N × N transducers that look along one axis and measure echo times.
//!
//! No source gives a protocol of such a matrix, and this project defines the protocol. The line has 115200 baud and
//! 8N1. The host writes [`Request`]s, and the matrix answers with [`Reply`]s. Both are frames, and numbers have the high
//! byte first:
//!
//! | offset | content |
//! |---|---|
//! | 0 | 0xA5 |
//! | 1 | length n of the body |
//! | 2 … n + 1 | body: command, then its data |
//! | n + 2 | CRC-8 over bytes 1 … n + 1: polynomial 0x07, initial value 0, high bit first, not inverted |
//!
//! | command | request | reply |
//! |---|---|---|
//! | 0x01 identify | | elements per row and column u8, pitch u16 in 0.1 mm, firing slot u16 in µs |
//! | 0x02 pair | emitter row, emitter column, receiver row, receiver column | the same four bytes, echo time u16 in µs |
//! | 0x03 row | row | row, then one echo time per element of the row, from column 0 |
//! | 0xFF refusal | | refused command, reason: 1 unknown command, 2 wrong length, 3 no such element |
//!
//! An echo time is the time from emission to the first echo. [`NO_ECHO`] means that no echo was received. A measurement
//! begins when the last bit of the request has arrived. Each emission takes one firing slot. In a row query, the
//! elements of the row emit one after the other. The reply follows the last slot. A request that arrives during a
//! measurement or a reply is lost. A frame with a wrong CRC is not answered. A frame that is interrupted for longer than
//! [`GAP`] is discarded. This module has only the layouts.

use std::time::Duration;

use crate::{Settings, StopBits};

/// Settings of the line: 115200 8N1.
pub const SETTINGS: Settings = Settings { baud: 115_200, stop_bits: StopBits::One };

/// Echo time in a reply if no echo was received.
pub const NO_ECHO: u16 = 0xFFFF;

/// A frame with a longer gap between two bytes is discarded.
pub const GAP: Duration = Duration::from_millis(5);

/// Greatest number of elements per row and column.
pub const MAX_SIZE: u8 = 64;

/// First byte of a frame.
pub const START: u8 = 0xA5;

/// Bytes of a frame beside its body.
pub const FRAME: usize = 3;

/// Greatest length of the body of a request, bytes.
pub const MAX_REQUEST: usize = 5;

/// Greatest length of the body of a reply, bytes: one row of [`MAX_SIZE`] elements.
pub const MAX_REPLY: usize = 2 + 2 * MAX_SIZE as usize;

/// Command of the identity.
pub const IDENTIFY: u8 = 0x01;
/// Command of one pair.
pub const PAIR: u8 = 0x02;
/// Command of one row.
pub const ROW: u8 = 0x03;
/// First byte of the body of a refusal.
pub const REFUSAL: u8 = 0xFF;

/// Place of an element: row and column, from 0.
pub type Element = (u8, u8);

/// Reason of a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The matrix does not know the command.
    UnknownCommand,
    /// The body of the request has another length than the command needs.
    WrongLength,
    /// The matrix has no such element.
    NoElement,
    /// A reason without a meaning in this protocol.
    Other(u8),
}

/// Request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Size, pitch and firing slot.
    Identify,
    /// One echo time: `emitter` emits, `receiver` listens.
    Pair {
        /// Element that emits.
        emitter: Element,
        /// Element that listens.
        receiver: Element,
    },
    /// One echo time per element of a row. Each element listens to its own emission.
    Row(u8),
}

/// Reply of the matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply<'a> {
    /// The identity.
    Identity {
        /// Elements per row and column.
        size: u8,
        /// Distance between neighbouring elements, 0.1 mm.
        pitch: u16,
        /// Firing slot, µs.
        slot: u16,
    },
    /// The echo time of one pair.
    Pair {
        /// Element that emitted.
        emitter: Element,
        /// Element that listened.
        receiver: Element,
        /// Echo time, µs; [`NO_ECHO`] without an echo.
        time: u16,
    },
    /// The echo times of one row.
    Row {
        /// The row, from 0.
        row: u8,
        /// The echo times.
        times: EchoTimes<'a>,
    },
    /// The matrix refuses a request.
    Refusal {
        /// The refused command.
        command: u8,
        /// The reason.
        reason: Reason,
    },
}

/// Echo times of a row as the bytes of the wire: two per element, from column 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EchoTimes<'a>(&'a [u8]);

impl EchoTimes<'_> {
    /// The echo times, µs; [`NO_ECHO`] without an echo.
    pub fn iter(&self) -> impl Iterator<Item = u16> {
        self.0.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]))
    }
}

/// CRC-8 with polynomial 0x07, initial value 0, high bit first.
pub fn crc(bytes: &[u8]) -> u8 {
    let shift = |crc: u8| if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x07 };
    bytes.iter().fold(0, |crc, byte| (0..8).fold(crc ^ byte, |crc, _| shift(crc)))
}

/// Writes the frame of `body` into `frame`, and returns its length; `None` if the body is longer than 255 bytes or the
/// frame does not fit.
pub fn encode(body: &[u8], frame: &mut [u8]) -> Option<usize> {
    let length = u8::try_from(body.len()).ok()?;
    let frame = frame.get_mut(..body.len() + FRAME)?;
    (frame[0], frame[1]) = (START, length);
    frame[2..2 + body.len()].copy_from_slice(body);
    frame[body.len() + 2] = crc(&frame[1..body.len() + 2]);
    Some(frame.len())
}

impl Request {
    /// The body of the request and its length.
    pub fn body(self) -> ([u8; MAX_REQUEST], usize) {
        match self {
            Self::Identify => ([IDENTIFY, 0, 0, 0, 0], 1),
            Self::Pair { emitter, receiver } => ([PAIR, emitter.0, emitter.1, receiver.0, receiver.1], 5),
            Self::Row(row) => ([ROW, row, 0, 0, 0], 2),
        }
    }

    /// The frame of the request and its length.
    pub fn encode(self) -> ([u8; MAX_REQUEST + FRAME], usize) {
        let (body, length) = self.body();
        let mut frame = [0; MAX_REQUEST + FRAME];
        let length = encode(&body[..length], &mut frame).expect("the frame has room for every request");
        (frame, length)
    }

    /// Decodes the body of a request. Fails with the reason of the refusal.
    pub fn decode(body: &[u8]) -> Result<Self, Reason> {
        match *body {
            [IDENTIFY] => Ok(Self::Identify),
            [PAIR, row, column, to_row, to_column] => {
                Ok(Self::Pair { emitter: (row, column), receiver: (to_row, to_column) })
            }
            [ROW, row] => Ok(Self::Row(row)),
            [IDENTIFY | PAIR | ROW, ..] => Err(Reason::WrongLength),
            _ => Err(Reason::UnknownCommand),
        }
    }

    /// Length of the frame of the reply of a matrix with `size` elements per row, bytes.
    pub fn reply_length(self, size: u8) -> usize {
        FRAME
            + match self {
                Self::Identify => 6,
                Self::Pair { .. } => 7,
                Self::Row(_) => 2 + 2 * usize::from(size),
            }
    }
}

impl Reason {
    /// The reason as the byte of the wire.
    pub fn code(self) -> u8 {
        match self {
            Self::UnknownCommand => 1,
            Self::WrongLength => 2,
            Self::NoElement => 3,
            Self::Other(code) => code,
        }
    }

    /// The reason of a byte of the wire.
    pub fn of(code: u8) -> Self {
        match code {
            1 => Self::UnknownCommand,
            2 => Self::WrongLength,
            3 => Self::NoElement,
            code => Self::Other(code),
        }
    }
}

impl<'a> Reply<'a> {
    /// Decodes the body of a reply; `None` if it is no reply.
    pub fn decode(body: &'a [u8]) -> Option<Self> {
        Some(match *body {
            [IDENTIFY, size, p1, p0, s1, s0] => {
                Self::Identity { size, pitch: u16::from_be_bytes([p1, p0]), slot: u16::from_be_bytes([s1, s0]) }
            }
            [PAIR, row, column, to_row, to_column, t1, t0] => {
                Self::Pair { emitter: (row, column), receiver: (to_row, to_column), time: u16::from_be_bytes([t1, t0]) }
            }
            [ROW, row, ..] if body.len().is_multiple_of(2) => Self::Row { row, times: EchoTimes(&body[2..]) },
            [REFUSAL, command, code] => Self::Refusal { command, reason: Reason::of(code) },
            _ => return None,
        })
    }

    /// Writes the body of the reply into `body`, and returns its length; `None` if it does not fit.
    pub fn encode(self, body: &mut [u8]) -> Option<usize> {
        let mut put = |head: &[u8], tail: &[u8]| {
            let length = head.len() + tail.len();
            body.get_mut(..head.len())?.copy_from_slice(head);
            body.get_mut(head.len()..length)?.copy_from_slice(tail);
            Some(length)
        };
        match self {
            Self::Identity { size, pitch, slot } => {
                let ([p1, p0], [s1, s0]) = (pitch.to_be_bytes(), slot.to_be_bytes());
                put(&[IDENTIFY, size, p1, p0, s1, s0], &[])
            }
            Self::Pair { emitter, receiver, time } => {
                put(&[PAIR, emitter.0, emitter.1, receiver.0, receiver.1], &time.to_be_bytes())
            }
            Self::Row { row, times } => put(&[ROW, row], times.0),
            Self::Refusal { command, reason } => put(&[REFUSAL, command, reason.code()], &[]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_the_bytes_of_the_line() {
        let cases: [(Request, &[u8]); 3] = [
            (Request::Identify, &[0xA5, 0x01, 0x01, 0x12]),
            (Request::Row(7), &[0xA5, 0x02, 0x03, 0x07, 0xFC]),
            (Request::Pair { emitter: (1, 2), receiver: (3, 4) }, &[0xA5, 0x05, 0x02, 0x01, 0x02, 0x03, 0x04, 0xAA]),
        ];
        for (request, bytes) in cases {
            let (frame, length) = request.encode();
            assert_eq!(&frame[..length], bytes, "{request:?}");
            assert_eq!(Request::decode(&bytes[2..length - 1]), Ok(request));
        }
        assert_eq!(Request::decode(&[ROW]), Err(Reason::WrongLength));
        assert_eq!(Request::decode(&[IDENTIFY, 0]), Err(Reason::WrongLength));
        for body in [&[][..], &[0x04], &[REFUSAL]] {
            assert_eq!(Request::decode(body), Err(Reason::UnknownCommand));
        }
    }

    #[test]
    fn replies_are_the_bytes_of_the_line() {
        let cases: [(Reply, &[u8]); 4] = [
            (Reply::Identity { size: 12, pitch: 200, slot: 3500 }, &[0x01, 0x0C, 0x00, 0xC8, 0x0D, 0xAC]),
            (
                Reply::Pair { emitter: (1, 2), receiver: (3, 4), time: 2041 },
                &[0x02, 0x01, 0x02, 0x03, 0x04, 0x07, 0xF9],
            ),
            (Reply::Row { row: 5, times: EchoTimes(&[0x07, 0xF9, 0xFF, 0xFF]) }, &[0x03, 0x05, 0x07, 0xF9, 0xFF, 0xFF]),
            (Reply::Refusal { command: 9, reason: Reason::UnknownCommand }, &[0xFF, 0x09, 0x01]),
        ];
        for (reply, bytes) in cases {
            let mut body = [0; MAX_REPLY];
            assert_eq!(reply.encode(&mut body), Some(bytes.len()));
            assert_eq!(&body[..bytes.len()], bytes, "{reply:?}");
            assert_eq!(Reply::decode(bytes), Some(reply));
            assert_eq!(reply.encode(&mut body[..2]), None);
        }
        let times: Vec<_> = EchoTimes(&[0x07, 0xF9, 0xFF, 0xFF]).iter().collect();
        assert_eq!(times, [2041, NO_ECHO]);
        for body in [&[][..], &[0x03], &[0x03, 0, 1], &[0x01, 2], &[0x44]] {
            assert_eq!(Reply::decode(body), None, "{body:?}");
        }
    }

    #[test]
    fn reply_lengths_are_those_of_the_replies() {
        for (request, length) in [
            (Request::Identify, 9),
            (Request::Pair { emitter: (0, 0), receiver: (0, 1) }, 10),
            (Request::Row(0), 5 + 24),
        ] {
            assert_eq!(request.reply_length(12), length);
        }
        // CRC-8 of the check string of the CRC catalogue (CRC-8/SMBUS).
        assert_eq!(crc(b"123456789"), 0xF4);
    }
}
