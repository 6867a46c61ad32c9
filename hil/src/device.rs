//! The contract of an emulated device on a bus.

use std::any::Any;

use can::{Frame, Instant};

/// A device on a bus, as a function of (state, input, now): no thread, no clock, no socket.
///
/// Its host, the virtual bus or a socket loop, keeps the promise that `now` never decreases and
/// that [`handle_timeout`](Device::handle_timeout) is called no later than any later frame is handed in.
pub trait Device: Any + Send {
    /// Takes a frame that ended on the bus at `now`.
    fn handle(&mut self, frame: &Frame, now: Instant);

    /// The next frame it wants to send, in its own queue order; called until it says `None`.
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame>;

    /// When it next wants [`handle_timeout`](Device::handle_timeout), if it does.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Advances its inner time to `now`.
    fn handle_timeout(&mut self, now: Instant);
}
