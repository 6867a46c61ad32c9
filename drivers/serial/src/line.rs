//! Interface of a serial line.

use std::time::Duration;

use can::Instant;
use thiserror::Error;
pub use tokio_serial::StopBits;

/// One end of a serial line: a tty, or an end of a virtual line.
///
/// Neither call waits. Drivers do not depend on the implementation.
pub trait Line: Send {
    /// Writes `bytes` in order and returns the number of accepted bytes. A smaller number than the length means
    /// back-pressure. The caller drops the other bytes or offers them again.
    ///
    /// At most one system call.
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError>;

    /// Fills `into` from the front with the bytes that have arrived by `now`. Returns their number.
    ///
    /// At most one system call.
    fn read(&mut self, now: Instant, into: &mut [u8]) -> Result<usize, LineError>;

    /// Discards the bytes that wait for transmission, so that they do not delay later bytes. A telegram on the wire may
    /// be cut. A line without a buffer has nothing to discard.
    ///
    /// At most one system call.
    fn discard_unsent(&mut self) {}

    /// Counters of this line since it was opened.
    fn counters(&self) -> LineCounters;
}

impl<L: Line + ?Sized> Line for Box<L> {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        (**self).write(now, bytes)
    }
    fn read(&mut self, now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        (**self).read(now, into)
    }
    fn discard_unsent(&mut self) {
        (**self).discard_unsent();
    }
    fn counters(&self) -> LineCounters {
        (**self).counters()
    }
}

/// Reason why a line could not be written or read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum LineError {
    /// The device was unplugged, or its other end was closed. The line must be opened again.
    #[error("line is gone")]
    Gone,
    /// Any other error of the operating system.
    #[error("{}", std::io::Error::from_raw_os_error(*.0))]
    Os(i32),
}

/// Counters of a line, which only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineCounters {
    /// Bytes accepted for transmission.
    pub sent: u64,
    /// Bytes received.
    pub received: u64,
    /// Bytes offered to [`Line::write`] and not accepted.
    pub refused: u64,
    /// Bytes lost before they were read, as far as the line knows.
    pub dropped: u64,
}

/// Settings of a line. All lines have 8 data bits, no parity and no flow control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Bits per second.
    pub baud: u32,
    /// Stop bits of a byte.
    pub stop_bits: StopBits,
}

impl Settings {
    /// Axis controllers of the IRb-6 and IRp-6: 921600 8N2.
    pub const AXIS_CONTROLLER: Self = Self { baud: 921_600, stop_bits: StopBits::Two };

    /// Factory setting of maxon EPOS2 and EPOS4: 115200 8N1.
    pub const EPOS: Self = Self { baud: 115_200, stop_bits: StopBits::One };

    /// Bits of a byte on the line, start and stop bits included.
    pub const fn bits_per_byte(self) -> u64 {
        match self.stop_bits {
            StopBits::One => 10,
            StopBits::Two => 11,
        }
    }

    /// The time that `count` bytes take on the line, start and stop bits included, rounded up.
    pub const fn line_time(self, count: usize) -> Duration {
        let bits = self.bits_per_byte() * count as u64;
        let nanoseconds = (bits * 1_000_000_000).div_ceil(self.baud as u64);
        Duration::from_nanos(nanoseconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_takes_its_start_data_and_stop_bits() {
        let nanoseconds = |settings: Settings, count| settings.line_time(count).as_nanos();
        assert_eq!(nanoseconds(Settings::AXIS_CONTROLLER, 1), 11_936);
        assert_eq!(nanoseconds(Settings::AXIS_CONTROLLER, 14 + 19), 393_881);
        assert_eq!(nanoseconds(Settings::EPOS, 1), 86_806);
        assert_eq!(nanoseconds(Settings::EPOS, 0), 0);
    }
}
