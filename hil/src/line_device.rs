//! The contract of an emulated device on a serial line.

use std::any::Any;

use can::Instant;

/// A device on a serial line, as a function of (bytes, now): no thread, no clock, no tty.
///
/// The line keeps the promise that `now` never decreases and that
/// [`handle_timeout`](LineDevice::handle_timeout) is called no later than any later byte is handed in.
pub trait LineDevice: Any + Send {
    /// Takes a byte whose last stop bit ended at `now`.
    fn receive(&mut self, byte: u8, now: Instant);

    /// The next byte it sends, asked for whenever the line towards the host falls free; with `None`
    /// it stays free until a byte or a time-out gave the device something to say.
    fn poll_transmit(&mut self, now: Instant) -> Option<u8>;

    /// When it next wants [`handle_timeout`](LineDevice::handle_timeout), if it does.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Advances its inner time to `now`.
    fn handle_timeout(&mut self, now: Instant);
}
