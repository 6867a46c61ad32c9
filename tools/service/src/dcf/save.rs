//! `mrroc dcf save`.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use canopen::eds::{
    Access, Commissioning, DataType, Eds, Entry, ObjectType, Parameter, ParameterValue, Value, Variable,
};
use canopen::objects::{self, DEVICE_TYPE, PRODUCT_CODE, REVISION, SERIAL_NUMBER, VENDOR_ID};
use canopen::{NodeId, Object};
use drive::cia402::reserved;
use mrroc::outputs::{Outputs, Replacement};
use mrroc::report::counted_as;
use mrroc::streams;
use serde::Serialize;

use super::{Addressed, Reader, shown, value_type};
use crate::{data_sheet, value, words};

/// Report of the saved values.
#[derive(Serialize)]
struct Report {
    node: u8,
    file: String,
    /// Number of values.
    values: usize,
    /// Number of values that are notes, which no download writes.
    notes: usize,
    /// Objects without a value in the file, with the reason.
    absent: Vec<Absent>,
    #[serde(skip)]
    name: String,
}

#[derive(Serialize)]
struct Absent {
    index: u16,
    subindex: u8,
    reason: String,
}

/// Reads the values of a drive into `output`.
pub(super) fn save(
    drive: &Addressed,
    output: &Path,
    eds: Option<&Path>,
    replacement: Replacement,
    json: bool,
) -> anyhow::Result<ExitCode> {
    let sheet = eds.map(data_sheet::read).transpose()?;
    let mut outputs = Outputs::new(replacement);
    let mut file = outputs.open("OUT", output)?;
    let mut reader = drive.open(DEVICE_TYPE)?;
    let (mut dcf, absent) = match sheet {
        Some(sheet) => of_sheet(sheet, &mut reader)?,
        None => of_names(&mut reader)?,
    };
    let serial = reader.read(SERIAL_NUMBER, None)?.ok().and_then(|data| value::unsigned(&data));
    dcf.commissioning = Some(Commissioning {
        node: Some(drive.node),
        baud_rate: reader.bitrate().and_then(|rate| u16::try_from(rate).ok()),
        serial_number: serial.and_then(|serial| u32::try_from(serial).ok()).filter(|serial| *serial != 0),
        ..dcf.commissioning.unwrap_or_default()
    });
    dcf.file.file_name = output.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    dcf.file.created_by = format!("mrroc {}", env!("CARGO_PKG_VERSION"));
    dcf.file.creation_date = String::new();
    dcf.file.creation_time = String::new();
    let stated = || dcf.variables().filter(|(_, variable)| variable.parameter.is_some());
    let report = Report {
        node: drive.node.raw(),
        file: shown(output),
        values: stated().count(),
        notes: stated().filter(|(_, variable)| variable.refuses_download).count(),
        absent,
        name: reader.name(),
    };
    outputs.begin()?;
    write!(file, "{dcf}").with_context(|| shown(output))?;
    streams::answer(&report, json)
}

/// The objects of a data sheet with their values. The identity of the drive replaces that of the data sheet.
fn of_sheet(mut sheet: Eds, reader: &mut Reader) -> anyhow::Result<(Eds, Vec<Absent>)> {
    let node = reader.peer.node;
    let vendor = number(reader, VENDOR_ID)?;
    let mut absent = Vec::new();
    let objects: Vec<Object> = sheet.variables().map(|(object, _)| object).collect();
    for object in objects {
        let entry = sheet.objects.get_mut(&object.index);
        let Some(variable) = entry.and_then(|entry| entry.variables.get_mut(&object.subindex)) else {
            continue;
        };
        variable.parameter = None;
        if !variable.access.readable() || variable.refuses_scan || variable.data_type == DataType::Domain {
            continue;
        }
        let read = reader.read(object, value_type(variable.data_type))?;
        match read
            .map_err(|error| error.cause.to_string().trim().to_owned())
            .and_then(|data| parameter(variable, &data, node))
        {
            Ok(parameter) => {
                variable.parameter = Some(parameter);
                variable.refuses_download |=
                    !variable.access.writable() || reserved(vendor, object.index, object.subindex).is_some();
            }
            Err(reason) => absent.push(Absent { index: object.index, subindex: object.subindex, reason }),
        }
    }
    sheet.device.vendor_number = Some(vendor).filter(|vendor| *vendor != 0).or(sheet.device.vendor_number);
    for (of_device, object) in
        [(&mut sheet.device.product_number, PRODUCT_CODE), (&mut sheet.device.revision_number, REVISION)]
    {
        let read = number(reader, object)?;
        *of_device = Some(read).filter(|read| *read != 0).or(*of_device);
    }
    Ok((sheet, absent))
}

/// The value of an object of four bytes at most; 0 if the drive has none.
fn number(reader: &mut Reader, object: Object) -> anyhow::Result<u32> {
    let read = reader.read(object, None)?.ok().and_then(|data| value::unsigned(&data));
    Ok(read.and_then(|read| u32::try_from(read).ok()).unwrap_or(0))
}

/// The value that the drive holds, if a file can state it.
fn parameter(variable: &Variable, data: &[u8], node: NodeId) -> Result<Parameter, String> {
    let value = Value::decode(variable.data_type, data)
        .ok_or_else(|| format!("{} bytes of the drive are no value that the data sheet has a form for", data.len()))?;
    if let Some(number) = value.integer(node) {
        let beyond = |limit: &Option<Value>, is_beyond: fn(i128, i128) -> bool| {
            limit.as_ref().and_then(|limit| limit.integer(node)).filter(|limit| is_beyond(number, *limit))
        };
        let low = beyond(&variable.low, |number, low| number < low);
        let high = beyond(&variable.high, |number, high| number > high);
        if let Some(limit) = low.or(high) {
            return Err(format!("the drive holds {number}, beyond the limit {limit} of the data sheet"));
        }
    }
    Ok(Parameter { value: ParameterValue::Value(value), line: 0 })
}

/// The objects of the drive that this program knows by name. The types of the objects follow from the lengths of their
/// values.
fn of_names(reader: &mut Reader) -> anyhow::Result<(Eds, Vec<Absent>)> {
    let mut dcf = Eds::default();
    for (object, name) in objects::TABLE {
        let Ok(data) = reader.read(*object, None)? else {
            continue;
        };
        let data_type = match (data.len(), words::is_signed(*object)) {
            (1, false) => DataType::Unsigned8,
            (1, true) => DataType::Integer8,
            (2, false) => DataType::Unsigned16,
            (2, true) => DataType::Integer16,
            (4, false) => DataType::Unsigned32,
            (4, true) => DataType::Integer32,
            _ if Value::decode(DataType::VisibleString, &data).is_some() => DataType::VisibleString,
            _ => DataType::OctetString,
        };
        let Some(value) = Value::decode(data_type, &data) else {
            continue;
        };
        let variable = Variable {
            name: (*name).to_owned(),
            data_type,
            access: Access::ReadWrite,
            default: None,
            low: None,
            high: None,
            pdo_mapping: false,
            refuses_download: true,
            refuses_scan: false,
            parameter: Some(Parameter { value: ParameterValue::Value(value), line: 0 }),
        };
        let single = !objects::TABLE.iter().any(|(other, _)| other.index == object.index && other.subindex != 0);
        let entry = dcf.objects.entry(object.index).or_insert_with(|| Entry {
            name: (*name).to_owned(),
            object_type: if single { ObjectType::Variable } else { ObjectType::Record },
            variables: BTreeMap::new(),
        });
        entry.variables.insert(object.subindex, variable);
    }
    dcf.file.eds_version = "4.0".to_owned();
    let identity = |object: Object| dcf.identity(object.subindex);
    let [vendor, product, revision] = [VENDOR_ID, PRODUCT_CODE, REVISION].map(identity);
    dcf.device.vendor_number = vendor;
    dcf.device.product_number = product;
    dcf.device.revision_number = revision;
    Ok((dcf, Vec::new()))
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, file, values, notes, absent, .. } = self;
        let values = counted_as(*values, "value is", "values are");
        let notes = counted_as(*notes, "of them is a note", "of them are notes");
        writeln!(f, "{name}: {values} in {file}, {notes}")?;
        let mut reasons: Vec<(&str, Vec<Object>)> = Vec::new();
        for Absent { index, subindex, reason } in absent {
            let object = Object::new(*index, *subindex);
            match reasons.iter_mut().find(|(known, _)| known == reason) {
                Some((_, objects)) => objects.push(object),
                None => reasons.push((reason, vec![object])),
            }
        }
        for (reason, objects) in reasons {
            write!(f, "  without a value: {}", objects[0])?;
            match objects.len() - 1 {
                0 => {}
                more => write!(f, " and {more} more, up to {}", objects[more])?,
            }
            writeln!(f, ": {reason}")?;
        }
        Ok(())
    }
}
