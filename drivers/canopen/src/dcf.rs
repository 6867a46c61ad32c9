//! Download of a DCF (CiA 306-1 §7): the values that a DCF states for its device, in the order of their writes.
//!
//! Read [`crate::eds`] first, then [`download`].

use std::collections::BTreeMap;

use thiserror::Error;

use crate::eds::{DataType, Eds, Parameter, ParameterValue, Variable};
use crate::objects::VENDOR_ID;
use crate::pdo::PdoCobId;
use crate::{NodeId, Object, number};

/// The writes of a DCF.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Download {
    /// The writes, in their order on the bus.
    pub writes: Vec<ObjectWrite>,
    /// Number of stated values that are not written. These are the identity (object 0x1018) and objects with bit 0 of
    /// `ObjFlags` (CiA 306-1 §6.6.3.3). Tools that store all values of a device set this bit.
    pub left_out: usize,
}

/// One write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectWrite {
    /// The object to write.
    pub object: Object,
    /// The value, as it goes over the bus.
    pub data: Vec<u8>,
    /// Whether it can be read back.
    pub readable: bool,
    /// The line of the file that asks for it, from 1.
    pub line: u32,
}

/// Why a DCF cannot be downloaded: the line, what is wrong there, what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DownloadError {
    #[error(
        "{line}: {object} is read-only; remove its ParameterValue, or set bit 0 of its ObjFlags to keep it as a note"
    )]
    ReadOnly { line: u32, object: Object },
    #[error("{line}: {object} has data type {code:#06x}, whose values cannot be written; remove its ParameterValue")]
    DataType { line: u32, object: Object, code: u16 },
    #[error("{line}: {object} is to be written from a file, which is not supported; remove its DownloadFile")]
    File { line: u32, object: Object },
    #[error("{line}: a PDO is changed whose {object} has neither ParameterValue nor DefaultValue; state it")]
    NoPdoState { line: u32, object: Object },
}

/// The stated values of `dcf` for a device with this node-ID. A value equal to the default is written as well, since the
/// device may have stored another value.
///
/// Objects are written in ascending order, PDOs last. A PDO with any stated value is switched off (COB-ID with bit
/// 31), and its mapping is cleared, filled and counted. Its other parameters follow, and its COB-ID last (CiA 301
/// §7.5.2.36, §7.5.2.38). Entries beyond the count have no effect and are not written.
pub fn download(dcf: &Eds, node: NodeId) -> Result<Download, DownloadError> {
    let mut download = Download::default();
    let mut pdos: BTreeMap<u16, BTreeMap<Object, ObjectWrite>> = BTreeMap::new();
    for (object, variable) in dcf.variables() {
        let Some(parameter) = &variable.parameter else {
            continue;
        };
        let identity = object.index == VENDOR_ID.index && !variable.access.writable();
        if variable.refuses_download || identity {
            download.left_out += 1;
            continue;
        }
        let write = write(object, variable, parameter, node)?;
        match communication_parameter(object.index) {
            Some(pdo) => {
                pdos.entry(pdo).or_default().insert(object, write);
            }
            None => download.writes.push(write),
        }
    }
    for (communication, stated) in pdos {
        remap(dcf, node, communication, stated, &mut download.writes)?;
    }
    Ok(download)
}

fn write(
    object: Object,
    variable: &Variable,
    parameter: &Parameter,
    node: NodeId,
) -> Result<ObjectWrite, DownloadError> {
    let line = parameter.line;
    if !variable.access.writable() {
        return Err(DownloadError::ReadOnly { line, object });
    }
    let value = match &parameter.value {
        ParameterValue::Value(value) => value,
        ParameterValue::File(_) => return Err(DownloadError::File { line, object }),
    };
    let code = variable.data_type.code();
    let data = value.encode(variable.data_type, node);
    Ok(ObjectWrite {
        object,
        data: data.ok_or(DownloadError::DataType { line, object, code })?,
        readable: variable.access.readable(),
        line,
    })
}

/// The index of the communication parameter of the PDO that `index` is about.
fn communication_parameter(index: u16) -> Option<u16> {
    match index {
        0x1400..=0x15FF | 0x1800..=0x19FF => Some(index),
        0x1600..=0x17FF | 0x1A00..=0x1BFF => Some(index - 0x200),
        _ => None,
    }
}

/// The writes of one PDO, of which `stated` is stated.
fn remap(
    dcf: &Eds,
    node: NodeId,
    communication: u16,
    mut stated: BTreeMap<Object, ObjectWrite>,
    writes: &mut Vec<ObjectWrite>,
) -> Result<(), DownloadError> {
    let line = stated.values().next().map_or(0, |first| first.line);
    let mapping = communication + 0x200;
    let cob_id = Object::new(communication, 1);
    let on = take(dcf, node, &mut stated, cob_id, DataType::Unsigned32, line)?;
    let off = PdoCobId(number(&on.data)).invalid();
    let off = ObjectWrite { data: off.0.to_le_bytes().to_vec(), ..on.clone() };
    let stays_off = off == on;
    writes.push(off);
    if stated.keys().any(|object| object.index == mapping) {
        let count = Object::new(mapping, 0);
        let full = take(dcf, node, &mut stated, count, DataType::Unsigned8, line)?;
        let entries = number(&full.data);
        writes.push(ObjectWrite { data: vec![0], ..full.clone() });
        let effective = |object: &Object| u32::from(object.subindex) <= entries;
        let mapped = stated.iter().filter(|(object, _)| object.index == mapping);
        let mapped = mapped.filter(|(object, _)| effective(object));
        writes.extend(mapped.map(|(_, write)| write.clone()));
        writes.push(full);
    }
    let others = stated.into_iter();
    let others = others.filter(|(object, _)| object.index == communication);
    writes.extend(others.map(|(_, write)| write));
    if !stays_off {
        writes.push(on);
    }
    Ok(())
}

/// The write of `object`: the stated value, else the default, which an unconfigured device has.
fn take(
    dcf: &Eds,
    node: NodeId,
    stated: &mut BTreeMap<Object, ObjectWrite>,
    object: Object,
    data_type: DataType,
    line: u32,
) -> Result<ObjectWrite, DownloadError> {
    let default = || {
        let value = dcf.variable(object)?.default.as_ref()?;
        Some(ObjectWrite { object, data: value.encode(data_type, node)?, readable: true, line })
    };
    let write = stated.remove(&object).or_else(default);
    let right_size = |write: &ObjectWrite| Some(write.data.len()) == data_type.size();
    let error = DownloadError::NoPdoState { line, object };
    write.filter(right_size).ok_or(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEVICE: &str = "
[1017]
ParameterName=heartbeat
DataType=6
AccessType=rw
DefaultValue=0
[1018]
ObjectType=9
[1018sub1]
ParameterName=vendor
DataType=7
AccessType=ro
[1801]
ObjectType=9
[1801sub1]
DataType=7
AccessType=rw
DefaultValue=$NODEID+0xC0000280
[1801sub2]
DataType=5
AccessType=rw
[1801sub3]
DataType=6
AccessType=rw
[1A01]
ObjectType=9
[1A01sub0]
DataType=5
AccessType=rw
DefaultValue=1
[1A01sub1]
DataType=7
AccessType=rw
[1A01sub2]
DataType=7
AccessType=rw
[1A01sub3]
DataType=7
AccessType=rw
[1019]
DataType=5
AccessType=const
[2000]
DataType=9
AccessType=wo
[6065]
DataType=7
AccessType=rw
[7000]
DataType=0x40
AccessType=rw
";

    /// The device with these values, as `1801sub3=10`.
    fn dcf(values: &[&str]) -> Eds {
        let mut text = DEVICE.to_owned();
        for value in values {
            let (name, value) = value.split_once('=').unwrap();
            let section = format!("[{name}]\n");
            let key = if value.contains('.') { "DownloadFile" } else { "ParameterValue" };
            assert!(text.contains(&section));
            text = text.replace(&section, &format!("{section}{key}={value}\n"));
        }
        Eds::read(text.as_bytes()).unwrap()
    }

    fn writes(values: &[&str]) -> Result<Vec<String>, DownloadError> {
        let written = download(&dcf(values), NodeId::new(2).unwrap())?.writes;
        let write = |write: &ObjectWrite| {
            let data: String = write.data.iter().map(|byte| format!("{byte:02X}")).collect();
            format!("{} {data}", write.object)
        };
        Ok(written.iter().map(write).collect())
    }

    #[test]
    fn stated_values_are_written_in_ascending_order() {
        let expected = ["0x1017:00 6400", "0x2000:00 4142", "0x6065:00 FFFFFFFF"];
        let asked = ["6065=0xFFFFFFFF", "1017=100", "2000=AB"];
        assert_eq!(writes(&asked).unwrap(), expected);
        assert_eq!(writes(&["1017=0"]).unwrap(), ["0x1017:00 0000"], "the default");
        assert_eq!(writes(&[]).unwrap(), [""; 0]);
        let readable = |name| {
            let asked = dcf(&[name]);
            download(&asked, NodeId::MIN).unwrap().writes[0].readable
        };
        assert!(readable("1017=1") && !readable("2000=A"));
    }

    #[test]
    fn a_pdo_is_off_and_empty_while_it_is_mapped() {
        let asked = [
            "1801sub1=$NODEID+0x40000280",
            "1801sub2=1",
            "1801sub3=0",
            "1A01sub0=2",
            "1A01sub1=0x60410010",
            "1A01sub2=0x60640020",
            "1A01sub3=0",
            "6065=1",
        ];
        let expected = [
            "0x6065:00 01000000",
            "0x1801:01 820200C0",
            "0x1a01:00 00",
            "0x1a01:01 10004160",
            "0x1a01:02 20006460",
            "0x1a01:00 02",
            "0x1801:02 01",
            "0x1801:03 0000",
            "0x1801:01 82020040",
        ];
        assert_eq!(writes(&asked).unwrap(), expected);
    }

    #[test]
    fn what_a_pdo_needs_and_the_file_does_not_state_is_the_default() {
        // Off by default: it stays so, and is told once.
        let expected = ["0x1801:01 820200C0", "0x1801:02 01"];
        assert_eq!(writes(&["1801sub2=1"]).unwrap(), expected);
        let expected = ["0x1801:01 820200C0", "0x1a01:00 00", "0x1a01:01 10004160", "0x1a01:00 01"];
        assert_eq!(writes(&["1A01sub1=0x60410010"]).unwrap(), expected);
        let mut unknown = dcf(&["1801sub2=1"]);
        let entry = unknown.objects.get_mut(&0x1801).unwrap();
        entry.variables.get_mut(&1).unwrap().default = None;
        let error = download(&unknown, NodeId::MIN).unwrap_err();
        let object = Object::new(0x1801, 1);
        assert!(matches!(error, DownloadError::NoPdoState { object: found, .. } if found == object));
    }

    #[test]
    fn what_cannot_be_written_is_refused_at_its_line() {
        let line_of = |name: &str| {
            let at = DEVICE.find(name).unwrap();
            DEVICE[..at].matches('\n').count() as u32 + 2
        };
        let (line, object) = (line_of("[1019]"), Object::new(0x1019, 0));
        let error = DownloadError::ReadOnly { line, object };
        assert_eq!(writes(&["1019=1"]), Err(error));
        let (line, object) = (line_of("[7000]"), Object::new(0x7000, 0));
        let error = DownloadError::DataType { line, object, code: 0x40 };
        assert_eq!(writes(&["7000=1"]), Err(error));
        let error = DownloadError::File { line, object };
        assert_eq!(writes(&["7000=table.bin"]), Err(error));
    }

    #[test]
    fn the_identity_and_objects_that_refuse_a_download_are_left_out() {
        let mut asked = dcf(&["1018sub1=0xFB", "1017=100", "6065=1"]);
        let window = asked.objects.get_mut(&0x6065).unwrap();
        window.variables.get_mut(&0).unwrap().refuses_download = true;
        let download = download(&asked, NodeId::MIN).unwrap();
        assert_eq!((download.writes.len(), download.left_out), (1, 2));
    }
}
