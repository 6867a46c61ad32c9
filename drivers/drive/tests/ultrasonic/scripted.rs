//! A scripted ultrasonic matrix, built from the description of its frames alone.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use can::Instant;
use serial::{Line, LineCounters, LineError};

/// A matrix that answers each request in a later reading.
pub(crate) struct Script {
    pub(crate) size: u8,
    /// Pitch, 0.1 mm, and firing slot, µs.
    pub(crate) pitch: u16,
    pub(crate) slot: u16,
    /// Readings until an answer.
    pub(crate) delay: usize,
    /// Number of requests to lose.
    pub(crate) mute: u32,
    /// Number of answers with a wrong checksum.
    pub(crate) broken: u32,
    /// Number of answers whose echoes come after the firing slot.
    pub(crate) late: u32,
    /// Answer every request with this refusal.
    pub(crate) refusal: Option<u8>,
    pub(crate) gone: bool,
    /// Bytes of the request so far, and bytes to read.
    pub(crate) request: Vec<u8>,
    pub(crate) outbox: VecDeque<u8>,
    pub(crate) pending: Option<(usize, Vec<u8>)>,
    /// Bodies of all requests.
    pub(crate) heard: Vec<Vec<u8>>,
    pub(crate) discarded: u32,
}

impl Script {
    pub(crate) fn new(size: u8) -> Self {
        Self {
            size,
            pitch: 200,
            slot: 3_500,
            delay: 3,
            mute: 0,
            broken: 0,
            late: 0,
            refusal: None,
            gone: false,
            request: Vec::new(),
            outbox: VecDeque::new(),
            pending: None,
            heard: Vec::new(),
            discarded: 0,
        }
    }

    pub(crate) fn shared(self) -> SharedScript {
        SharedScript(Arc::new(Mutex::new(self)))
    }

    /// Echo time of a pair, µs. Element (1, 1) hears nothing.
    pub(crate) fn time(emitter: (u8, u8), receiver: (u8, u8)) -> u16 {
        if emitter == (1, 1) {
            return 0xFFFF;
        }
        let number = |(row, column): (u8, u8)| u16::from(row) * 10 + u16::from(column);
        500 + 100 * number(emitter) + number(receiver)
    }

    fn hear(&mut self, byte: u8) {
        self.request.push(byte);
        let length = self.request.get(1).map_or(usize::MAX, |length| usize::from(*length) + 3);
        if self.request.len() < length {
            return;
        }
        let request = std::mem::take(&mut self.request);
        assert_eq!((request[0], crc(&request[1..length - 1])), (0xA5, request[length - 1]));
        let body = request[2..length - 1].to_vec();
        self.heard.push(body.clone());
        // A busy matrix loses requests.
        if self.pending.is_some() {
            return;
        }
        if self.mute > 0 {
            self.mute -= 1;
            return;
        }
        let mut answer = match body[..] {
            _ if self.refusal.is_some() => vec![0xFF, body[0], self.refusal.unwrap()],
            [1] => {
                let mut answer = vec![1, self.size];
                answer.extend(self.pitch.to_be_bytes());
                answer.extend(self.slot.to_be_bytes());
                answer
            }
            [2, a, b, c, d] => [&body[..], &Self::time((a, b), (c, d)).to_be_bytes()].concat(),
            [3, row] => {
                let times = (0..self.size).flat_map(|column| Self::time((row, column), (row, column)).to_be_bytes());
                [3, row].into_iter().chain(times).collect()
            }
            _ => panic!("request {body:02x?}"),
        };
        if self.late > 0 && body[0] != 1 {
            self.late -= 1;
            let end = answer.len();
            answer[end - 2..].copy_from_slice(&(self.slot + 1).to_be_bytes());
        }
        answer.insert(0, answer.len() as u8);
        answer.push(crc(&answer));
        answer.insert(0, 0xA5);
        if self.broken > 0 {
            self.broken -= 1;
            *answer.last_mut().unwrap() ^= 0x10;
        }
        self.pending = Some((self.delay, answer));
    }
}

fn crc(bytes: &[u8]) -> u8 {
    let mut register = 0_u8;
    for byte in bytes {
        register ^= byte;
        for _ in 0..8 {
            let carry = register & 0x80 != 0;
            register <<= 1;
            if carry {
                register ^= 0x07;
            }
        }
    }
    register
}

/// The script at the end of a line.
#[derive(Clone)]
pub(crate) struct SharedScript(Arc<Mutex<Script>>);

impl SharedScript {
    pub(crate) fn script(&self) -> MutexGuard<'_, Script> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Line for SharedScript {
    fn read(&mut self, _now: Instant, buffer: &mut [u8]) -> Result<usize, LineError> {
        let mut script = self.script();
        if script.gone {
            return Err(LineError::Gone);
        }
        match script.pending.take() {
            Some((0, answer)) => script.outbox.extend(answer),
            Some((delay, answer)) => script.pending = Some((delay - 1, answer)),
            None => {}
        }
        let count = script.outbox.len().min(buffer.len());
        buffer.iter_mut().zip(script.outbox.drain(..count)).for_each(|(place, byte)| *place = byte);
        Ok(count)
    }

    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let mut script = self.script();
        if script.gone {
            return Err(LineError::Gone);
        }
        bytes.iter().for_each(|byte| script.hear(*byte));
        Ok(bytes.len())
    }

    fn discard_unsent(&mut self) {
        self.script().discarded += 1;
    }

    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}
