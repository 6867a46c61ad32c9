//! The notation of interfaces, and which of them each bus of a cell is on.

use std::fmt;

use anyhow::{Context, bail};
use controller::cell::Cell;

/// What begins the name of an slcan adapter.
const SLCAN: &str = "slcan:";

/// An interface by the name that options and cell files give it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Interface {
    /// That of SocketCAN, such as `can0`.
    SocketCan(String),
    /// An slcan adapter on the tty at this path: `slcan:/dev/ttyACM0`.
    Slcan(String),
}

impl Interface {
    /// Whatever does not begin with `slcan:` is SocketCAN's.
    pub(crate) fn parse(name: &str) -> Self {
        match name.strip_prefix(SLCAN) {
            Some(path) => Self::Slcan(path.to_owned()),
            None => Self::SocketCan(name.to_owned()),
        }
    }

    /// What a candump log calls the interface, as bus `bus` of the cell: paths are too long for it.
    pub(crate) fn log_name(&self, bus: usize) -> String {
        match self {
            Self::SocketCan(name) => name.clone(),
            Self::Slcan(_) => format!("slcan{bus}"),
        }
    }
}

impl fmt::Display for Interface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SocketCan(name) => f.write_str(name),
            Self::Slcan(path) => write!(f, "{SLCAN}{path}"),
        }
    }
}

/// The interface of each bus, in the cell's order: the cell's own, or as `overrides` say.
///
/// An override is `IFACE` for a cell of one bus, or `BUS=IFACE`.
pub(crate) fn resolve(cell: &Cell, overrides: &[String]) -> anyhow::Result<Vec<Interface>> {
    let of_cell = cell.bus.iter().map(|bus| Interface::parse(&bus.interface));
    let mut interfaces: Vec<_> = of_cell.collect();
    for given in overrides {
        let (index, interface) = match given.split_once('=') {
            Some((name, interface)) => {
                let index = cell.bus.iter().position(|bus| bus.name == name);
                (
                    index
                        .with_context(|| format!("--can {given}: the cell has no bus {name:?}"))?,
                    interface,
                )
            }
            None if cell.bus.len() == 1 => (0, given.as_str()),
            None => bail!(
                "--can {given}: the cell has {} buses, say which as BUS=IFACE",
                cell.bus.len()
            ),
        };
        interfaces[index] = Interface::parse(interface);
    }
    Ok(interfaces)
}
