//! Errors of service ports.

use std::time::Duration;

use thiserror::Error;

/// Why a request did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StartError {
    /// One thing at a time.
    #[error("an earlier request is not over")]
    Busy,
    /// No source says how an EPOS2 transfers segments.
    #[error("no transfer in segments with an EPOS2: only objects of up to 4 bytes")]
    NoSegments,
    /// Longer than the client has room for.
    #[error("{size} bytes are too many, at most {capacity} are transferred")]
    TooLarge {
        /// Bytes of the object.
        size: usize,
        /// Bytes that the client transfers.
        capacity: usize,
    },
}

/// How a request failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ServiceError {
    /// The device answered with this code of an SDO abort, or one of maxon's own 0x0F00_FFxx.
    #[error("refused with code {0:#010x}")]
    Refused(u32),
    /// No answer, or none to its end.
    #[error("timed out after {waited:?}")]
    TimedOut {
        /// Since the request was made.
        waited: Duration,
    },
    /// An EPOS2 was not ready, or our bytes reached it damaged.
    #[error("the device did not accept the request: it was busy, or heard it damaged")]
    NotAcknowledged,
    /// The answer's CRC was wrong, or it was torn.
    #[error("the answer came damaged")]
    Damaged,
    /// What came is right, and answers something else.
    #[error("the answer does not belong to the request")]
    Unexpected,
    /// The object is longer than the client has room for.
    #[error("the object has {size} bytes, at most {capacity} are transferred")]
    TooLarge {
        /// Bytes announced.
        size: usize,
        /// Bytes that the client transfers.
        capacity: usize,
    },
}
