//! Errors of the SDO client.

use std::time::Duration;

use thiserror::Error;

use canopen::Object;
use canopen::sdo::AbortCode;

/// Why a transfer was not started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum StartError {
    /// A transfer is under way, or its result was not taken.
    #[error("{object} is being transferred")]
    Busy { object: Object },
    /// More data than the client has room for.
    #[error("{object} would take {size} bytes, at most {capacity} are transferred")]
    TooLarge {
        object: Object,
        size: usize,
        capacity: usize,
    },
}

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum SdoError {
    /// The server aborted.
    #[error("{object} aborted by the server: {code}")]
    Aborted { object: Object, code: AbortCode },
    /// No answer, or none that brought the transfer on, for all the retries. `waited` counts from the start of
    /// the transfer, retries included.
    #[error("{object} timed out after {waited:.1?}")]
    TimedOut { object: Object, waited: Duration },
    /// A segment came or was confirmed twice, or one is missing.
    #[error("{object}: toggle bit did not alternate")]
    Toggle { object: Object },
    /// A segment without data that is not the last, so that the transfer might never end.
    #[error("{object}: empty segment")]
    EmptySegment { object: Object },
    /// An answer that is none of expedited and segmented transfer.
    #[error("{object}: unexpected command specifier {specifier:#04x}")]
    Specifier { object: Object, specifier: u8 },
    /// The object is longer than the client has room for.
    #[error("{object} has at least {size} bytes, at most {capacity} are transferred")]
    TooLarge {
        object: Object,
        size: usize,
        capacity: usize,
    },
    /// The server sent more or fewer bytes than it announced, or than the reader's type has.
    #[error("{object} has {found} bytes, expected {expected}")]
    Length {
        object: Object,
        expected: usize,
        found: usize,
    },
    /// The acknowledgement of a segment that was not sent.
    #[error("{object}: segment {sequence} acknowledged, {sent} of the sub-block were sent")]
    Sequence {
        object: Object,
        sequence: u8,
        sent: u8,
    },
    /// A sub-block of no segments, or of more than 127.
    #[error(
        "{object}: the server asks for a sub-block of {block_size} segments, 1 to 127 are possible"
    )]
    BlockSize { object: Object, block_size: u8 },
    /// The data were corrupted on their way.
    #[error("{object}: checksum {found:#06x}, the server says {expected:#06x}")]
    Crc {
        object: Object,
        expected: u16,
        found: u16,
    },
}

impl SdoError {
    /// The object of the transfer.
    pub const fn object(self) -> Object {
        match self {
            Self::Aborted { object, .. }
            | Self::TimedOut { object, .. }
            | Self::Toggle { object }
            | Self::EmptySegment { object }
            | Self::Specifier { object, .. }
            | Self::TooLarge { object, .. }
            | Self::Length { object, .. }
            | Self::Sequence { object, .. }
            | Self::BlockSize { object, .. }
            | Self::Crc { object, .. } => object,
        }
    }

    /// The abort code that says why, whichever side ended the transfer.
    pub const fn abort_code(self) -> AbortCode {
        match self {
            Self::Aborted { code, .. } => code,
            Self::TimedOut { .. } => AbortCode::TIME_OUT,
            Self::Toggle { .. } => AbortCode::TOGGLE,
            Self::EmptySegment { .. } => AbortCode::GENERAL,
            Self::Specifier { .. } => AbortCode::COMMAND_SPECIFIER,
            Self::TooLarge { .. } => AbortCode::OUT_OF_MEMORY,
            Self::Length { .. } => AbortCode::LENGTH_MISMATCH,
            Self::Sequence { .. } => AbortCode::SEQUENCE_NUMBER,
            Self::BlockSize { .. } => AbortCode::BLOCK_SIZE,
            Self::Crc { .. } => AbortCode::CRC,
        }
    }
}
