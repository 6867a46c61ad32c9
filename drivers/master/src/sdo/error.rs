//! Errors of the SDO client.

use std::time::Duration;

use thiserror::Error;

use canopen::Object;
use canopen::sdo::AbortCode;

/// Why a transfer was not started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum StartError {
    /// A transfer is under way, or its result was not taken.
    #[error("{object} is being transferred")]
    Busy { object: Object },
    #[error("{object} would take {size} bytes, at most {capacity} are transferred")]
    TooLarge { object: Object, size: usize, capacity: usize },
}

/// Why the transfer of an object failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{object}{cause}")]
pub struct SdoError {
    /// The object of the transfer.
    pub object: Object,
    /// What ended the transfer.
    pub cause: SdoCause,
}

/// What ended a transfer. The text continues the address of the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum SdoCause {
    #[error(" aborted by the server: {code}")]
    Aborted { code: AbortCode },
    /// No answer that belongs to the transfer, after all repetitions of the request. `waited` is the time since the
    /// start of the transfer.
    #[error(" timed out after {waited:.1?}")]
    TimedOut { waited: Duration },
    /// A segment was sent or confirmed twice, or a segment is missing.
    #[error(": the toggle bit of the server did not alternate")]
    Toggle,
    /// The transfer might never end.
    #[error(": the server sent a segment without data that is not the last")]
    EmptySegment,
    /// The answer belongs to another service, or to another step of the transfer.
    #[error(": the server answered with the unexpected command specifier {specifier:#04x}")]
    Specifier { specifier: u8 },
    #[error(" has at least {size} bytes, the client takes at most {capacity}")]
    TooLarge { size: usize, capacity: usize },
    /// The server sent more or fewer bytes than it announced, or than the type of the value has.
    #[error(" has {found} bytes, expected {expected}")]
    Length { expected: usize, found: usize },
    /// The server acknowledged a segment that was not sent.
    #[error(": the server acknowledged segment {sequence} of a sub-block of {sent}")]
    Sequence { sequence: u8, sent: u8 },
    /// A sub-block of no segments, or of more than 127.
    #[error(": the server asks for a sub-block of {block_size} segments, 1 to 127 are possible")]
    BlockSize { block_size: u8 },
    #[error(": the data have the checksum {found:#06x}, the server announced {expected:#06x}")]
    Crc { expected: u16, found: u16 },
}

impl SdoCause {
    /// The error of the transfer of `object`.
    pub const fn of(self, object: Object) -> SdoError {
        let cause = self;
        SdoError { object, cause }
    }

    /// The abort code that says why, whichever side ended the transfer.
    pub const fn abort_code(self) -> AbortCode {
        match self {
            Self::Aborted { code } => code,
            Self::TimedOut { .. } => AbortCode::TIME_OUT,
            Self::Toggle => AbortCode::TOGGLE,
            Self::EmptySegment => AbortCode::GENERAL,
            Self::Specifier { .. } => AbortCode::COMMAND_SPECIFIER,
            Self::TooLarge { .. } => AbortCode::OUT_OF_MEMORY,
            Self::Length { .. } => AbortCode::LENGTH_MISMATCH,
            Self::Sequence { .. } => AbortCode::SEQUENCE_NUMBER,
            Self::BlockSize { .. } => AbortCode::BLOCK_SIZE,
            Self::Crc { .. } => AbortCode::CRC,
        }
    }
}
