//! `mrroc faults`: the fault table of a cell.

use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use mrroc::cell::CellFile;
use mrroc::fault_table::{FaultOptions, fault_table};
use mrroc::outputs::{Outputs, Replacement};
use mrroc::streams;

/// Plays the faults and writes the table. Exit status 1 if a row is red.
pub(crate) fn faults(cell: &Path, options: &FaultOptions, replacement: Replacement) -> anyhow::Result<ExitCode> {
    let file = CellFile::read(cell)?;
    let mut outputs = Outputs::new(replacement);
    outputs.reads(&file);
    let out = outputs.open_if("--out", options.out.as_deref())?;
    let table = fault_table(&file, options)?;
    outputs.begin()?;
    match out {
        Some(mut out) => {
            out.write_all(table.page(options.summary).as_bytes()).context("--out cannot be written")?;
            streams::say(format_args!("{table}"))?;
        }
        None => _ = streams::print(table.page(options.summary))?,
    }
    Ok(ExitCode::from(u8::from(table.red().next().is_some())))
}
