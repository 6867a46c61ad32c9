//! Faults of a device and their form in the words of a state, and errors of its bring-up.

use std::time::Duration;

use can::{counted, counted_as};
use serial::LineError;
use thiserror::Error;

/// A latched condition of a device. [`DeviceLink::reset_fault`](super::DeviceLink::reset_fault) and the next bring-up
/// clear the fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DeviceFault {
    /// Bring-up has not ended.
    #[error("device not started")]
    NotStarted,
    /// The driver was dropped, and no longer reads the device.
    #[error("device ended, its line has no controller any more")]
    Ended,
    /// More samples in a row than tolerated are missing.
    #[error("no answer for {}: check cable and supply of the device", counted(*.samples, "sample"))]
    Silent { samples: u32 },
    /// More samples in a row than tolerated are missing, and `readings` readings were no valid answer.
    #[error(
        "{} no answer: check the cable of the device and restart it",
        counted_as(*.readings, "reading since the last sample was", "readings since the last sample were")
    )]
    Garbage { readings: u32 },
    /// The device refused a query.
    #[error("the device refused a query with code {code}: check its settings")]
    Refused { code: u8 },
    /// The serial line cannot be read or written.
    #[error("{0}: open the line anew")]
    Line(LineError),
}

/// Why a device could not be brought up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DeviceError {
    /// No byte was received.
    #[error("no answer, waited {waited:.1?}: check supply and cable of the device, and its baud rate")]
    Absent { waited: Duration },
    /// Bytes were received, but no valid answer.
    #[error(
        "{} and no valid answer: check the baud rate and the device on the line",
        counted(*.bytes, "byte")
    )]
    Garbled { bytes: u32 },
    /// The device refused the query.
    #[error("the device refused the query with code {code}: check its settings")]
    Refused { code: u8 },
    #[error("{0}")]
    Line(LineError),
}

/// A fault as two words: its kind and its number. Kind 0 is no fault.
pub(super) fn words(fault: Option<DeviceFault>) -> [u64; 2] {
    match fault {
        None => [0, 0],
        Some(DeviceFault::NotStarted) => [1, 0],
        Some(DeviceFault::Ended) => [2, 0],
        Some(DeviceFault::Silent { samples }) => [3, u64::from(samples)],
        Some(DeviceFault::Garbage { readings }) => [4, u64::from(readings)],
        Some(DeviceFault::Refused { code }) => [5, u64::from(code)],
        Some(DeviceFault::Line(LineError::Gone)) => [6, 0],
        Some(DeviceFault::Line(LineError::Os(number))) => [7, u64::from(number.cast_unsigned())],
    }
}

/// The fault that [`words`] has encoded.
pub(super) fn of_words([kind, number]: [u64; 2]) -> Option<DeviceFault> {
    Some(match kind {
        0 => return None,
        2 => DeviceFault::Ended,
        3 => DeviceFault::Silent { samples: number as u32 },
        4 => DeviceFault::Garbage { readings: number as u32 },
        5 => DeviceFault::Refused { code: number as u8 },
        6 => DeviceFault::Line(LineError::Gone),
        7 => DeviceFault::Line(LineError::Os((number as u32).cast_signed())),
        _ => DeviceFault::NotStarted,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_sample_one_reading_and_one_byte_are_singular() {
        let said = [
            DeviceFault::Silent { samples: 1 }.to_string(),
            DeviceFault::Garbage { readings: 1 }.to_string(),
            DeviceError::Garbled { bytes: 1 }.to_string(),
        ];
        let begins =
            ["no answer for 1 sample:", "1 reading since the last sample was no answer", "1 byte and no valid answer"];
        for (said, begin) in said.iter().zip(begins) {
            assert!(said.starts_with(begin), "{said}");
        }
    }

    #[test]
    fn every_fault_survives_its_words() {
        let faults = [
            DeviceFault::NotStarted,
            DeviceFault::Ended,
            DeviceFault::Silent { samples: 4 },
            DeviceFault::Garbage { readings: u32::MAX },
            DeviceFault::Refused { code: 255 },
            DeviceFault::Line(LineError::Gone),
            DeviceFault::Line(LineError::Os(-5)),
        ];
        assert_eq!(of_words(words(None)), None);
        for fault in faults {
            assert_eq!(of_words(words(Some(fault))), Some(fault));
        }
    }
}
