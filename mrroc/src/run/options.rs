//! Options of a run: its bench, its files, and the benches that each option fits.

use std::path::{Path, PathBuf};

use anyhow::bail;

use crate::bench::{BenchKind, Places};
use crate::outputs::Replacement;

/// What a run runs on and which files it writes.
#[derive(Debug, Default)]
#[cfg_attr(feature = "command-line", derive(clap::Args))]
pub struct RunOptions {
    /// What to run it on.
    #[cfg_attr(feature = "command-line", arg(long, value_enum, default_value = "emulated"))]
    pub bench: BenchKind,
    /// Where the bench is found.
    #[cfg_attr(feature = "command-line", command(flatten))]
    pub places: Places,
    /// Move at this percentage of the programmed speed: 0.1 to 100.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "PERCENT"))]
    pub speed: Option<f64>,
    /// Rehearse the task with the emulated scene of the cell too, before anything moves: with contact, sensors and the
    /// torques of the emulated drives. This takes as long as a run with --bench lockstep.
    #[cfg_attr(feature = "command-line", arg(long))]
    pub rehearse_with_scene: bool,
    /// Write every frame to this file, as candump does. Refused for a cell without a CAN bus.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "FILE"))]
    pub trace: Option<PathBuf>,
    /// Write every axis in every cycle to this file, as CSV. A file called NAME.mcap is a recording for `mrroc replay`: all
    /// cycles, frames and telegrams, with the frames as a candump log in NAME.log beside it.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "FILE"))]
    pub record: Option<PathBuf>,
    /// Write the last seconds to a new file in this directory after each fault of a robot, and at SIGUSR1. With --bench
    /// card, the default is the working directory.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "DIR"))]
    #[cfg(feature = "recording")]
    pub flight: Option<PathBuf>,
    /// Write every step of every generator to this file, as CSV: the events of the flow chart, the ages of the images, and a
    /// digest of the memory.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "FILE"))]
    pub steps: Option<PathBuf>,
    /// Write the servo cycles around the latest ones to this file, phase by phase, for ui.perfetto.dev; SIGUSR1 adds
    /// those around a moment of yours.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "FILE"))]
    pub spikes: Option<PathBuf>,
    /// Write the true places of bars and the true wrenches of grippers of the emulated scene to this file, as CSV, in each
    /// servo period. Needs --bench lockstep. No controller reads the truth.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "FILE"))]
    pub truth: Option<PathBuf>,
    /// Write the height field of each emulated workpiece after the run into this directory, as NAME.pgm with 16 bits of
    /// grey. Needs an emulated bench.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "DIR"))]
    pub carved: Option<PathBuf>,
    /// Play the faults of this scenario file on the emulated side of the wires. Needs --bench lockstep or emulated.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "FILE"))]
    pub scenario: Option<PathBuf>,
    /// Advance the emulated robots with this number of threads, at most 64. Needs --bench lockstep. The result does not
    /// depend on the number. Each thread occupies a processor. There are no more threads than processors or robots. One
    /// thread advances all robots that may influence each other, for example through bodies or belts.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=64)))]
    pub threads: Option<u8>,
    /// Write report.html into this directory: tables and plots of the run in one file, which needs no network.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "DIR"))]
    #[cfg(feature = "pages")]
    pub out: Option<PathBuf>,
    /// Replacement of files that are there.
    #[cfg_attr(feature = "command-line", command(flatten))]
    pub replacement: Replacement,
}

impl RunOptions {
    /// A run on `bench` that writes no files.
    pub fn on(bench: BenchKind) -> Self {
        Self { bench, ..Self::default() }
    }

    /// The file of `record`, if the file is a recording, and no CSV file.
    pub(super) fn recording(&self) -> Option<&Path> {
        self.record.as_deref().filter(|path| path.extension().is_some_and(|extension| extension == "mcap"))
    }

    /// Fails if an option does not fit the bench, or needs a feature that this library was built without.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        #[cfg(not(feature = "recording"))]
        if let Some(path) = self.recording() {
            bail!("--record {}: an MCAP recording needs the feature `recording` of the library mrroc", path.display());
        }
        if self.spikes.is_some() && self.bench == BenchKind::Lockstep {
            bail!("--spikes needs cycles by the clock, which --bench lockstep has none of");
        }
        if self.threads.is_some() && self.bench != BenchKind::Lockstep {
            bail!("--threads needs --bench lockstep: on the other benches, the robots move at the pace of the clock");
        }
        if self.truth.is_some() && self.bench != BenchKind::Lockstep {
            bail!("--truth needs --bench lockstep, where the scene is in step with the servo");
        }
        if self.carved.is_some() && !matches!(self.bench, BenchKind::Lockstep | BenchKind::Emulated) {
            bail!("--carved needs --bench lockstep or emulated, whose workpieces are in this process");
        }
        if self.scenario.is_some() && !matches!(self.bench, BenchKind::Lockstep | BenchKind::Emulated) {
            bail!("--scenario needs --bench lockstep or emulated; elsewhere `mrroc emulate --scenario` plays it");
        }
        Ok(())
    }
}

#[cfg(test)]
#[cfg(not(feature = "recording"))]
mod tests {
    use super::*;

    #[test]
    fn a_recording_is_refused_by_a_library_that_cannot_record() {
        let options = |file: &str| RunOptions { record: Some(file.into()), ..RunOptions::on(BenchKind::Lockstep) };
        let refusal = options("run.mcap").check().unwrap_err().to_string();
        assert_eq!(refusal, "--record run.mcap: an MCAP recording needs the feature `recording` of the library mrroc");
        assert!(options("run.csv").check().is_ok());
    }
}
