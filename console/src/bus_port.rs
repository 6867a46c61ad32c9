//! A bus of the real world: a SocketCAN interface or an slcan adapter.

use anyhow::bail;
use can::{
    ControllerState, Counters, Frame, Instant, Port, PortError, Received, SocketCanOptions,
    SocketCanPort,
};

use crate::interfaces::Interface;

/// A port that can be waited for.
pub(crate) enum BusPort {
    SocketCan(SocketCanPort),
}

impl BusPort {
    /// Opens an interface; `kbps` is the bit rate that an slcan adapter is set to.
    pub(crate) fn open(interface: &Interface, kbps: u32) -> anyhow::Result<Self> {
        Self::with_options(interface, kbps, &SocketCanOptions::default())
    }

    /// The same, with `options` where it is a SocketCAN interface.
    pub(crate) fn with_options(
        interface: &Interface,
        _kbps: u32,
        options: &SocketCanOptions,
    ) -> anyhow::Result<Self> {
        match interface {
            Interface::SocketCan(name) => Ok(Self::SocketCan(SocketCanPort::open(name, options)?)),
            Interface::Slcan(path) => bail!("{path}: slcan adapters are not served"),
        }
    }

    /// Waits until there is something to receive or the clock shows `until`, and says which.
    pub(crate) fn wait_readable(&self, until: Instant) -> Result<bool, PortError> {
        match self {
            Self::SocketCan(port) => port.wait_readable(until),
        }
    }
}

impl Port for BusPort {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        match self {
            Self::SocketCan(port) => port.send(now, frames),
        }
    }
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        match self {
            Self::SocketCan(port) => port.receive(now, into),
        }
    }
    fn counters(&self) -> Counters {
        match self {
            Self::SocketCan(port) => port.counters(),
        }
    }
    fn state(&self) -> ControllerState {
        match self {
            Self::SocketCan(port) => port.state(),
        }
    }
}
