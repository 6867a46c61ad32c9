//! Download of a DCF (CiA 306-1 §7): the values that a DCF states for its device, in the order of their writes.
//!
//! Read [`crate::eds`] first, then [`download`].

use std::collections::BTreeMap;

use thiserror::Error;

use crate::eds::{DataType, Eds, EdsCause, EdsError, Flaw, Parameter, ParameterValue, Part, Variable};
use crate::objects::VENDOR_ID;
use crate::pdo::PdoCobId;
use crate::{NodeId, Object, number};

/// The values that a DCF states.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Download {
    /// The values of writable objects, in their order on the bus.
    pub writes: Vec<ObjectWrite>,
    /// The values of read-only objects, ascending. These values describe the device at which the file was made.
    pub compared: Vec<ObjectWrite>,
    /// Number of stated values that are neither written nor compared. These are the identity (object 0x1018), objects
    /// with bit 0 of `ObjFlags` (CiA 306-1 §6.6.3.3), mapping entries beyond their count, and read-only values without
    /// a layout on the bus. Tools that store all values of a device set the bit.
    pub left_out: usize,
    /// The lines that state a value for a writable object, with bit 0 of `ObjFlags` unset. Some of them cause no write,
    /// such as mapping entries beyond their count.
    pub lines: Vec<(u32, Object)>,
}

impl Download {
    /// Number of writes whose value is the default.
    pub fn defaults(&self) -> usize {
        self.writes.iter().filter(|write| write.is_default).count()
    }
}

/// One stated value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectWrite {
    /// The object to write.
    pub object: Object,
    /// The value, as it goes over the bus.
    pub data: Vec<u8>,
    /// Whether it can be read back.
    pub readable: bool,
    /// Whether the value is the default. A device that has this value need not be written.
    pub is_default: bool,
    /// The line of the file that asks for it, from 1.
    pub line: u32,
}

/// Why a DCF cannot be downloaded: the line, what is wrong there, what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DownloadError {
    /// A line on which a stated value, the identity or the place of the device depends.
    #[error("{0}")]
    Sheet(EdsError),
    #[error("{line}: {object} has data type {code:#06x}, whose values cannot be written; remove its ParameterValue")]
    DataType { line: u32, object: Object, code: u16 },
    #[error("{line}: {object} is to be written from a file, which is not supported; remove its DownloadFile")]
    File { line: u32, object: Object },
    #[error("{line}: a PDO is changed whose {object} has neither ParameterValue nor DefaultValue; state it")]
    NoPdoState { line: u32, object: Object },
}

impl DownloadError {
    /// The line of the file, from 1.
    pub fn line(&self) -> u32 {
        match *self {
            Self::Sheet(error) => error.line,
            Self::DataType { line, .. } | Self::File { line, .. } | Self::NoPdoState { line, .. } => line,
        }
    }
}

/// A DCF that cannot be downloaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// All reasons, ascending by line.
    pub errors: Vec<DownloadError>,
    /// The values that could be downloaded without the others.
    pub rest: Download,
}

/// The stated values of `dcf` for a device with this node-ID, or all reasons why they cannot be downloaded. A value equal to the default is included, since the device may have stored another value.
///
/// Objects are written in ascending order, PDOs last. A PDO with any stated value is switched off (COB-ID with bit
/// 31), and its mapping is cleared, filled and counted. Its other parameters follow, and its COB-ID last (CiA 301
/// §7.5.2.36, §7.5.2.38). Entries beyond the count have no effect and are not written.
pub fn download(dcf: &Eds, node: NodeId) -> Result<Download, Refusal> {
    let mut download = Download::default();
    let mut errors: Vec<_> = dcf.flaws.iter().filter(|flaw| is_used(flaw)).map(|flaw| flaw.error).collect();
    errors.dedup();
    let mut errors: Vec<_> = errors.into_iter().map(DownloadError::Sheet).collect();
    let mut pdos: BTreeMap<u16, BTreeMap<Object, ObjectWrite>> = BTreeMap::new();
    for (object, variable) in dcf.variables() {
        let Some(parameter) = &variable.parameter else {
            continue;
        };
        let writable = variable.access.writable();
        if variable.refuses_download || object.index == VENDOR_ID.index && !writable {
            download.left_out += 1;
            continue;
        }
        if writable {
            download.lines.push((parameter.line, object));
        }
        match (write(object, variable, parameter, node), communication_parameter(object.index)) {
            (Ok(read), _) if !writable => download.compared.push(read),
            (Err(_), _) if !writable => download.left_out += 1,
            // The other writes of a PDO change what the device holds.
            (Ok(write), Some(pdo)) => {
                pdos.entry(pdo).or_default().insert(object, ObjectWrite { is_default: false, ..write });
            }
            (Ok(write), None) => download.writes.push(write),
            (Err(error), _) => errors.push(error),
        }
    }
    for (communication, stated) in pdos {
        match remap(dcf, node, communication, stated, &mut download.writes) {
            Ok(without_effect) => download.left_out += without_effect,
            Err(error) => errors.push(error),
        }
    }
    errors.sort_by_key(DownloadError::line);
    if errors.is_empty() { Ok(download) } else { Err(Refusal { errors, rest: download }) }
}

/// Whether a download depends on the line of a flaw. The default of an object 0x1018 is the expected identity.
fn is_used(flaw: &Flaw) -> bool {
    let identity = |object: Object| object.index == VENDOR_ID.index && flaw.error.cause != EdsCause::Spelling;
    match flaw.part {
        Part::Place | Part::Identity => true,
        Part::Default(object) => flaw.stated || identity(object),
        Part::Nothing | Part::Entry(_) | Part::Variable(_) | Part::Limits(_) => flaw.stated,
    }
}

fn write(
    object: Object,
    variable: &Variable,
    parameter: &Parameter,
    node: NodeId,
) -> Result<ObjectWrite, DownloadError> {
    let line = parameter.line;
    let value = match &parameter.value {
        ParameterValue::Value(value) => value,
        ParameterValue::File(_) => return Err(DownloadError::File { line, object }),
    };
    let code = variable.data_type.code();
    let data = value.encode(variable.data_type, node).ok_or(DownloadError::DataType { line, object, code })?;
    let default = variable.default.as_ref().and_then(|default| default.encode(variable.data_type, node));
    let is_default = default.as_ref() == Some(&data);
    Ok(ObjectWrite { object, data, readable: variable.access.readable(), is_default, line })
}

/// The index of the communication parameter of the PDO that `index` is about.
fn communication_parameter(index: u16) -> Option<u16> {
    match index {
        0x1400..=0x15FF | 0x1800..=0x19FF => Some(index),
        0x1600..=0x17FF | 0x1A00..=0x1BFF => Some(index - 0x200),
        _ => None,
    }
}

/// Adds the writes of one PDO, of which `stated` is stated, and returns how many of the stated values are not written.
fn remap(
    dcf: &Eds,
    node: NodeId,
    communication: u16,
    mut stated: BTreeMap<Object, ObjectWrite>,
    writes: &mut Vec<ObjectWrite>,
) -> Result<usize, DownloadError> {
    let mut without_effect = 0;
    let line = stated.values().next().map_or(0, |first| first.line);
    let mapping = communication + 0x200;
    let cob_id = Object::new(communication, 1);
    let on = take(dcf, node, &mut stated, cob_id, DataType::Unsigned32, line)?;
    let off = PdoCobId(number(&on.data)).invalid();
    let off = ObjectWrite { data: off.0.to_le_bytes().to_vec(), ..on.clone() };
    let stays_off = off.data == on.data;
    writes.push(off);
    if stated.keys().any(|object| object.index == mapping) {
        let count = Object::new(mapping, 0);
        let full = take(dcf, node, &mut stated, count, DataType::Unsigned8, line)?;
        let entries = number(&full.data);
        writes.push(ObjectWrite { data: vec![0], ..full.clone() });
        for (_, write) in stated.iter().filter(|(object, _)| object.index == mapping) {
            match u32::from(write.object.subindex) <= entries {
                true => writes.push(write.clone()),
                false => without_effect += 1,
            }
        }
        writes.push(full);
    }
    let others = stated.into_iter();
    let others = others.filter(|(object, _)| object.index == communication);
    writes.extend(others.map(|(_, write)| write));
    if !stays_off {
        writes.push(on);
    }
    Ok(without_effect)
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
        let flawed = dcf.flaws.iter().any(|flaw| flaw.part == Part::Default(object));
        let data = value.encode(data_type, node).filter(|_| !flawed)?;
        Some(ObjectWrite { object, data, readable: true, is_default: false, line })
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

    fn writes(values: &[&str]) -> Result<Vec<String>, Vec<DownloadError>> {
        let written = download(&dcf(values), NodeId::new(2).unwrap()).map_err(|refusal| refusal.errors)?.writes;
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
        let errors = download(&unknown, NodeId::MIN).unwrap_err().errors;
        let object = Object::new(0x1801, 1);
        assert!(matches!(errors[..], [DownloadError::NoPdoState { object: found, .. }] if found == object));
    }

    #[test]
    fn what_cannot_be_written_is_refused_at_its_line_and_all_of_it_at_once() {
        let line_of = |name: &str| {
            let at = DEVICE.find(name).unwrap();
            DEVICE[..at].matches('\n').count() as u32 + 2
        };
        let (line, object) = (line_of("[7000]"), Object::new(0x7000, 0));
        let no_layout = DownloadError::DataType { line, object, code: 0x40 };
        assert_eq!(writes(&["7000=1"]), Err(vec![no_layout]));
        let error = DownloadError::File { line, object };
        assert_eq!(writes(&["7000=table.bin"]), Err(vec![error]));
        let (line, object) = (line_of("[6065]"), Object::new(0x6065, 0));
        let file = DownloadError::File { line, object };
        // The line of the second value is one lower, below the first.
        let below = DownloadError::DataType { line: no_layout.line() + 1, object: Object::new(0x7000, 0), code: 0x40 };
        assert_eq!(writes(&["7000=1", "6065=table.bin", "1017=5"]).map_err(|errors| errors.len()), Err(2));
        assert_eq!(writes(&["6065=table.bin", "7000=1"]), Err(vec![file, below]));
    }

    #[test]
    fn a_read_only_value_is_compared_and_a_value_equal_to_the_default_is_marked() {
        let download = |values: &[&str]| download(&dcf(values), NodeId::MIN).unwrap();
        let read = download(&["1019=7", "1017=0", "6065=0"]);
        let compared: Vec<_> = read.compared.iter().map(|read| (read.object, read.data.as_slice())).collect();
        assert_eq!(compared, [(Object::new(0x1019, 0), &[7_u8][..])]);
        let writes: Vec<_> = read.writes.iter().map(|write| (write.object.index, write.is_default)).collect();
        // Object 0x6065 has no default.
        assert_eq!(writes, [(0x1017, true), (0x6065, false)]);
        assert_eq!((read.defaults(), read.left_out), (1, 0));
    }

    #[test]
    fn mapping_entries_beyond_the_count_are_counted_and_named_by_their_own_lines() {
        let read = dcf(&["1A01sub0=1", "1A01sub1=0x60410010", "1A01sub2=0x60640020", "1A01sub3=0"]);
        let read = download(&read, NodeId::MIN).unwrap();
        assert_eq!(read.left_out, 2);
        let objects: Vec<_> = read.lines.iter().map(|(_, object)| *object).collect();
        assert_eq!(objects, [0, 1, 2, 3].map(|subindex| Object::new(0x1A01, subindex)));
        let lines: BTreeMap<u32, Object> = read.lines.into_iter().collect();
        assert_eq!(lines.len(), 4, "each has its own line");
    }

    #[test]
    fn a_default_in_another_spelling_is_not_sent_for_a_pdo() {
        let text = DEVICE.replace("DefaultValue=$NODEID+0xC0000280", "DefaultValue=$MY_NODE_ID+0xC0000280");
        let text = text.replace("[1801sub2]\n", "[1801sub2]\nParameterValue=1\n");
        let eds = Eds::read(text.as_bytes()).unwrap();
        let object = Object::new(0x1801, 1);
        let errors = download(&eds, NodeId::MIN).unwrap_err().errors;
        assert!(matches!(errors[..], [DownloadError::NoPdoState { object: found, .. }] if found == object));
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
