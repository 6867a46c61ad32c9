//! A scripted controller board of a force/torque sensor, built from the facts about its telegrams alone.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use can::Instant;
use serial::{Line, LineCounters, LineError};

/// A board that answers each `q` with 14 bytes, in the next reading.
pub(crate) struct Board {
    /// Load on the transducer, counts.
    pub(crate) load: [i16; 6],
    /// Load at the last `b`.
    pub(crate) bias: [i16; 6],
    /// The board ignores `b`.
    pub(crate) without_bias: bool,
    /// Number of queries to lose.
    pub(crate) mute: u32,
    /// The board hears nothing.
    pub(crate) deaf: bool,
    /// The line takes no byte.
    pub(crate) full: bool,
    pub(crate) gone: bool,
    /// Readings by which answers are late.
    pub(crate) delay: usize,
    /// Bytes that each answer has too many or too few.
    pub(crate) surplus: isize,
    /// Answers that are not read yet, and bytes that come with the next reading.
    pub(crate) late: VecDeque<(usize, Vec<u8>)>,
    pub(crate) outbox: VecDeque<u8>,
    /// Bytes as written, with their times.
    pub(crate) heard: Vec<(Instant, u8)>,
    pub(crate) keep_heard: bool,
    pub(crate) discarded: u32,
}

impl Board {
    pub(crate) fn new() -> Self {
        Self {
            load: [0; 6],
            bias: [0; 6],
            without_bias: false,
            mute: 0,
            deaf: false,
            full: false,
            gone: false,
            delay: 0,
            surplus: 0,
            late: VecDeque::with_capacity(64),
            outbox: VecDeque::with_capacity(4_096),
            heard: Vec::new(),
            keep_heard: true,
            discarded: 0,
        }
    }

    pub(crate) fn shared(self) -> SharedBoard {
        SharedBoard(Arc::new(Mutex::new(self)))
    }

    fn hear(&mut self, byte: u8) {
        match byte {
            0x62 if self.without_bias => {}
            0x62 => self.bias = self.load,
            0x71 if self.mute > 0 => self.mute -= 1,
            0x71 => {
                let mut answer = [0; 18];
                for (channel, bytes) in answer[..12].chunks_exact_mut(2).enumerate() {
                    bytes.copy_from_slice(&self.load[channel].wrapping_sub(self.bias[channel]).to_be_bytes());
                }
                answer[12..14].copy_from_slice(&[0xAA, 0x55]);
                let answer = &answer[..14_usize.checked_add_signed(self.surplus).unwrap()];
                if self.delay == 0 {
                    self.outbox.extend(answer);
                } else {
                    self.late.push_back((self.delay, answer.to_vec()));
                }
            }
            _ => {}
        }
    }
}

/// The line with the board at its end. The test keeps a second handle.
#[derive(Clone)]
pub(crate) struct SharedBoard(Arc<Mutex<Board>>);

impl SharedBoard {
    pub(crate) fn board(&self) -> MutexGuard<'_, Board> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Line for SharedBoard {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let mut board = self.board();
        if board.gone {
            return Err(LineError::Gone);
        }
        if board.full {
            return Ok(0);
        }
        for &byte in bytes {
            if board.keep_heard {
                board.heard.push((now, byte));
            }
            if !board.deaf {
                board.hear(byte);
            }
        }
        Ok(bytes.len())
    }

    fn read(&mut self, _now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        let mut board = self.board();
        if board.gone {
            return Err(LineError::Gone);
        }
        let count = into.len().min(board.outbox.len());
        into.iter_mut().zip(board.outbox.drain(..count)).for_each(|(to, from)| *to = from);
        for late in &mut board.late {
            late.0 -= 1;
        }
        while let Some((0, _)) = board.late.front() {
            let (_, answer) = board.late.pop_front().unwrap();
            board.outbox.extend(answer);
        }
        Ok(count)
    }

    fn discard_unsent(&mut self) {
        self.board().discarded += 1;
    }

    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}
