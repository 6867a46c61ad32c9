//! One line of the slcan protocol.

use std::fmt;
use std::ops::Deref;

use thiserror::Error;

use crate::{ExtendedId, Frame, Id, StandardId};

/// Bytes of the longest line, its end included: an extended frame of 8 bytes with a time stamp.
pub const LONGEST: usize = 1 + 8 + 1 + 16 + 4 + 1;

/// An encoded line as it goes over the wire, its end included; reads as `[u8]`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct TextLine {
    bytes: [u8; LONGEST],
    len: u8,
}

impl TextLine {
    /// A line that begins with `text`, to be ended by [`TextLine::end`].
    pub(super) fn new(text: &[u8]) -> Self {
        let mut line = Self { bytes: [0; LONGEST], len: 0 };
        text.iter().for_each(|&byte| line.push(byte));
        line
    }

    pub(super) fn push(&mut self, byte: u8) {
        self.bytes[usize::from(self.len)] = byte;
        self.len += 1;
    }

    /// Appends the lowest `digits` digits of `number`.
    pub(super) fn hex(mut self, number: u32, digits: u32) -> Self {
        for digit in (0..digits).rev() {
            self.push(b"0123456789ABCDEF"[(number >> (4 * digit) & 0xF) as usize]);
        }
        self
    }

    /// A frame without the line's end; `None` for an error frame, which was never on a bus.
    pub(super) fn frame(frame: &Frame) -> Option<Self> {
        let (letter, id, digits) = match (frame.id()?, frame.is_remote()) {
            (Id::Standard(id), false) => (b't', u32::from(id.raw()), 3),
            (Id::Standard(id), true) => (b'r', u32::from(id.raw()), 3),
            (Id::Extended(id), false) => (b'T', id.raw(), 8),
            (Id::Extended(id), true) => (b'R', id.raw(), 8),
        };
        let head = Self::new(&[letter]).hex(id, digits).hex(u32::from(frame.len_code()), 1);
        let data = frame.data().iter();
        Some(data.fold(head, |line, &byte| line.hex(u32::from(byte), 2)))
    }

    pub(super) fn end(mut self) -> Self {
        self.push(b'\r');
        self
    }
}

impl Deref for TextLine {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }
}

impl fmt::Debug for TextLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\"", self.escape_ascii())
    }
}

/// Why a line is not understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum LineError {
    #[error("no line begins with {:?}", char::from(*.0))]
    Unknown(u8),
    #[error("a CAN FD frame, which is not supported")]
    Fd,
    #[error("too short or too long for its kind")]
    Length,
    #[error("a character that may not stand there")]
    Character,
    #[error("an identifier out of range")]
    Id,
    #[error("a frame of more than 8 bytes")]
    DataLength,
}

/// What is left of a line that is being read.
pub(super) struct Rest<'a>(pub(super) &'a [u8]);

impl Rest<'_> {
    pub(super) fn byte(&mut self) -> Result<u8, LineError> {
        let (&byte, rest) = self.0.split_first().ok_or(LineError::Length)?;
        self.0 = rest;
        Ok(byte)
    }

    fn digits(&mut self, digits: usize, radix: u32) -> Result<u32, LineError> {
        (0..digits).try_fold(0, |number, _| {
            let digit = char::from(self.byte()?).to_digit(radix);
            Ok(number * radix + digit.ok_or(LineError::Character)?)
        })
    }

    /// A hexadecimal number of `digits` digits, at most 8.
    pub(super) fn hex(&mut self, digits: usize) -> Result<u32, LineError> {
        // Eight digits fill the number without passing it.
        self.digits(digits, 16)
    }

    pub(super) fn decimal(&mut self, digits: usize) -> Result<u32, LineError> {
        self.digits(digits, 10)
    }

    /// `0` or `1`.
    pub(super) fn switch(&mut self) -> Result<bool, LineError> {
        match self.byte()? {
            b'0' => Ok(false),
            b'1' => Ok(true),
            _ => Err(LineError::Character),
        }
    }

    /// The frame whose kind `letter` gave: one of `t`, `T`, `r`, `R`.
    pub(super) fn frame(&mut self, letter: u8) -> Result<Frame, LineError> {
        let id: Id = if letter.is_ascii_lowercase() {
            StandardId::new(self.hex(3)? as u16).ok_or(LineError::Id)?.into()
        } else {
            ExtendedId::new(self.hex(8)?).ok_or(LineError::Id)?.into()
        };
        let len = self.hex(1)? as u8;
        if letter.eq_ignore_ascii_case(&b'r') {
            return Frame::remote(id, len).ok_or(LineError::DataLength);
        }
        let mut data = [0; 8];
        let data = data.get_mut(..usize::from(len)).ok_or(LineError::DataLength)?;
        for byte in &mut *data {
            *byte = self.hex(2)? as u8;
        }
        Ok(Frame::new(id, data).expect("at most 8 bytes"))
    }

    /// Nothing may be left.
    pub(super) fn end(&self) -> Result<(), LineError> {
        self.0.is_empty().then_some(()).ok_or(LineError::Length)
    }
}
