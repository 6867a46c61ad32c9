//! Which network interface each bus of a cell is on.

use anyhow::{Context, bail};
use controller::cell::Cell;

/// The interface of each bus, in the cell's order: the cell's own, or as `overrides` say.
///
/// An override is `IFACE` for a cell of one bus, or `BUS=IFACE`.
pub(crate) fn resolve(cell: &Cell, overrides: &[String]) -> anyhow::Result<Vec<String>> {
    let mut interfaces: Vec<String> = cell.bus.iter().map(|bus| bus.interface.clone()).collect();
    for given in overrides {
        let (index, interface) = bus_of(cell, "--can", given)?;
        interface.clone_into(&mut interfaces[index]);
    }
    Ok(interfaces)
}

/// What an option says of which bus: `VALUE` for a cell of one bus, or `BUS=VALUE`.
pub(crate) fn bus_of<'a>(
    cell: &Cell,
    option: &str,
    given: &'a str,
) -> anyhow::Result<(usize, &'a str)> {
    match given.split_once('=') {
        Some((name, value)) => {
            let index = cell.bus.iter().position(|bus| bus.name == name);
            let index =
                index.with_context(|| format!("{option} {given}: the cell has no bus {name:?}"))?;
            Ok((index, value))
        }
        None if cell.bus.len() == 1 => Ok((0, given)),
        None => bail!(
            "{option} {given}: the cell has {} buses, say which as BUS=VALUE",
            cell.bus.len()
        ),
    }
}
