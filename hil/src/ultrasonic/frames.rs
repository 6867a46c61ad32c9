//! Frames of the ultrasonic matrix: reception of requests, and the layout of replies.

use can::Instant;
use serial::ultrasonic::{FRAME, GAP, START};
pub(super) use serial::ultrasonic::{IDENTIFY, PAIR, REFUSAL, ROW, crc};

/// Reasons of a refusal.
pub(super) const UNKNOWN_COMMAND: u8 = 1;
pub(super) const WRONG_LENGTH: u8 = 2;
pub(super) const NO_ELEMENT: u8 = 3;

/// Greatest length of the body of a request that is received. A longer body is no request.
const MAX_BODY: usize = 8;

/// The frame of a body of at most 255 bytes.
pub(super) fn encode(body: &[u8]) -> Vec<u8> {
    let mut frame = vec![0; body.len() + FRAME];
    serial::ultrasonic::encode(body, &mut frame).expect("a reply has at most 130 bytes");
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
