//! `mrroc eds`: the electronic data sheet of an emulated drive.

use std::path::Path;

use anyhow::anyhow;
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
        axes.map(move |(axis, value)| ((number, axis), robot, value))
    });
    let axes: Vec<_> = axes
        .filter(|(.., axis)| axis.drive.is_some())
        .map(|(place, robot, axis)| (place, format!("{}/{}", robot.name, axis.name), axis))
        .collect();
    let called = |full: &str, axis: &mrroc::cell::Axis| {
        full == wanted || axis.name == wanted || wanted.parse() == Ok(axis.node)
    };
    let mut found = axes.iter().filter(|(_, full, axis)| called(full, axis));
    match (found.next(), found.next()) {
        (Some((place, ..)), None) => Ok(*place),
        (first, _) => {
            let all: Vec<_> = axes
                .iter()
                .map(|(_, full, axis)| format!("{full} (node {})", axis.node))
                .collect();
            if all.is_empty() {
                return Err(anyhow!(
                    "{}: the cell has no drive on CAN",
                    file.path.display()
                ));
            }
            let what = if first.is_some() {
                "more than one axis is"
            } else {
                "no axis is"
            };
            Err(anyhow!(
                "{what} called {wanted:?} with a drive on CAN; there are {}",
                all.join(", ")
            ))
        }
    }
}
