//! [`Port`], the interface of drivers to a CAN bus, with its counters and errors.

use thiserror::Error;

use crate::timing::bits_on_wire;
use crate::{Frame, Instant};

/// One end of a CAN bus: a SocketCAN interface, an slcan adapter, or the virtual bus, which may play a recording.
///
/// No method waits. A driver cannot tell the implementations apart.
pub trait Port: Send {
    /// Passes `frames` to the CAN controller in order and returns the number accepted. If fewer than all are accepted,
    /// the caller drops the others or offers them again.
    ///
    /// At most one system call.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError>;

    /// Fills `into` from the front with the frames that have arrived, and returns their number. A virtual port
    /// returns no frame later than `now`.
    ///
    /// At most one read; an slcan adapter may write first. Error frames appear only in the counters and the state.
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError>;

    /// Bounds the frames in flight: from now on [`send`](Self::send) accepts no frame while more than `most` frames
    /// that it accepted earlier wait for the bus, as on a bus without acknowledgement. `usize::MAX` removes the bound.
    ///
    /// A port that does not learn when a frame was transmitted, such as an slcan adapter, ignores the bound. If the call fails,
    /// frames in flight are not bounded, and the caller must not start motion.
    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        let _ = most;
        Ok(())
    }

    /// Counters since the port was opened.
    fn counters(&self) -> Counters;

    /// Fault confinement state that the CAN controller reported last.
    fn state(&self) -> ControllerState;
}

impl<P: Port + ?Sized> Port for Box<P> {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        (**self).send(now, frames)
    }
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        (**self).receive(now, into)
    }
    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        (**self).bound_unsent(most)
    }
    fn counters(&self) -> Counters {
        (**self).counters()
    }
    fn state(&self) -> ControllerState {
        (**self).state()
    }
}

/// A received frame with its time: the end of its last bit on the virtual bus, the kernel's time stamp on SocketCAN,
/// the time of the read on an slcan adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: Frame,
    /// Time of reception.
    pub at: Instant,
}

/// Errors of sending and receiving.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum PortError {
    /// The interface is down (`ENETDOWN`). The port works again once the interface is up.
    #[error("interface is down")]
    Down,
    /// The interface or the line was removed (`ENODEV`, `ENXIO`). The caller must open a new port.
    #[error("interface was removed")]
    Gone,
    /// Any other error of the operating system, with its `errno`.
    #[error("{}", std::io::Error::from_raw_os_error(*.0))]
    Os(i32),
}

/// Counters of a port. The counters never decrease.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames accepted for sending.
    pub sent: u64,
    /// Frames received.
    pub received: u64,
    /// Frames passed to [`Port::send`] and not accepted, or refused by an slcan adapter.
    pub refused: u64,
    /// Received frames lost before they were read, such as by an overflow of the receive queue (`SO_RXQ_OVFL`).
    pub dropped: u64,
    /// Error frames, or error reports of an slcan adapter.
    pub errors: u64,
    /// Times that the controller became error passive.
    pub passive: u64,
    /// Times that the controller went bus off.
    pub bus_off: u64,
    /// Bits on the wire of all frames sent and received, with stuff bits and intermissions.
    pub bits: u64,
}

impl Counters {
    /// Counts frames accepted for sending.
    pub fn count_sent(&mut self, frames: &[Frame]) {
        self.sent += frames.len() as u64;
        self.bits += frames.iter().map(bits).sum::<u64>();
    }

    /// Counts a change of the controller's state.
    pub fn count_state(&mut self, before: ControllerState, state: ControllerState) {
        self.passive += u64::from(before < ControllerState::Passive && state == ControllerState::Passive);
        self.bus_off += u64::from(before != state && state == ControllerState::BusOff);
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

/// Fault confinement state of a CAN controller (ISO 11898-1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum ControllerState {
    /// Error active, with both error counters below 96.
    #[default]
    Active,
    /// Error active, with an error counter of 96 or more.
    Warning,
    /// Error passive: an error counter exceeds 127. The controller sends only passive error flags.
    Passive,
    /// Bus off: the transmit error counter exceeds 255. The controller no longer takes part in the bus.
    BusOff,
}
