//! Which network interface each bus of a cell is on.

use anyhow::{Context, bail};
use controller::cell::Cell;

/// The interface of each bus, in the cell's order: the cell's own, or as `overrides` say.
///
/// An override is `IFACE` for a cell of one bus, or `BUS=IFACE`.
pub(crate) fn resolve(cell: &Cell, overrides: &[String]) -> anyhow::Result<Vec<String>> {
    let mut interfaces: Vec<String> = cell.bus.iter().map(|bus| bus.interface.clone()).collect();
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
        interface.clone_into(&mut interfaces[index]);
    }
    Ok(interfaces)
}
