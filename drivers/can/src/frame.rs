//! CAN frames.

use std::fmt;

use crate::{ExtendedId, Id, StandardId};

pub(crate) const EXTENDED: u32 = 0x8000_0000;
pub(crate) const REMOTE: u32 = 0x4000_0000;
pub(crate) const ERROR: u32 = 0x2000_0000;

/// A classic CAN frame with the layout of Linux's `struct can_frame` (16 bytes): the kernel reads a slice of frames
/// without conversion.
///
/// Whatever can be built can be sent. Bytes past [`Frame::data`]'s length are always zero, so equal
/// frames are equal byte for byte.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
#[repr(C, align(8))]
pub struct Frame {
    id_and_flags: u32,
    len: u8,
    padding: [u8; 3],
    data: [u8; 8],
}

impl Frame {
    /// A data frame; `None` if `data` is longer than 8 bytes.
    pub fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let mut bytes = [0; 8];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(Self { id_and_flags: id_bits(id.into()), len: data.len() as u8, padding: [0; 3], data: bytes })
    }

    /// A remote frame asking for `len` bytes; `None` above 8.
    pub fn remote(id: impl Into<Id>, len: u8) -> Option<Self> {
        (len <= 8).then(|| Self { id_and_flags: id_bits(id.into()) | REMOTE, len, padding: [0; 3], data: [0; 8] })
    }

    /// A frame from the kernel's words; `None` if its length is above 8.
    ///
    /// `id_and_flags` carries EFF, RTR and ERR in its top three bits, as in `struct can_frame`.
    pub fn from_raw(id_and_flags: u32, len: u8, data: [u8; 8]) -> Option<Self> {
        if len > 8 {
            return None;
        }
        let mut frame = Self { id_and_flags, len, padding: [0; 3], data };
        if id_and_flags & (EXTENDED | ERROR) == 0 {
            frame.id_and_flags &= REMOTE | 0x7FF;
        }
        let kept = if frame.is_remote() { 0 } else { usize::from(len) };
        frame.data[kept..].fill(0);
        Some(frame)
    }

    /// The identifier; `None` for an error frame, whose identifier is a set of error classes.
    pub fn id(&self) -> Option<Id> {
        if self.is_error() {
            None
        } else if self.id_and_flags & EXTENDED != 0 {
            ExtendedId::new(self.id_and_flags & 0x1FFF_FFFF).map(Id::Extended)
        } else {
            StandardId::new((self.id_and_flags & 0x7FF) as u16).map(Id::Standard)
        }
    }

    /// The identifier of a data frame with an 11-bit identifier: all that CANopen uses.
    pub fn standard_data_id(&self) -> Option<StandardId> {
        if self.id_and_flags & (EXTENDED | REMOTE | ERROR) != 0 {
            return None;
        }
        StandardId::new((self.id_and_flags & 0x7FF) as u16)
    }

    /// The payload; empty for a remote frame.
    pub fn data(&self) -> &[u8] {
        let len = if self.is_remote() { 0 } else { usize::from(self.len) };
        &self.data[..len]
    }

    /// The data length code: payload bytes, or for a remote frame the bytes asked for.
    pub fn len_code(&self) -> u8 {
        self.len
    }

    /// Whether it asks for data instead of carrying it.
    pub fn is_remote(&self) -> bool {
        self.id_and_flags & (REMOTE | ERROR) == REMOTE
    }

    /// Whether the kernel made it to report a bus condition.
    pub fn is_error(&self) -> bool {
        self.id_and_flags & ERROR != 0
    }

    /// Identifier and flags as in `struct can_frame`.
    pub fn raw_id(&self) -> u32 {
        self.id_and_flags
    }
}

fn id_bits(id: Id) -> u32 {
    match id {
        Id::Standard(id) => u32::from(id.raw()),
        Id::Extended(id) => id.raw() | EXTENDED,
    }
}

/// As `candump -L` and `cansend` write it: `601#4041600000000000`.
impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.id() {
            Some(Id::Standard(id)) => write!(f, "{:03X}#", id.raw())?,
            Some(Id::Extended(id)) => write!(f, "{:08X}#", id.raw())?,
            None => write!(f, "{:08X}#", self.id_and_flags)?,
        }
        if self.is_remote() {
            return write!(f, "R{}", self.len);
        }
        self.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}
