//! The contract of an emulated device on a bus.

use std::any::Any;

use can::{Frame, Instant};

/// A device on a bus, as a function of (state, input, now): no thread, no clock, no socket.
///
/// The caller, which is the virtual bus or a socket loop, guarantees two things: `now` never decreases, and
/// [`handle_timeout`](Device::handle_timeout) is called before any later frame is handed in.
pub trait Device: Any + Send {
    /// Takes a frame that ended on the bus at `now`.
    fn handle(&mut self, frame: &Frame, now: Instant);

    /// The next frame to send, in the device's own queue order. Called until the result is `None`.
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame>;

    /// Time of the next [`handle_timeout`](Device::handle_timeout) that the device requests, if any.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Advances the device's internal time to `now`.
    fn handle_timeout(&mut self, now: Instant);
}
