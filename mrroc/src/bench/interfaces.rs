//! The notation of interfaces, and the interface of each bus of a cell.

use std::fmt;

use anyhow::{Context, bail};
use can::{Claim, ClaimError, Holder};
use serial::service::Dialect;

use crate::cell::{Cell, quoted};

const SLCAN: &str = "slcan:";

/// Prefixes of the name of a service port.
const EPOS: [(&str, Dialect); 2] = [("epos2:", Dialect::Epos2), ("epos4:", Dialect::Epos4)];

/// Baud rate of a tty whose name has none: the factory setting of service ports. Adapters and drives with a USB port
/// of their own ignore the rate.
const BAUD: u32 = 115_200;

/// The part of an interface that its bus's controller plays.
const CONTROLLER: &str = "controller";

/// An interface by the name that options and cell files give it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Interface {
    /// A SocketCAN interface, such as `can0`.
    SocketCan(String),
    /// An slcan adapter on a tty: `slcan:/dev/ttyACM0`, or `slcan:/dev/ttyUSB0@921600`.
    Slcan {
        /// The tty.
        path: String,
        /// Baud rate, bit/s.
        baud: u32,
    },
    /// The service port of one drive on a tty, which is not a bus: `epos2:/dev/ttyS0@38400`, `epos4:/dev/ttyACM0`.
    Epos {
        /// Protocol dialect of the drive.
        dialect: Dialect,
        /// The tty.
        path: String,
        /// Baud rate, bit/s.
        baud: u32,
    },
}

impl Interface {
    /// Parses a name. A name without the prefix `slcan:`, `epos2:` or `epos4:` is a SocketCAN interface.
    pub fn parse(name: &str) -> Self {
        if let Some(tty) = name.strip_prefix(SLCAN) {
            let (path, baud) = tty_of(tty);
            return Self::Slcan { path, baud };
        }
        for (prefix, dialect) in EPOS {
            if let Some(tty) = name.strip_prefix(prefix) {
                let (path, baud) = tty_of(tty);
                return Self::Epos { dialect, path, baud };
            }
        }
        Self::SocketCan(name.to_owned())
    }

    /// Claims the interface for the only controller of its bus; `None` for a tty, which only one process can open. A
    /// controller on another computer is detected by its frames only.
    pub fn claim_as_controller(&self) -> anyhow::Result<Option<Claim>> {
        self.claim(CONTROLLER, "another controller is at work")
    }

    /// The process of this computer that is the controller of the interface's bus; `None` for a tty.
    pub fn controller(&self) -> Result<Option<Holder>, ClaimError> {
        match self {
            Self::SocketCan(name) => Claim::player(name, CONTROLLER),
            Self::Slcan { .. } | Self::Epos { .. } => Ok(None),
        }
    }

    /// Claims node `node` of the interface for its only emulator; `None` for a tty.
    pub fn claim_as_node(&self, node: u8) -> anyhow::Result<Option<Claim>> {
        let taken = format!("node {node} is emulated already");
        self.claim(&format!("node {node}"), &taken)
    }

    fn claim(&self, part: &str, taken: &str) -> anyhow::Result<Option<Claim>> {
        let Self::SocketCan(name) = self else {
            return Ok(None);
        };
        match Claim::take(name, part) {
            Ok(claim) => Ok(Some(claim)),
            Err(ClaimError::Taken { holder, .. }) => {
                let holder = holder.map(|process| format!(": process {process}"));
                bail!("{name}: {taken}{}", holder.unwrap_or_default())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Refuses impossible names of interfaces.
    pub fn check(&self) -> anyhow::Result<()> {
        match self {
            Self::SocketCan(name) if can::InterfaceName::new(name).is_none() => bail!(
                "{} is no interface: 1 to 15 bytes without white space, slash or colon, or slcan:PATH",
                quoted(name)
            ),
            Self::Slcan { path, .. } | Self::Epos { path, .. }
                if path.is_empty() || path.contains(char::is_control) =>
            {
                bail!("{} names no tty", quoted(&self.to_string()))
            }
            Self::SocketCan(_) | Self::Slcan { .. } | Self::Epos { .. } => Ok(()),
        }
    }

    /// Name of the interface in a candump log. The name of a tty contains `bus`, the index of the bus in the cell,
    /// because the path would be too long.
    pub fn log_name(&self, bus: usize) -> String {
        match self {
            Self::SocketCan(name) => name.clone(),
            Self::Slcan { .. } => format!("slcan{bus}"),
            Self::Epos { .. } => format!("epos{bus}"),
        }
    }
}

impl fmt::Display for Interface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (prefix, path, baud) = match self {
            Self::SocketCan(name) => return f.write_str(name),
            Self::Slcan { path, baud } => (SLCAN, path, *baud),
            Self::Epos { dialect, path, baud } => match dialect {
                Dialect::Epos2 => (EPOS[0].0, path, *baud),
                Dialect::Epos4 => (EPOS[1].0, path, *baud),
            },
        };
        match baud {
            BAUD => write!(f, "{prefix}{path}"),
            baud => write!(f, "{prefix}{path}@{baud}"),
        }
    }
}

/// `PATH` or `PATH@BAUD`.
fn tty_of(text: &str) -> (String, u32) {
    let with_baud = text.rsplit_once('@');
    let (path, baud) = with_baud.and_then(|(path, baud)| Some((path, baud.parse().ok()?))).unwrap_or((text, BAUD));
    (path.to_owned(), baud)
}

/// The interface of each bus, in the cell's order: the interface of the cell, unless `overrides` give another, at most
/// one for each bus.
///
/// An override is `IFACE` for a cell with one bus, or `BUS=IFACE`.
pub fn resolve(cell: &Cell, overrides: &[String]) -> anyhow::Result<Vec<Interface>> {
    let mut interfaces: Vec<_> = cell.bus.iter().map(|bus| Interface::parse(&bus.interface)).collect();
    let mut by = vec![None; interfaces.len()];
    for given in overrides {
        let (index, interface) = bus_of(cell, "--can", given)?;
        if let Some(first) = by[index].replace(given) {
            bail!("--can {given}: the bus is already given another by --can {first}");
        }
        let interface = Interface::parse(interface);
        interface.check().with_context(|| format!("--can {given}"))?;
        interfaces[index] = interface;
    }
    Ok(interfaces)
}

/// Refuses buses that share an interface. Buses without an interface share none.
pub fn all_differ<'a>(cell: &Cell, interfaces: impl IntoIterator<Item = Option<&'a Interface>>) -> anyhow::Result<()> {
    let mut taken = Vec::<(&Interface, &str)>::new();
    for (interface, bus) in interfaces.into_iter().zip(&cell.bus) {
        let Some(interface) = interface else {
            continue;
        };
        if let Some((_, first)) = taken.iter().find(|(other, _)| *other == interface) {
            bail!("bus {}: {interface} is that of bus {first}: give each its own, --can BUS=IFACE", bus.name);
        }
        taken.push((interface, &bus.name));
    }
    Ok(())
}

/// Splits an option into bus and value: `VALUE` for a cell with one bus, or `BUS=VALUE`.
pub fn bus_of<'a>(cell: &Cell, option: &str, given: &'a str) -> anyhow::Result<(usize, &'a str)> {
    match given.split_once('=') {
        Some((name, value)) => {
            let missing = || format!("{option} {given}: the cell has no bus {name:?}, only {}", names(cell));
            Ok((cell.bus.iter().position(|bus| bus.name == name).with_context(missing)?, value))
        }
        None if cell.bus.len() == 1 => Ok((0, given)),
        None if cell.bus.is_empty() => bail!("{option} {given}: the cell has no CAN bus"),
        None => {
            bail!("{option} {given}: the cell has {} buses, say which as BUS={given}: {}", cell.bus.len(), names(cell))
        }
    }
}

fn names(cell: &Cell) -> String {
    let names: Vec<_> = cell.bus.iter().map(|bus| bus.name.as_str()).collect();
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_kernel_takes_for_no_name_is_no_interface() {
        let good = ["can0", "vcan-7", "a.b", "slcan:/dev/ttyACM0", "epos4:/dev/a@9600"];
        for name in good {
            assert!(Interface::parse(name).check().is_ok(), "{name}");
        }
        let bad = [
            "",
            ".",
            "..",
            "a b",
            "a/b",
            "a\0b",
            "a\nb",
            "can0:1",
            "sixteen-bytes-16",
            "\u{1b}[2J",
            "slcan:",
            "slcan:@9600",
            "slcan:/dev/a\nb",
            "epos2:",
        ];
        for name in bad {
            let refused = Interface::parse(name).check().unwrap_err().to_string();
            assert!(!refused.contains(char::is_control), "{refused:?}");
        }
    }

    #[test]
    fn adapters_and_service_ports_are_named_by_their_tty_and_its_speed() {
        let slcan = |path: &str, baud| Interface::Slcan { path: path.to_owned(), baud };
        let epos = |dialect, path: &str, baud| Interface::Epos { dialect, path: path.to_owned(), baud };
        let table = [
            ("epos4:/dev/a", epos(Dialect::Epos4, "/dev/a", 115_200)),
            ("epos2:/dev/b@9600", epos(Dialect::Epos2, "/dev/b", 9600)),
            ("epos3:/dev/b", Interface::SocketCan("epos3:/dev/b".to_owned())),
            ("can0", Interface::SocketCan("can0".to_owned())),
            ("slcan0", Interface::SocketCan("slcan0".to_owned())),
            ("slcan:/dev/ttyACM0", slcan("/dev/ttyACM0", 115_200)),
            ("slcan:/dev/ttyUSB0@921600", slcan("/dev/ttyUSB0", 921_600)),
            ("slcan:/dev/a@b", slcan("/dev/a@b", 115_200)),
        ];
        for (name, interface) in table {
            assert_eq!(Interface::parse(name), interface);
            assert_eq!(interface.to_string(), name);
        }
    }
}
