//! The service commands: search for nodes, access to objects, device configuration files, NMT commands, LSS and a
//! monitor.
//!
//! The protocol of a command is a `Conversation`, a function of (state, frame, now). The tests run conversations with
//! emulated drives in virtual time; [`talk`] runs them on the wall clock.
//!
//! Exit status: 0 done; 1 the node did not obey a command, or Ctrl-C; 2 refused, aborted by the node, no answer, or the
//! bus was lost.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

pub mod data_sheet;
pub mod dcf;
pub mod decode;
pub mod epos;
pub mod lss;
pub mod monitor;
pub mod nmt;
pub mod pdo_map;
pub mod scan;
pub mod sdo;
pub mod stop;
pub mod survey;
pub mod talk;
#[cfg(test)]
pub mod tests;
pub mod value;
pub mod words;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Context, bail};
use can::Port;
use canopen::{NodeId, Object};
use clap::Args;
use master::sdo::SdoError;
use thiserror::Error;

use epos::ServicePort;
use mrroc::bench::bus_port::BusPort;
use mrroc::bench::interfaces::Interface;
use mrroc::bench::silence;
use mrroc::cell::CellFile;
use mrroc::signals;
use mrroc::streams::say;
use talk::Conversation;
use value::Type;

/// Options that select the bus of a command.
#[derive(Args)]
pub struct BusArgs {
    /// The interface. A CAN interface such as can0. An slcan adapter: slcan:PATH, such as slcan:/dev/serial/by-id/NAME.
    /// For `sdo`, `nmt` and `scan` also the service port of one drive: epos2:PATH (RS-232) or epos4:PATH (USB, RS-232).
    /// An appended @BAUD replaces the usual baud rate.
    #[arg(long, value_name = "IFACE", required_unless_present = "cell")]
    can: Option<String>,
    /// Bit rate of an slcan adapter, kbit/s. The bit rate of a SocketCAN interface is set with `ip link`. [default: the
    /// cell's, or 1000]
    #[arg(long, value_name = "KBPS")]
    bitrate_kbps: Option<u32>,
    /// A cell file. The command uses the bus of the cell, unless --can names another interface. Nodes are shown with
    /// the names of their axes.
    #[arg(long, value_name = "FILE")]
    cell: Option<PathBuf>,
    /// The bus of the cell, if the cell has several.
    #[arg(long, value_name = "NAME", requires = "cell")]
    bus: Option<String>,
}

/// An open port: a bus, or the service port of one drive.
pub struct Open<P> {
    port: P,
    interface: Interface,
    /// The cell, and the index of the bus, which the drive is also on.
    cell: OfCell,
    /// Set by Ctrl-C.
    interrupted: Arc<AtomicBool>,
}

/// An open bus.
pub type Bus = Open<BusPort>;

/// A drive on its open service port.
type Drive = Open<ServicePort>;

/// Ctrl-C ended a command early. The exit status is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("interrupted")]
pub struct Interrupted;

/// The cell, if given, and the index of the bus in it.
type OfCell = Option<(CellFile, usize)>;

/// Connection to the nodes of a bus, or to one drive.
#[expect(clippy::large_enum_variant, reason = "there is one for each command")]
enum Channel {
    Bus(Bus),
    Drive(Drive),
}

impl BusArgs {
    /// Opens the bus.
    pub fn open(&self) -> anyhow::Result<Bus> {
        self.open_by(BusPort::open)
    }

    /// Opens the bus for listening only. The interface never sends.
    pub fn listen(&self) -> anyhow::Result<Bus> {
        self.open_by(BusPort::listen)
    }

    fn open_by<P>(&self, open: impl FnOnce(&Interface, u32) -> anyhow::Result<P>) -> anyhow::Result<Open<P>> {
        let (interface, kbps, cell) = self.resolve()?;
        Ok(Open { interrupted: signals::ending_flag()?, port: open(&interface, kbps)?, interface, cell })
    }

    /// Opens the bus or the service port. On a service port, `timeout` limits the time to an answer.
    fn open_channel(&self, timeout: Duration) -> anyhow::Result<Channel> {
        let (interface, ..) = self.resolve()?;
        let Interface::Epos { dialect, path, baud } = interface else {
            return self.open().map(Channel::Bus);
        };
        self.open_by(|_, _| ServicePort::open(dialect, &path, baud, timeout)).map(Channel::Drive)
    }

    /// The interface to open, its bit rate, kbit/s, and the cell.
    fn resolve(&self) -> anyhow::Result<(Interface, u32, OfCell)> {
        let read = |path: &PathBuf| {
            let file = CellFile::read(path)?;
            let index = self.index_in(&file)?;
            anyhow::Ok((file, index))
        };
        let cell = self.cell.as_ref().map(read).transpose()?;
        let of_cell = cell.as_ref().map(|(file, index)| &file.cell.bus[*index]);
        let interface = self.can.as_ref().or(of_cell.map(|bus| &bus.interface));
        let interface = Interface::parse(interface.context("--can or --cell must say which bus")?);
        let kbps = self.bitrate_kbps.or(of_cell.map(|bus| bus.bitrate_kbps)).unwrap_or(1000);
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

impl<P> Open<P> {
    /// Name of `node` in reports, with the name of its axis, I/O node or force sensor if the cell has one.
    fn name_of(&self, node: NodeId) -> String {
        name_in(self.cell.as_ref().map(|(file, bus)| (file, *bus)), node)
    }
}

/// Name of `node` of a bus of a cell in reports.
fn name_in(cell: Option<(&CellFile, usize)>, node: NodeId) -> String {
    let name = cell.and_then(|(file, bus)| {
        let is_node = |&(robot, axis): &(usize, usize)| file.cell.robot[robot].axis[axis].node == node.raw();
        let axis = file.cell.axes_on(bus).find(is_node).map(|(robot, axis)| file.axis_name(robot, axis));
        let mut io = file.cell.io_on(bus).map(|io| &file.cell.io[io]);
        let mut sensors = file.cell.sensors_on(bus);
        let is_sensor = |sensor: &usize| file.cell.node_of_sensor(*sensor) == Some(node.raw());
        let io = io.find(|io| io.node == node.raw()).map(|io| io.name.clone());
        let sensor = || Some(file.cell.force_sensor[sensors.find(is_sensor)?].name.clone());
        axis.or(io).or_else(sensor)
    });
    let name = name.map(|name| format!(" ({name})"));
    format!("node {node}{}", name.unwrap_or_default())
}

impl Bus {
    /// Runs a conversation until its end. The error after Ctrl-C is [`Interrupted`].
    fn hold(&mut self, conversation: &mut impl Conversation) -> anyhow::Result<()> {
        let ended =
            talk::hold(&mut self.port, conversation, &self.interrupted).with_context(|| self.interface.to_string())?;
        Ok(ended?)
    }

    /// Possible reasons why no node answered.
    fn silence(&self) -> String {
        silence::reasons(&self.interface, self.port.counters(), self.port.state())
    }
}

impl Drive {
    /// Reads an object of `node`, or writes `data` into it. Node 0 is the drive on a service port.
    fn transfer(
        &mut self,
        node: u8,
        object: Object,
        data: Option<&[u8]>,
        ty: Option<Type>,
    ) -> anyhow::Result<Result<Vec<u8>, SdoError>> {
        self.port.transfer(node, object, data, ty, &self.interrupted).with_context(|| self.interface.to_string())
    }

    /// Possible reasons why the drive did not answer.
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

/// A node-ID on the command line.
fn node_id(text: &str) -> Result<NodeId, String> {
    let raw = text.parse().map_err(|_| "a node-ID is a number")?;
    NodeId::new(raw).ok_or_else(|| "node-IDs are 1 to 127".to_owned())
}
