//! Errors of service ports.

use std::time::Duration;

use thiserror::Error;

/// Reason why a request did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum StartError {
    /// Another request is under way.
    #[error("an earlier request is not over")]
    Busy,
    /// No source describes the segmented transfer of EPOS2.
    #[error("no transfer in segments with an EPOS2: only objects of up to 4 bytes")]
    NoSegments,
    /// The object is longer than the capacity of the client.
    #[error("{size} bytes are too many, at most {capacity} are transferred")]
    TooLarge { size: usize, capacity: usize },
}

/// Reason why a request failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum ServiceError {
    /// The device refused the request with the code of an SDO abort or a code of maxon, 0x0F00_FFxx.
    #[error("refused with code {0:#010x}")]
    Refused(u32),
    /// No answer, or an incomplete answer. `waited` counts from the start of the service, retries included.
    #[error("timed out after {waited:?}")]
    TimedOut { waited: Duration },
    /// An EPOS2 was not ready, or received damaged bytes.
    #[error("the device did not accept the request: it was busy, or heard it damaged")]
    NotAcknowledged,
    /// The CRC of the answer was wrong, or the answer was incomplete.
    #[error("the answer came damaged")]
    Damaged,
    /// A correct answer to another request.
    #[error("the answer does not belong to the request")]
    Unexpected,
    /// The object is longer than the capacity of the client.
    #[error("the object has {size} bytes, at most {capacity} are transferred")]
    TooLarge { size: usize, capacity: usize },
}
