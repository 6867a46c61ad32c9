//! `mrroc dcf strip`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, bail};
use canopen::eds;
use mrroc::cell::{Checked, Refused};
use mrroc::outputs::{Outputs, Replacement};
use mrroc::report::{counted, counted_as};
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
        let Checked { download, lines } = Checked::without_cell(&dcf);
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
        write!(f, "{}: {}", self.file, counted(self.values, "value"))?;
        match self.left_out.len() {
            0 => writeln!(f, "; no line had to be left out"),
            lines => {
                let lines = counted_as(lines, "line is", "lines are");
                writeln!(f, "; {lines} left out, {reserved} of them of objects that belong to the driver")
            }
        }?;
        let others = self.left_out.iter().filter(|line| !line.reserved);
        others.into_iter().try_for_each(|LeftOut { line, reason, .. }| writeln!(f, "  line {line}: {reason}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_stated_vendor_the_objects_of_all_vendors_are_left_out() {
        let object = |section: &str| {
            format!("[{section}]\nParameterName=of\nObjectType=7\nDataType=7\nAccessType=rw\nParameterValue=1\n")
        };
        let record = "[3000]\nParameterName=of\nObjectType=9\n";
        let values: String = ["2000", "2001", "30B0", "30B1", "6067"].into_iter().map(object).collect();
        let values = values + record + &["3000sub2", "3000sub4"].map(object).concat();
        let left_out = |head: &str| {
            let (_, lines, values) = accepted(Path::new("motor.dcf"), format!("{head}{values}").into()).unwrap();
            assert!(lines.iter().all(|line| line.reserved && !line.reason.is_empty()));
            (lines.iter().map(|line| line.line).collect::<Vec<_>>(), values)
        };
        let of_maxon = vec![8, 14, 20, 26, 47];
        assert_eq!(left_out("[DeviceInfo]\nVendorNumber=0xFB\n"), (of_maxon.clone(), 2));
        assert_eq!(left_out("[DeviceInfo]\nVendorNumber=0\n"), (of_maxon.clone(), 2));
        assert_eq!(left_out("[DeviceInfo]\nVendorName=maxon\n"), (of_maxon, 2));
        assert_eq!(left_out("[DeviceInfo]\nVendorNumber=0x1234\n"), (Vec::new(), 7));
    }
}
