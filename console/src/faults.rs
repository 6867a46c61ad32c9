//! `mrroc faults`: the fault table of a cell.

use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

use ::faults::{FaultOptions, fault_table};
use mrroc::cell::CellFile;
use mrroc::outputs::{self, Outputs, Replacement};
use mrroc::streams;

/// Plays the faults and writes the table. Exit status 1 if a row is red, or if the file cannot be written.
pub(crate) fn faults(cell: &Path, options: &FaultOptions, replacement: Replacement) -> anyhow::Result<ExitCode> {
    let file = CellFile::read(cell)?;
    let mut outputs = Outputs::new(replacement);
    outputs.reads(&file);
    let out = outputs.open_if("--out", options.out.as_deref())?;
    let table = fault_table(&file, options)?;
    outputs.begin()?;
    let mut failed = false;
    match (out, &options.out) {
        (Some(mut out), Some(path)) => {
            let page = table.page(options.summary);
            match out.write_all(page.as_bytes()) {
                Ok(()) => _ = streams::say(format_args!("{table}"))?,
                Err(error) => {
                    // The table took long to compute, and a part of a page is no page.
                    failed = true;
                    let left = if outputs::remove(path, &out) { "removed" } else { "incomplete" };
                    streams::warn(format_args!(
                        "mrroc: --out: {}: {error}: the file is {left}, and the table is on standard output",
                        path.display()
                    ));
                    streams::print(page)?;
                }
            }
        }
        _ => _ = streams::print(table.page(options.summary))?,
    }
    Ok(ExitCode::from(u8::from(failed || table.red().next().is_some())))
}
