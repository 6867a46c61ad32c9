//! `mrroc eds`: the electronic data sheet of an emulated drive.

use std::path::Path;

use can::Instant;
use hil::epos4::Epos4;

use mrroc::bench::emulation;
use mrroc::cell::CellFile;

/// The data sheet of the emulated drive of an axis.
pub fn eds(cell: &Path, axis: &str) -> anyhow::Result<String> {
    let file = CellFile::read(cell)?;
    let (robot, number) = file.find_axis(axis, true)?;
    Ok(Epos4::eds(&emulation::config(&file, robot, number, Instant::ZERO)).to_string())
}
