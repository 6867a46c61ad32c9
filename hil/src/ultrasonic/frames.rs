//! Frames of the ultrasonic matrix: reception of requests, and the layout of replies.

use std::time::Duration;

use can::Instant;

/// Echo time in a reply if no echo was received.
pub const NO_ECHO: u16 = 0xFFFF;

/// A request with a longer gap between two bytes is discarded.
pub const GAP: Duration = Duration::from_millis(5);

pub(super) const IDENTIFY: u8 = 0x01;
pub(super) const PAIR: u8 = 0x02;
pub(super) const ROW: u8 = 0x03;
pub(super) const REFUSAL: u8 = 0xFF;

/// Reasons of a refusal.
pub(super) const UNKNOWN_COMMAND: u8 = 1;
pub(super) const WRONG_LENGTH: u8 = 2;
pub(super) const NO_ELEMENT: u8 = 3;

const START: u8 = 0xA5;
/// Greatest length of the body of a request that is received. A longer body is no request.
const MAX_BODY: usize = 8;

/// CRC-8 with polynomial 0x07, initial value 0, high bit first.
pub(super) fn crc(bytes: &[u8]) -> u8 {
    let shift = |crc: u8| if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x07 };
    bytes.iter().fold(0, |crc, byte| (0..8).fold(crc ^ byte, |crc, _| shift(crc)))
}

/// The frame of a body of at most 255 bytes.
pub(super) fn encode(body: &[u8]) -> Vec<u8> {
    let mut frame = vec![START, body.len() as u8];
    frame.extend(body);
    frame.push(crc(&frame[1..]));
    frame
}

/// Reception of requests byte by byte.
#[derive(Clone, Debug, Default)]
pub(super) struct Receiver {
    /// Length and body so far.
    bytes: [u8; 1 + MAX_BODY],
    state: State,
    last: Instant,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    /// Before the start of a frame.
    #[default]
    Idle,
    /// This number of bytes has arrived after the start.
    Frame(usize),
}

impl Receiver {
    /// Takes a byte. Returns the body of the valid frame that ends with the byte, and the length of the body.
    pub(super) fn receive(&mut self, byte: u8, now: Instant) -> Option<([u8; MAX_BODY], usize)> {
        if now.since(self.last) > GAP {
            self.state = State::Idle;
        }
        self.last = now;
        let count = match self.state {
            State::Idle => {
                if byte == START {
                    self.state = State::Frame(0);
                }
                return None;
            }
            State::Frame(count) => count,
        };
        let length = if count == 0 { usize::from(byte) } else { usize::from(self.bytes[0]) };
        if length > MAX_BODY {
            // The previous byte may have been the end of a frame whose beginning was lost.
            self.state = if byte == START { State::Frame(0) } else { State::Idle };
            return None;
        }
        if count <= length {
            self.bytes[count] = byte;
            self.state = State::Frame(count + 1);
            return None;
        }
        self.state = State::Idle;
        let mut body = [0; MAX_BODY];
        body[..length].copy_from_slice(&self.bytes[1..=length]);
        (crc(&self.bytes[..=length]) == byte).then_some((body, length))
    }
}
