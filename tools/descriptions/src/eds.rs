//! `mrroc eds`: the electronic data sheet of an emulated drive.

use std::path::Path;

use anyhow::bail;
use can::Instant;
use hil::epos4::Epos4;

use mrroc::bench::emulation;
use mrroc::cell::CellFile;

/// The data sheet of the emulated drive of an axis.
pub fn eds(cell: &Path, axis: &str) -> anyhow::Result<String> {
    let file = CellFile::read(cell)?;
    let (robot, number) = find(&file, axis)?;
    let config = emulation::config(&file, robot, number, Instant::ZERO);
    Ok(Epos4::eds(&config).to_string())
}

/// Finds the axis with this name: ROBOT/AXIS, or an axis name or node-ID that is unique in the cell.
fn find(file: &CellFile, wanted: &str) -> anyhow::Result<(usize, usize)> {
    let robots = file.cell.robot.iter().enumerate();
    let axes = robots.flat_map(|(number, robot)| {
        let axes = robot.axis.iter().enumerate();
        let on_can = axes.filter(|(_, axis)| axis.drive.is_some());
        on_can.map(move |(place, axis)| {
            let full = format!("{}/{}", robot.name, axis.name);
            ((number, place), full, axis)
        })
    });
    let axes: Vec<_> = axes.collect();
    let called = |full: &str, axis: &mrroc::cell::Axis| {
        full == wanted || axis.name == wanted || wanted.parse() == Ok(axis.node)
    };
    let mut found = axes.iter().filter(|(_, full, axis)| called(full, axis));
    let what = match (found.next(), found.next()) {
        (Some((place, ..)), None) => return Ok(*place),
        (Some(_), Some(_)) => "more than one axis is",
        (None, _) => "no axis is",
    };
    if axes.is_empty() {
        bail!("{}: the cell has no drive on CAN", file.path.display());
    }
    let all = axes
        .iter()
        .map(|(_, full, axis)| format!("{full} (node {})", axis.node));
    bail!(
        "{what} called {wanted:?} with a drive on CAN; there are {}",
        all.collect::<Vec<_>>().join(", ")
    )
}
