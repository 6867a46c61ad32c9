//! Faults of an ultrasonic matrix and their form in the words of a state, and errors of its bring-up.

use std::time::Duration;

use can::{counted, counted_as};
use serial::LineError;
use serial::ultrasonic::Reason;
use thiserror::Error;

/// A latched condition of a matrix. [`UltrasonicLink::reset_fault`](super::UltrasonicLink::reset_fault) and the next
/// bring-up clear the fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum UltrasonicFault {
    /// Bring-up has not ended.
    #[error("ultrasonic matrix not started")]
    NotStarted,
    /// The driver was dropped, and no longer reads the matrix.
    #[error("ultrasonic matrix ended, its line has no controller any more")]
    Ended,
    /// More queries in a row than tolerated had no reply.
    #[error("no reply to {}: check cable and supply of the matrix", counted_as(*.queries, "query", "queries"))]
    Silent { queries: u32 },
    /// More queries in a row than tolerated had no valid reply, and `readings` readings were something else.
    #[error(
        "{} no reply since the last one: check the cable of the matrix and restart it",
        counted_as(*.readings, "reading was", "readings were")
    )]
    Garbage { readings: u32 },
    /// The matrix refused a query.
    #[error("the matrix refused command {command:#04x} with reason {reason}: check its size")]
    Refused { command: u8, reason: u8 },
    /// The serial line cannot be read or written.
    #[error("{0}: open the line anew")]
    Line(LineError),
}

/// Why a matrix could not be brought up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum UltrasonicError {
    /// No byte was received.
    #[error("no answer, waited {waited:.1?}: check supply and cable of the matrix, and its baud rate")]
    Absent { waited: Duration },
    /// Bytes were received, but no identity.
    #[error("{} and no identity among them: check the baud rate and the device on the line", counted(*.bytes, "byte"))]
    Garbled { bytes: u32 },
    /// The matrix has another number of elements.
    #[error("the matrix has {found} × {found} elements, declared were {declared} × {declared}")]
    OfAnotherSize { declared: u8, found: u8 },
    /// The elements have another distance. Both values are in 0.1 mm.
    #[error("the elements are {found} × 0.1 mm apart, declared were {declared} × 0.1 mm")]
    OfAnotherPitch { declared: u16, found: u16 },
    /// The firing slots have another duration. Both values are in µs.
    #[error("a firing slot takes {found} µs, declared were {declared} µs")]
    OfAnotherSlot { declared: u16, found: u16 },
    /// The matrix refused to identify itself.
    #[error("the matrix refused its identity with reason {reason}: check its firmware")]
    Refused { reason: u8 },
    #[error("{0}")]
    Line(LineError),
}

impl UltrasonicFault {
    pub(super) fn refused(command: u8, reason: Reason) -> Self {
        Self::Refused { command, reason: reason.code() }
    }
}

/// A fault as two words: its kind and its number. Kind 0 is no fault.
pub(super) fn words(fault: Option<UltrasonicFault>) -> [u64; 2] {
    match fault {
        None => [0, 0],
        Some(UltrasonicFault::NotStarted) => [1, 0],
        Some(UltrasonicFault::Ended) => [2, 0],
        Some(UltrasonicFault::Silent { queries }) => [3, u64::from(queries)],
        Some(UltrasonicFault::Garbage { readings }) => [4, u64::from(readings)],
        Some(UltrasonicFault::Refused { command, reason }) => [5, u64::from(command) << 8 | u64::from(reason)],
        Some(UltrasonicFault::Line(LineError::Gone)) => [6, 0],
        Some(UltrasonicFault::Line(LineError::Os(number))) => [7, u64::from(number.cast_unsigned())],
    }
}

/// The fault that [`words`] has encoded.
pub(super) fn of_words([kind, number]: [u64; 2]) -> Option<UltrasonicFault> {
    Some(match kind {
        0 => return None,
        2 => UltrasonicFault::Ended,
        3 => UltrasonicFault::Silent { queries: number as u32 },
        4 => UltrasonicFault::Garbage { readings: number as u32 },
        5 => UltrasonicFault::Refused { command: (number >> 8) as u8, reason: number as u8 },
        6 => UltrasonicFault::Line(LineError::Gone),
        7 => UltrasonicFault::Line(LineError::Os((number as u32).cast_signed())),
        _ => UltrasonicFault::NotStarted,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_survives_its_words() {
        let faults = [
            UltrasonicFault::NotStarted,
            UltrasonicFault::Ended,
            UltrasonicFault::Silent { queries: 4 },
            UltrasonicFault::Garbage { readings: u32::MAX },
            UltrasonicFault::Refused { command: 3, reason: 255 },
            UltrasonicFault::Line(LineError::Gone),
            UltrasonicFault::Line(LineError::Os(-5)),
        ];
        assert_eq!(of_words(words(None)), None);
        for fault in faults {
            assert_eq!(of_words(words(Some(fault))), Some(fault));
        }
    }
}
