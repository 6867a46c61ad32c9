//! The contract of a port: one end of a bus.

use thiserror::Error;

use crate::timing::bits_on_wire;
use crate::{Frame, Instant};

/// One end of a bus: a SocketCAN interface, or an end of the virtual bus.
///
/// Neither call waits. A driver cannot tell which of the implementors it has, nor a recording from
/// either.
pub trait Port: Send {
    /// Hands `frames` to the controller in order and returns how many it took: fewer than all of
    /// them means back-pressure, and the rest is the caller's to drop or to offer again.
    ///
    /// At most one system call.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError>;

    /// Fills `into` from the front with what has arrived by `now` and returns how many there are.
    ///
    /// At most one system call. Error frames are consumed here and show in [`Port::counters`].
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError>;

    /// What this port has counted since it was opened.
    fn counters(&self) -> Counters;

    /// What the controller last said of its own health.
    fn state(&self) -> ControllerState;
}

impl<P: Port + ?Sized> Port for Box<P> {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        (**self).send(now, frames)
    }
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        (**self).receive(now, into)
    }
    fn counters(&self) -> Counters {
        (**self).counters()
    }
    fn state(&self) -> ControllerState {
        (**self).state()
    }
}

/// A frame and when it was received: at the end of its last bit on the virtual bus, at the
/// kernel's receive time stamp on SocketCAN.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: Frame,
    /// When it was received.
    pub at: Instant,
}

/// Why a port could not send or receive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum PortError {
    /// The interface is down (`ENETDOWN`); the same port works again once it is up.
    #[error("interface is down")]
    Down,
    /// The interface was removed (`ENODEV`, `ENXIO`); the port must be opened anew.
    #[error("interface was removed")]
    Gone,
    /// Anything else the operating system said.
    #[error("errno {0}")]
    Os(i32),
}

/// What a port counts. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames taken for sending.
    pub sent: u64,
    /// Frames received.
    pub received: u64,
    /// Frames offered to [`Port::send`] and not taken.
    pub refused: u64,
    /// Frames the kernel or the receive queue dropped before we read them (`SO_RXQ_OVFL`).
    pub dropped: u64,
    /// Error frames received.
    pub errors: u64,
    /// Bits that the frames sent and received took on the wire, intermissions included.
    pub bits: u64,
}

impl Counters {
    /// Counts frames taken for sending.
    pub fn count_sent(&mut self, frames: &[Frame]) {
        self.sent += frames.len() as u64;
        self.bits += frames.iter().map(bits).sum::<u64>();
    }

    /// Counts frames received.
    pub fn count_received(&mut self, received: &[Received]) {
        self.received += received.len() as u64;
        let frames = received.iter().map(|received| &received.frame);
        self.bits += frames.map(bits).sum::<u64>();
    }
}

fn bits(frame: &Frame) -> u64 {
    bits_on_wire(frame).into()
}

/// The fault confinement state of a CAN controller (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum ControllerState {
    /// Takes full part in the bus.
    #[default]
    Active,
    /// An error counter passed 96.
    Warning,
    /// An error counter passed 127; it may no longer destroy others' frames.
    Passive,
    /// The transmit error counter passed 255; it has left the bus.
    BusOff,
}
