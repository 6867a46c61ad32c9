//! The page of a run, in the file of `--out`. Without the feature `pages`, a run has no page.

#[cfg(feature = "pages")]
use std::{fs::File, io::Write as _, path::PathBuf};

#[cfg(feature = "pages")]
use anyhow::Context as _;
use servo::Timing;

use super::RunOptions;
use crate::outputs::Outputs;
use crate::report::{RunReport, Tracks};
#[cfg(feature = "pages")]
use crate::{
    outputs,
    report::{self, FaultReport, IncompleteFile, RunOutcome},
    row_file::FileName,
};

/// Name of the file.
#[cfg(feature = "pages")]
const REPORT: &str = "report.html";

/// The opened file of the page, if it was asked for.
pub(super) struct PageFile {
    #[cfg(feature = "pages")]
    file: Option<(PathBuf, File)>,
}

#[cfg(feature = "pages")]
impl PageFile {
    /// Opens the file.
    pub(super) fn open(outputs: &mut Outputs, options: &RunOptions) -> anyhow::Result<Self> {
        let open = |directory: &PathBuf| {
            let file = outputs.open_in("--out", directory, REPORT)?;
            anyhow::Ok((directory.join(REPORT), file))
        };
        Ok(Self { file: options.out.as_ref().map(open).transpose()? })
    }

    /// Whether the page was asked for.
    pub(super) fn is_wanted(&self) -> bool {
        self.file.is_some()
    }

    /// Writes the page. A part of a page is no page, and is removed.
    pub(super) fn write(self, report: &mut RunReport, tracks: &Tracks, timing: &Timing) {
        let Some((path, mut file)) = self.file else { return };
        let page = match report::page(report, tracks, timing).context(REPORT) {
            Ok(page) => page,
            Err(error) => {
                report.faults.push(FaultReport::of_run(error));
                report.outcome = RunOutcome::Faulted;
                return;
            }
        };
        if let Err(error) = file.write_all(page.as_bytes()) {
            let name = FileName::new("--out", &path, "page");
            outputs::remove(&path, &file);
            report.incomplete_files.push(IncompleteFile { lost: 1, ..name.fails(&error) });
        }
    }
}

#[cfg(not(feature = "pages"))]
impl PageFile {
    pub(super) fn open(_: &mut Outputs, _: &RunOptions) -> anyhow::Result<Self> {
        Ok(Self {})
    }

    pub(super) fn is_wanted(&self) -> bool {
        false
    }

    pub(super) fn write(self, _: &mut RunReport, _: &Tracks, _: &Timing) {}
}
