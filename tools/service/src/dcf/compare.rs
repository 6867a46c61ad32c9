//! `mrroc dcf compare`.

use std::fmt;
use std::path::Path;
use std::process::ExitCode;

use anyhow::bail;
use canopen::Object;
use canopen::eds::{DataType, Eds, Parameter, ParameterValue, Value, Variable};
use canopen::objects::DEVICE_TYPE;
use mrroc::report::{counted, counted_as};
use mrroc::streams;
use serde::Serialize;

use super::{Addressed, Reader, shown, value_type};
use crate::data_sheet::{self, name_of};
use crate::value::Shown;

/// The comparison.
#[derive(Serialize)]
struct Report {
    node: u8,
    file: String,
    /// Number of compared values.
    compared: usize,
    /// Number of values of the file that cannot be compared: notes, write-only objects, and types without a layout.
    not_compared: usize,
    differences: Vec<Difference>,
    #[serde(skip)]
    name: String,
}

#[derive(Serialize)]
struct Difference {
    index: u16,
    subindex: u8,
    name: String,
    line: u32,
    /// Value of the file.
    stated: Shown,
    /// Value of the drive.
    #[serde(skip_serializing_if = "Option::is_none")]
    found: Option<Shown>,
    /// Reason why the drive gives no value.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

/// Compares a drive with a file.
pub(super) fn compare(drive: &Addressed, path: &Path, notes: bool, json: bool) -> anyhow::Result<ExitCode> {
    let dcf = data_sheet::read(path)?;
    if let Some(flaw) = dcf.flaws.iter().find(|flaw| flaw.stated) {
        bail!("{}:{}", shown(path), flaw.error);
    }
    if !dcf.variables().any(|(_, variable)| variable.parameter.is_some()) {
        bail!("{} states no value: it has no ParameterValue", shown(path));
    }
    let mut reader = drive.open(DEVICE_TYPE)?;
    let report = compared(&dcf, shown(path), &mut reader, notes)?;
    let differs = !report.differences.is_empty();
    streams::answer(&report, json)?;
    Ok(ExitCode::from(u8::from(differs)))
}

fn compared(dcf: &Eds, file: String, reader: &mut Reader, notes: bool) -> anyhow::Result<Report> {
    let (mut compared, mut not_compared, mut differences) = (0, 0, Vec::new());
    let node = reader.peer.node;
    for (object, variable) in dcf.variables() {
        let Some(Parameter { value, line }) = &variable.parameter else {
            continue;
        };
        let stated = match value {
            ParameterValue::Value(value) => value.encode(variable.data_type, node),
            ParameterValue::File(_) => None,
        };
        let is_left_out = variable.refuses_download && !notes || !variable.access.readable();
        let Some(stated) = stated.filter(|_| !is_left_out) else {
            not_compared += 1;
            continue;
        };
        compared += 1;
        let ty = value_type(variable.data_type);
        let (found, error) = match reader.read(object, ty)? {
            Ok(found) if agrees(variable, &stated, &found) => continue,
            Ok(found) => (Some(Shown::of(&found, ty, false)), None),
            Err(error) => (None, Some(error.cause.to_string().trim().to_owned())),
        };
        differences.push(Difference {
            index: object.index,
            subindex: object.subindex,
            name: name_of(&dcf.objects[&object.index], variable),
            line: *line,
            stated: Shown::of(&stated, ty, false),
            found,
            error,
        });
    }
    Ok(Report { node: node.raw(), file, compared, not_compared, differences, name: reader.name() })
}

/// Whether the bytes of the drive are the stated value.
fn agrees(variable: &Variable, stated: &[u8], found: &[u8]) -> bool {
    match (Value::decode(variable.data_type, stated), Value::decode(variable.data_type, found)) {
        (Some(stated), Some(found)) if variable.data_type != DataType::UnicodeString => stated == found,
        _ => stated == found,
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for Difference { index, subindex, name, line, stated, found, error } in &self.differences {
            write!(f, "{} {name}: ", Object::new(*index, *subindex))?;
            match (found, error) {
                (Some(found), _) => write!(f, "the drive holds {found}")?,
                (None, Some(error)) => write!(f, "the drive gives no value ({error})")?,
                (None, None) => f.write_str("the drive gives no value")?,
            }
            writeln!(f, ", line {line} of the file states {stated}")?;
        }
        let Self { name, file, compared, not_compared, differences, .. } = self;
        let differing = differences.len();
        let (of, differ) = (counted(*compared, "value"), if differing == 1 { "differs" } else { "differ" });
        let not = counted_as(*not_compared, "is", "are");
        writeln!(f, "{name}: {differing} of {of} {differ} from {file}; {not} not compared")
    }
}
