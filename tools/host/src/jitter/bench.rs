//! Bench on which a cell is measured. Interfaces that may have an arm at their other end are refused, even if the cell
//! file names them.

use anyhow::{Context, bail};
use can::card::{self, CardError};
use clap::ValueEnum;
use serde::Serialize;

use crate::doctor::link::Link;
use mrroc::bench::interfaces::{Interface, bus_of};
use mrroc::cell::CellFile;

/// Bench on which a cell is measured. No bench moves hardware.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum CellBench {
    /// Emulated drives on a virtual bus, stepped by the servo thread between its cycles.
    Emulated,
    /// Virtual CAN interfaces, given with --can, with `mrroc emulate` at their other end.
    Vcan,
}

/// Refuses a bench that is not allowed or not available. `can` holds the values of `--can`.
pub(super) fn check(file: Option<&CellFile>, bench: CellBench, can: &[String]) -> anyhow::Result<()> {
    let (Some(file), CellBench::Vcan) = (file, bench) else {
        if !can.is_empty() {
            bail!("--can needs --cell with --bench vcan");
        }
        return Ok(());
    };
    let cell = &file.cell;
    if !cell.serial.is_empty() || cell.has_sensor_lines() {
        bail!("--bench vcan has no serial lines, and those of the cell may be an arm's: --bench emulated measures it");
    }
    let mut given = vec![None; cell.bus.len()];
    for option in can {
        let (index, interface) = bus_of(cell, "--can", option)?;
        given[index] = Some(interface);
    }
    for (bus, interface) in cell.bus.iter().zip(given) {
        let interface = interface.with_context(|| {
            format!(
                "--bench vcan needs a virtual interface for bus {}, as --can vcan0: the cell's own, {}, may be an arm's",
                bus.name, bus.interface
            )
        })?;
        virtual_alone(interface).with_context(|| format!("--can {interface}"))?;
    }
    Ok(())
}

/// Refuses an interface that is not known to be virtual.
fn virtual_alone(interface: &str) -> anyhow::Result<()> {
    if let Interface::Slcan { .. } | Interface::Epos { .. } = Interface::parse(interface) {
        bail!("an adapter on a tty may be an arm's, --bench vcan takes virtual interfaces alone");
    }
    match card::read(interface) {
        Ok(_) => bail!("a card may be an arm's, --bench vcan takes virtual interfaces alone"),
        Err(CardError::NotCard(_)) => {}
        Err(error) => return Err(error.into()),
    }
    // A card whose driver reports nothing to netlink is refused as well.
    let link = Link::of(interface).context("`ip` of iproute2 has to tell its kind")?;
    let kind = link.info.kind.as_str();
    if !["vcan", "vxcan"].contains(&kind) {
        bail!("its kind is {kind:?}, neither vcan nor vxcan, and it may be an arm's");
    }
    Ok(())
}
