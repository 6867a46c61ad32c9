//! `mrroc dcf strip`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, bail};
use canopen::NodeId;
use canopen::eds::{self, Eds};
use canopen::objects::VENDOR_ID;
use mrroc::cell::{Checked, Refused};
use mrroc::outputs::{Outputs, Replacement};
use mrroc::streams;
use serde::Serialize;

use super::{bytes, parsed, shown};

/// Greatest number of passes. After one refused line is removed, another refusal may appear.
const PASSES: usize = 16;

/// Report of the lines left out.
#[derive(Serialize)]
struct Report {
    file: String,
    /// Number of values that the file still states, for writing and for comparing.
    values: usize,
    /// The lines that are comments now, with the reason.
    left_out: Vec<LeftOut>,
}

#[derive(Serialize)]
struct LeftOut {
    line: u32,
    /// Whether the object belongs to the driver.
    reserved: bool,
    reason: String,
}

/// Writes `input` without the refused values to `output`.
pub(super) fn strip(input: &Path, output: &Path, replacement: Replacement, json: bool) -> anyhow::Result<ExitCode> {
    let original = bytes(input)?;
    let (text, left_out, values) = accepted(input, original)?;
    let mut outputs = Outputs::new(replacement);
    let mut file = outputs.open("OUT", output)?;
    outputs.begin()?;
    file.write_all(&text).with_context(|| shown(output))?;
    streams::answer(&Report { file: shown(output), values, left_out }, json)
}

/// The text without the refused lines, the lines left out, and the number of values that remain.
fn accepted(path: &Path, mut text: Vec<u8>) -> anyhow::Result<(Vec<u8>, Vec<LeftOut>, usize)> {
    let mut left_out = BTreeMap::new();
    for _ in 0..PASSES {
        let dcf = parsed(path, &text)?;
        let Checked { download, lines } = check(&dcf);
        if lines.is_empty() {
            return Ok((text, left_out.into_values().collect(), download.writes.len() + download.compared.len()));
        }
        let reasons = lines.iter().map(|(line, refused)| (*line, reason(refused))).collect();
        let stripped = eds::strip(&text, &reasons);
        let known: BTreeSet<u32> = left_out.keys().copied().collect();
        let mut refused = lines.values();
        for line in stripped.lines.difference(&known) {
            // A line without a refusal belongs to a section with a refused value.
            let why = lines.get(line).or_else(|| refused.next());
            let why = why.map_or((false, String::new()), |why| (matches!(why, Refused::Reserved(_)), reason(why)));
            left_out.insert(*line, LeftOut { line: *line, reserved: why.0, reason: why.1 });
        }
        if stripped.bytes == text {
            break;
        }
        text = stripped.bytes;
    }
    bail!("{}: the lines that are refused cannot be left out; correct them", shown(path))
}

/// The check that a cell file makes, for the drive that the file names.
fn check(dcf: &Eds) -> Checked {
    let node = dcf.commissioning.as_ref().and_then(|place| place.node).unwrap_or(NodeId::MIN);
    let vendor = dcf.identity(VENDOR_ID.subindex).unwrap_or(0);
    Checked::of(dcf, node, vendor)
}

/// The reason, as one line of a file.
fn reason(refused: &Refused) -> String {
    match refused {
        Refused::Reserved(reserved) => format!("belongs to the driver: {}", reserved.why),
        Refused::Other(problem) => problem.clone(),
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reserved = self.left_out.iter().filter(|line| line.reserved).count();
        write!(f, "{}: {} values", self.file, self.values)?;
        match self.left_out.len() {
            0 => writeln!(f, "; no line had to be left out"),
            lines => {
                writeln!(f, "; {lines} lines are left out, {reserved} of them of objects that belong to the driver")
            }
        }?;
        let others = self.left_out.iter().filter(|line| !line.reserved);
        others.into_iter().try_for_each(|LeftOut { line, reason, .. }| writeln!(f, "  line {line}: {reason}"))
    }
}
