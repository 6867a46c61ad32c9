//! Telegrams of the controller board that reads the ATI force/torque transducers of the IRp-6 robots.
//!
//! The host writes [`Request`]s of one byte. The board answers a query with a [`Reply`] of 14 bytes, and does not
//! answer a bias request. Requests and replies have no header, length or checksum. The board loses a query that arrives
//! while the board sends a reply. After power-on the board sends one text of unknown length. Source: the sensor process
//! of MRROC++ for this board. This module has only the layouts. The receiver separates replies by time, because the
//! line is idle between two exchanges.

use crate::{Settings, StopBits};

/// Settings of the line: 115200 8N1.
pub const SETTINGS: Settings = Settings { baud: 115_200, stop_bits: StopBits::One };

/// Length of a request, bytes.
pub const REQUEST: usize = 1;

/// Length of a reply, bytes.
pub const REPLY: usize = 14;

/// Request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Request {
    /// The present load becomes the zero of all later readings. The board does not answer.
    Bias = b'b',
    /// The board takes a sample and answers.
    Query = b'q',
}

impl Request {
    /// The request in wire format.
    pub const fn encode(self) -> [u8; REQUEST] {
        [self as u8]
    }

    /// Decodes a byte; `None` for any other byte.
    pub const fn decode(byte: u8) -> Option<Self> {
        match byte {
            b'b' => Some(Self::Bias),
            b'q' => Some(Self::Query),
            _ => None,
        }
    }
}

/// Reply of the board to a query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reply {
    /// Forces along x, y and z, then torques about x, y and z, in counts.
    pub counts: [i16; 6],
    /// The last two bytes. No source gives their meaning; the original host ignored them.
    pub rest: [u8; 2],
}

impl Reply {
    /// The reply in wire format, high bytes first.
    pub fn encode(self) -> [u8; REPLY] {
        let mut bytes = [0; REPLY];
        let (counts, rest) = bytes.split_at_mut(REPLY - self.rest.len());
        for (bytes, count) in counts.chunks_exact_mut(2).zip(self.counts) {
            bytes.copy_from_slice(&count.to_be_bytes());
        }
        rest.copy_from_slice(&self.rest);
        bytes
    }

    /// Decodes 14 bytes. Any 14 bytes are a valid reply.
    pub fn decode(bytes: [u8; REPLY]) -> Self {
        let [.., last_but_one, last] = bytes;
        let count = |channel: usize| i16::from_be_bytes([bytes[2 * channel], bytes[2 * channel + 1]]);
        Self { counts: std::array::from_fn(count), rest: [last_but_one, last] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_the_bytes_of_the_line() {
        assert_eq!(Request::Bias.encode(), [0x62]);
        assert_eq!(Request::Query.encode(), [0x71]);
        for byte in 0..=u8::MAX {
            let request = Request::decode(byte);
            assert_eq!(request.is_some(), matches!(byte, 0x62 | 0x71), "{byte:#04x}");
            assert!(request.is_none_or(|request| request.encode() == [byte]));
        }
    }

    #[test]
    fn replies_are_the_bytes_of_the_line() {
        let cases = [
            // 10 N, -20 N and 0.087 N; 5 N·m, -0.0053 N·m and the end of the range.
            (
                Reply { counts: [115, -230, 1, 940, -1, -32_768], rest: [0xAA, 0x55] },
                [0x00, 0x73, 0xFF, 0x1A, 0x00, 0x01, 0x03, 0xAC, 0xFF, 0xFF, 0x80, 0x00, 0xAA, 0x55],
            ),
            (Reply::default(), [0; REPLY]),
            (
                Reply { counts: [0x0102, 0x0304, 0x0506, 0x0708, 0x090A, 0x0B0C], rest: [0x0D, 0x0E] },
                [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14],
            ),
        ];
        for (reply, bytes) in cases {
            assert_eq!(reply.encode(), bytes, "{reply:?}");
            assert_eq!(Reply::decode(bytes), reply);
        }
    }

    #[test]
    fn an_exchange_takes_1_3_ms_of_the_line() {
        assert_eq!(SETTINGS.line_time(REQUEST + REPLY).as_nanos(), 1_302_084);
    }
}
