//! The service commands: who is on a bus, and one thing asked of or told to it.
//!
//! What a command says on the bus is a [`Conversation`], a function of (state, frame, now), so that
//! the tests hold it with emulated drives in virtual time; [`talk`] holds it by the clock.
//!
//! Exit status: 0 done; 1 told, and the node did not do it, or broken off by Ctrl-C; 2 refused, aborted by the node, no
//! answer, or the bus went away.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

pub mod data_sheet;
pub mod decode;
pub mod epos;
pub mod lss;
pub mod monitor;
pub mod nmt;
pub mod pdo_map;
pub mod scan;
pub mod sdo;
pub mod survey;
pub mod talk;
#[cfg(test)]
pub mod tests;
pub mod value;
pub mod words;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Context, bail};
use can::{ControllerState, Instant, Port, clock};
use canopen::{NodeId, Object};
use clap::Args;
use master::sdo::SdoError;

use epos::ServicePort;
use mrroc::bench::bus_port::BusPort;
use mrroc::bench::interfaces::Interface;
use mrroc::cell_file::CellFile;
use mrroc::signals;
use mrroc::streams::say;
use talk::{Conversation, Ended};
use value::Type;

/// Which bus a command speaks on.
#[derive(Args)]
pub struct BusArgs {
    /// The interface: can0, or slcan:PATH for an slcan adapter, such as slcan:/dev/serial/by-id/…; for `sdo`, `nmt` and
    /// `scan` also the service port of one drive: epos2:PATH (RS-232) or epos4:PATH (USB, RS-232),
    /// each with @BAUD behind where it is not the usual one.
    #[arg(long, value_name = "IFACE", required_unless_present = "cell")]
    can: Option<String>,
    /// Bit rate that an slcan adapter is opened at, kbit/s; that of a SocketCAN interface is set by `ip link`.
    /// [default: the cell's, or 1000]
    #[arg(long, value_name = "KBPS")]
    bitrate_kbps: Option<u32>,
    /// A cell file: its bus is spoken on, unless --can names another interface, and its nodes are shown by the names of their axes.
    #[arg(long, value_name = "FILE")]
    cell: Option<PathBuf>,
    /// Which bus of the cell, if it has several.
    #[arg(long, value_name = "NAME", requires = "cell")]
    bus: Option<String>,
}

/// An opened bus.
pub struct Bus {
    port: BusPort,
    /// What it is on.
    interface: Interface,
    /// The cell, and which of its buses this is.
    cell: OfCell,
    /// Set by Ctrl-C.
    interrupted: Arc<AtomicBool>,
}

/// The cell, if one is given, and which of its buses is spoken of.
type OfCell = Option<(CellFile, usize)>;

/// What one drive is reached by.
#[expect(clippy::large_enum_variant, reason = "there is one for each command")]
enum Channel {
    Bus(Bus),
    Drive(Drive),
}

/// A drive on its opened service port.
struct Drive {
    port: ServicePort,
    /// What it is on.
    interface: Interface,
    /// The cell, and which of its buses the drive is on as well.
    cell: OfCell,
    /// Set by Ctrl-C.
    interrupted: Arc<AtomicBool>,
}

impl BusArgs {
    /// Opens the bus.
    pub fn open(&self) -> anyhow::Result<Bus> {
        self.open_by(BusPort::open)
    }

    /// Opens the bus without ever sending.
    pub fn listen(&self) -> anyhow::Result<Bus> {
        self.open_by(BusPort::listen)
    }

    fn open_by(&self, open: fn(&Interface, u32) -> anyhow::Result<BusPort>) -> anyhow::Result<Bus> {
        let (interface, kbps, cell) = self.resolve()?;
        Ok(Bus {
            interrupted: signals::ending_flag()?,
            port: open(&interface, kbps)?,
            interface,
            cell,
        })
    }

    /// Opens the bus or the service port, where an answer may take `timeout`.
    fn open_channel(&self, timeout: Duration) -> anyhow::Result<Channel> {
        let (interface, _, cell) = self.resolve()?;
        let Interface::Epos {
            dialect,
            path,
            baud,
        } = &interface
        else {
            return self.open().map(Channel::Bus);
        };
        Ok(Channel::Drive(Drive {
            interrupted: signals::ending_flag()?,
            port: ServicePort::open(*dialect, path, *baud, timeout)?,
            interface,
            cell,
        }))
    }

    /// What is to be opened, and at which bit rate, kbit/s.
    fn resolve(&self) -> anyhow::Result<(Interface, u32, OfCell)> {
        let cell = match &self.cell {
            Some(path) => {
                let file = CellFile::read(path)?;
                let index = self.index_in(&file)?;
                Some((file, index))
            }
            None => None,
        };
        let of_cell = cell.as_ref().map(|(file, index)| &file.cell.bus[*index]);
        let interface = match (&self.can, of_cell) {
            (Some(given), _) => given,
            (None, Some(bus)) => &bus.interface,
            (None, None) => bail!("--can or --cell must say which bus"),
        };
        let interface = Interface::parse(interface);
        let kbps = self
            .bitrate_kbps
            .or(of_cell.map(|bus| bus.bitrate_kbps))
            .unwrap_or(1000);
        Ok((interface, kbps, cell))
    }

    fn index_in(&self, file: &CellFile) -> anyhow::Result<usize> {
        let buses = &file.cell.bus;
        match &self.bus {
            None if buses.is_empty() => bail!("the cell has no CAN bus"),
            None if buses.len() == 1 => Ok(0),
            None => bail!("the cell has {} buses, say which with --bus", buses.len()),
            Some(name) => buses
                .iter()
                .position(|bus| bus.name == *name)
                .with_context(|| format!("--bus {name}: the cell has no such bus")),
        }
    }
}

impl Bus {
    /// Holds a conversation to its end, or until Ctrl-C.
    fn hold(&mut self, conversation: &mut impl Conversation) -> anyhow::Result<Ended> {
        talk::hold(&mut self.port, conversation, &self.interrupted)
            .with_context(|| self.interface.to_string())
    }

    /// What reports call `node`: the axis's name beside it, where the cell has one.
    fn name_of(&self, node: NodeId) -> String {
        name_of(node, self.cell.as_ref())
    }

    /// Why nobody may have answered.
    fn silence(&self) -> String {
        let counters = self.port.counters();
        let interface = &self.interface;
        match (counters.received, self.port.state()) {
            (1.., _) => format!(
                "{interface} carries other frames, so its bit rate is right: the node has another node-ID, is \
                 switched off, or is stopped (a stopped node answers no SDO)"
            ),
            (0, ControllerState::Active) if counters.errors == 0 => format!(
                "nothing at all is heard on {interface}: wrong bit rate, no power at the nodes, CAN_H and CAN_L \
                 swapped, or no termination"
            ),
            (0, state) => format!(
                "the controller of {interface} is {}: nobody acknowledges its frames. Wrong bit rate, no \
                 termination, or no node with power",
                words::controller_state(state)
            ),
        }
    }
}

impl Channel {
    /// What reports call `node`.
    fn name_of(&self, node: NodeId) -> String {
        match self {
            Self::Bus(bus) => bus.name_of(node),
            Self::Drive(drive) => name_of(node, drive.cell.as_ref()),
        }
    }

    /// Why nobody may have answered.
    fn silence(&self) -> String {
        match self {
            Self::Bus(bus) => bus.silence(),
            Self::Drive(drive) => drive.silence(),
        }
    }
}

impl Drive {
    /// Reads an object of `node`, 0 for the drive itself, or writes `data`; `None` if Ctrl-C came before.
    fn transfer(
        &mut self,
        node: u8,
        object: Object,
        data: Option<&[u8]>,
        ty: Option<Type>,
    ) -> anyhow::Result<Option<Result<Vec<u8>, SdoError>>> {
        self.port
            .transfer(node, object, data, ty, &self.interrupted)
            .with_context(|| self.interface.to_string())
    }

    /// Why it may not have answered.
    fn silence(&self) -> String {
        let interface = &self.interface;
        if self.port.has_heard() {
            format!(
                "{interface} carries bytes that are no answer: wrong baud rate, or the drive is another kind of EPOS"
            )
        } else {
            format!(
                "nothing at all is heard on {interface}: wrong baud rate, no power at the drive, RX and TX swapped, or \
                 another kind of EPOS"
            )
        }
    }
}

fn name_of(node: NodeId, cell: Option<&(CellFile, usize)>) -> String {
    let axis = cell.and_then(|(file, bus)| {
        let on_bus =
            |&(robot, axis): &(usize, usize)| file.cell.robot[robot].axis[axis].node == node.raw();
        let (robot, axis) = file.cell.axes_on(*bus).find(on_bus)?;
        Some(file.axis_name(robot, axis))
    });
    match axis {
        Some(axis) => format!("node {node} ({axis})"),
        None => format!("node {node}"),
    }
}

/// Broken off by Ctrl-C.
fn interrupted() -> ExitCode {
    ExitCode::from(1)
}

/// Now, by the clock of the conversations.
fn now() -> Instant {
    clock::now()
}

fn milliseconds(count: u64) -> Duration {
    Duration::from_millis(count)
}

/// A node-ID on the command line.
fn node_id(text: &str) -> Result<NodeId, String> {
    let raw = text.parse().map_err(|_| "a node-ID is a number")?;
    NodeId::new(raw).ok_or_else(|| "node-IDs are 1 to 127".to_owned())
}
