//! Replay of a recording through the drivers and the servo, in the time of the recording.
//!
//! Ports and lines give the recorded results in the recorded calls. The servo gets the recorded orders, stop requests,
//! overrides and missed deadlines in their cycles, and drivers and laws the recorded words. The outputs are compared with
//! the recorded outputs message by message: cycles of robots, faults, sent frames and sent bytes.

use std::fmt::{self, Display, Formatter};
use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use serde::Serialize;

use super::difference::Difference;
use super::reader::{Damage, Reader};
use super::replaying::Replaying;
use crate::cell::CellFile;
use can::counted;

/// What a recording is replayed with.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    /// A cell file in place of the recorded one.
    pub cell: Option<PathBuf>,
}

/// Result of a replay.
#[derive(Clone, Debug, Serialize)]
pub struct Replay {
    /// The recording.
    pub file: PathBuf,
    /// Version that made the recording.
    pub recorded_by: String,
    /// Name of the cell.
    pub cell: String,
    /// Bench of the recorded run.
    pub bench: String,
    /// Replayed cycles.
    pub cycles: u64,
    /// Time of the last replayed call, s.
    pub end_s: f64,
    /// Outputs that are equal bit for bit: cycles of robots, faults, frames and parts of telegrams.
    pub equal: u64,
    /// How the file ends, if it ends before its end. All whole chunks were replayed.
    pub cut: Option<String>,
    /// First damage of the file. Only the cycles before it were replayed.
    pub damaged: Option<Damage>,
    /// Number of the last replayed cycle, from 0; absent if only the bring-up was replayed.
    pub last_cycle: Option<u64>,
    /// Number and time of the first cycle with a difference; absent in a bring-up.
    pub differs_in: Option<Place>,
    /// The differences of this cycle; empty if all outputs are equal.
    pub differences: Vec<Difference>,
}

/// A place in a recording.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Place {
    /// Number of the cycle, from 0; absent in the bring-up.
    pub cycle: Option<u64>,
    /// Time, s.
    pub time_s: f64,
}

impl Replay {
    /// Whether all outputs are equal.
    pub fn is_equal(&self) -> bool {
        self.differences.is_empty()
    }

    /// Whether the file is complete: neither cut nor damaged.
    pub fn is_whole(&self) -> bool {
        self.cut.is_none() && self.damaged.is_none()
    }
}

impl Display for Replay {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { recorded_by, cell, bench, cycles, equal, .. } = self;
        writeln!(f, "recording of cell {cell} on bench {bench} by mrroc {recorded_by}")?;
        let cycle = self.last_cycle.map_or_else(|| "no cycle".to_owned(), |cycle| format!("cycle {cycle}"));
        let reach = format!("replayed up to {cycle}, at {:.3} s", self.end_s);
        if let Some(cut) = &self.cut {
            writeln!(f, "the recording was cut: {cut}: {reach}")?;
        }
        if let Some(Damage { byte, what }) = &self.damaged {
            writeln!(f, "{}: damaged at byte {byte} ({what}): {reach}", self.file.display())?;
        }
        match (self.differs_in, self.differences.first()) {
            (Some(Place { cycle: Some(cycle), time_s }), Some(first)) => {
                writeln!(f, "differs first in cycle {cycle}, at {time_s:.6} s: {first}")
            }
            (Some(Place { time_s, .. }), Some(first)) => {
                writeln!(f, "differs in the bring-up at {time_s:.6} s: {first}")
            }
            _ => {
                let (cycles, outputs) = (counted(*cycles, "cycle"), counted(*equal, "output"));
                writeln!(f, "{cycles} replayed, {outputs} equal bit for bit")
            }
        }
    }
}

/// Replays the recording `path`.
pub fn replay(path: &Path, options: &ReplayOptions) -> anyhow::Result<Replay> {
    let name = || path.display().to_string();
    let mut reader = match Reader::open(path) {
        Ok(reader) => reader,
        Err(error) => {
            let advised = match beside(path) {
                Some(advice) => anyhow!("{error:#}: {advice}"),
                None => error,
            };
            return Err(advised.context(name()));
        }
    };
    let first = reader.chunk().with_context(name)?;
    if reader.facts().texts.get("whole").is_some_and(|whole| whole != "true") {
        bail!(
            "{}: the file has only the last seconds of a run, and a replay needs all since the bring-up: record the run by \
             --record FILE.mcap",
            path.display()
        );
    }
    reader.facts().check_devices().with_context(name)?;
    let directory = tempfile::tempdir().context("no directory for the recorded cell file")?;
    let file = match (&options.cell, reader.missing()) {
        (Some(cell), _) => CellFile::read(cell)?,
        (None, None) => recorded_cell(&reader, directory.path()).with_context(name)?,
        // What is read of a damaged file before its damage may be incomplete.
        (None, Some(missing)) => recorded_cell(&reader, directory.path()).context(missing).with_context(name)?,
    };
    let result = Replaying::new(path, &reader, &file).and_then(|replaying| replaying.go(reader, first));
    result.with_context(name)
}

/// The recording beside the candump log `path`, in words.
fn beside(path: &Path) -> Option<String> {
    let recording = path.with_extension("mcap");
    let is_log = path.extension().is_some_and(|extension| extension == "log");
    (is_log && recording.is_file())
        .then(|| format!("a candump log has only the frames of a recording: replay {}", recording.display()))
}

/// Greatest number of folders by which a recorded file lies above the folder of its cell.
const DEEPEST: usize = 16;

/// The recorded cell file with the files that it names, in `directory`.
fn recorded_cell(reader: &Reader, directory: &Path) -> anyhow::Result<CellFile> {
    let mut cell = None;
    // Files above the folder of the cell have names that begin with `..`. They stay within `directory`.
    let above = |name: &str| Path::new(name).components().take_while(|part| *part == Component::ParentDir).count();
    let depth = reader.facts().files.iter().map(|(name, _)| above(name)).max().unwrap_or(0).min(DEEPEST);
    let folder = directory.join(PathBuf::from_iter(std::iter::repeat_n("in", depth)));
    fs::create_dir_all(&folder)?;
    for (name, bytes) in &reader.facts().files {
        let path = Path::new(name);
        let below = path.components().skip(above(name));
        if above(name) > depth || !below.into_iter().all(|part| matches!(part, Component::Normal(_))) {
            continue;
        }
        let path = folder.join(path);
        fs::create_dir_all(path.parent().unwrap_or(directory))?;
        fs::write(&path, bytes)?;
        cell.get_or_insert(path);
    }
    CellFile::read(cell.context("no cell file can be read from the recording")?)
}
