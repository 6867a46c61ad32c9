//! A real bus: a SocketCAN interface or an slcan adapter, and the card of an interface before a run.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::os::fd::{AsFd, BorrowedFd};
use std::task::Poll;

use anyhow::{Context, bail};
use can::card::{self, Card, CardError, CardState};
use can::timing::Bitrate;
use can::{
    Claim, ControllerState, Counters, Frame, Instant, Port, PortError, Received, SocketCanOptions, SocketCanPort, clock,
};
use serial::{Settings, SlcanError, SlcanPort, StopBits, Tty};

use crate::{bench::interfaces::Interface, cell::Bus};

/// A port that supports waiting.
pub enum BusPort {
    /// A SocketCAN interface, and the claims of this process on it.
    SocketCan(SocketCanPort, Vec<Claim>),
    /// An slcan adapter, whose tty no other process can open.
    Slcan(SlcanPort<Tty>),
}

impl BusPort {
    /// Opens an interface. `kbps` is the bit rate for an slcan adapter.
    pub fn open(interface: &Interface, kbps: u32) -> anyhow::Result<Self> {
        Self::with_options(interface, kbps, &SocketCanOptions::default())
    }

    /// Opens an interface for listening only. An slcan adapter then does not disturb the bus, even at a wrong bit
    /// rate.
    pub fn listen(interface: &Interface, kbps: u32) -> anyhow::Result<Self> {
        match interface {
            Interface::SocketCan(_) | Interface::Epos { .. } => Self::open(interface, kbps),
            Interface::Slcan { path, baud } => Self::slcan(path, *baud, kbps, SlcanPort::listening),
        }
    }

    /// Opens an interface with `options` for SocketCAN. An slcan adapter gets 0.9 s to answer.
    pub fn with_options(interface: &Interface, kbps: u32, options: &SocketCanOptions) -> anyhow::Result<Self> {
        match interface {
            Interface::SocketCan(name) => Ok(Self::SocketCan(SocketCanPort::open(name, options)?, Vec::new())),
            Interface::Slcan { path, baud } => Self::slcan(path, *baud, kbps, SlcanPort::new),
            Interface::Epos { .. } => bail!(
                "{interface}: the service port of a drive is no CAN bus; `mrroc sdo`, `mrroc nmt` and `mrroc scan` \
                 speak to it"
            ),
        }
    }

    /// The same port with `claims`, which are released when the port is closed.
    pub fn holding(mut self, claims: impl IntoIterator<Item = Claim>) -> Self {
        if let Self::SocketCan(_, held) = &mut self {
            held.extend(claims);
        }
        self
    }

    fn slcan(path: &str, baud: u32, kbps: u32, begin: Begin) -> anyhow::Result<Self> {
        let tty = Tty::open(path, Settings { baud, stop_bits: StopBits::One })?;
        open_slcan(tty, kbps, begin).map(Self::Slcan).context(path.to_owned())
    }

    /// Waits until a frame can be received or the clock shows `until`. Returns whether a frame can be received.
    pub fn wait_readable(&self, until: Instant) -> Result<bool, PortError> {
        match self {
            Self::SocketCan(port, _) => port.wait_readable(until),
            Self::Slcan(port) => clock::wait_readable(port.line().as_fd(), until).map_err(PortError::Os),
        }
    }

    fn port(&self) -> &dyn Port {
        match self {
            Self::SocketCan(port, _) => port,
            Self::Slcan(port) => port,
        }
    }

    fn port_mut(&mut self) -> &mut dyn Port {
        match self {
            Self::SocketCan(port, _) => port,
            Self::Slcan(port) => port,
        }
    }
}

/// Starts to open an adapter, for sending or for listening only.
type Begin = fn(Tty, Bitrate, Instant) -> Result<SlcanPort<Tty>, SlcanError>;

fn bitrate(kbps: u32) -> anyhow::Result<Bitrate> {
    Bitrate::from_kbps(kbps).with_context(|| format!("{kbps} kbit/s is no bit rate of CAN, 10 to 1000 kbit/s"))
}

fn open_slcan(tty: Tty, kbps: u32, begin: Begin) -> anyhow::Result<SlcanPort<Tty>> {
    let mut port = begin(tty, bitrate(kbps)?, clock::now())?;
    loop {
        if let Poll::Ready(result) = port.poll_open(clock::now()) {
            return result.map(|()| port).map_err(Into::into);
        }
        let until = port.poll_timeout().expect("it has a deadline while it is being opened");
        clock::wait_readable(port.line().as_fd(), until).map_err(PortError::Os)?;
    }
}

impl AsFd for BusPort {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::SocketCan(port, _) => port.as_fd(),
            Self::Slcan(port) => port.line().as_fd(),
        }
    }
}

impl Port for BusPort {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        self.port_mut().send(now, frames)
    }
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        self.port_mut().receive(now, into)
    }
    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        self.port_mut().bound_unsent(most)
    }
    fn counters(&self) -> Counters {
        self.port().counters()
    }
    fn state(&self) -> ControllerState {
        self.port().state()
    }
}

/// Ensures that the card of `bus` has the cell's bit rate: sets the bit rate, or refuses a different one.
///
/// An slcan adapter is set whenever it is opened, and a virtual interface has no bit rate to compare.
pub(super) fn prepare_card(interface: &Interface, bus: &Bus, set: bool) -> anyhow::Result<()> {
    let Interface::SocketCan(name) = interface else {
        return Ok(());
    };
    let kbps = bus.bitrate_kbps;
    if set {
        let card = card::set_bitrate(name, bitrate(kbps)?)?;
        crate::streams::warn(format_args!("bus {}: {name} {}", bus.name, described(&card)));
        return Ok(());
    }
    let card = match card::read(name) {
        Err(CardError::NotCard(_)) => return Ok(()),
        card => card?,
    };
    match card.bitrate {
        Some(found) if u64::from(found) != u64::from(kbps) * 1000 => bail!(
            "{name}: the card is at {} kbit/s, the cell's bus at {kbps} kbit/s: --set-bitrate sets it",
            f64::from(found) / 1000.0
        ),
        _ if card.state == CardState::BusOff => bail!(
            "{name}: the card is off the bus after too many errors: mend the bus, then \
             `ip link set {name} type can restart`"
        ),
        _ => Ok(()),
    }
}

/// Description of the settings that were read back.
fn described(card: &Card) -> String {
    let state = match card.state {
        CardState::Running => "running",
        CardState::BusOff => "bus-off",
        CardState::Stopped => "stopped",
    };
    format!(
        "is {state} at {} kbit/s, sample point {} %",
        f64::from(card.bitrate.unwrap_or(0)) / 1000.0,
        f64::from(card.sample_point.unwrap_or(0)) / 10.0
    )
}
