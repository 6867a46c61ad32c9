//! Entry of one object in an electronic data sheet (EDS or DCF).

use std::path::Path;

use anyhow::{Context, anyhow, bail};
use canopen::eds::{DataType, Eds, EdsError, Entry, Value, Variable};
use canopen::{NodeId, Object};
use mrroc::cell::printable;
use mrroc::{input, streams};

use super::sdo::NOTATION;
use super::value::{self, Type};

/// Greatest number of objects that a refusal lists.
const MOST_LISTED: usize = 12;

/// An object on the command line: an address, or a name in a data sheet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Selector {
    /// Index and sub-index.
    Address(Object),
    /// Name of an object in the data sheet.
    Name(String),
}

/// One object as its data sheet describes it.
#[derive(Debug)]
pub(super) struct DataSheet {
    /// Path of the file, for error messages.
    path: String,
    pub(super) object: Object,
    /// Name of the object. The name of a sub-index is preceded by the name of its object.
    pub(super) name: String,
    variable: Variable,
    /// Reason why the limits of the object are not known.
    limits: Option<EdsError>,
}

/// Reads a data sheet, and shows its flaws.
pub(super) fn read(path: &Path) -> anyhow::Result<Eds> {
    let shown = printable(&path.display().to_string());
    let bytes = input::read(path, input::SHEET).with_context(|| shown.clone())?;
    let eds = Eds::read(&bytes).map_err(|error| anyhow!("{shown}:{error}"))?;
    for flaws in eds.flawed_lines() {
        streams::warn(format_args!("mrroc: warning: {shown}:{flaws}"));
    }
    Ok(eds)
}

/// Name of a variable. The name of a sub-index is preceded by the name of its object.
pub(super) fn name_of(entry: &Entry, variable: &Variable) -> String {
    let name = match entry.object_type.has_subindices() {
        true => format!("{}: {}", entry.name, variable.name),
        false => variable.name.clone(),
    };
    printable(&name)
}

/// Type of the values of a data type; `None` for a type that has no name on the command line.
pub(super) fn value_type(data_type: DataType) -> Option<Type> {
    Some(match data_type {
        DataType::Boolean => Type::Bool,
        DataType::Integer8 => Type::I8,
        DataType::Integer16 => Type::I16,
        DataType::Integer32 => Type::I32,
        DataType::Integer64 => Type::I64,
        DataType::Unsigned8 => Type::U8,
        DataType::Unsigned16 => Type::U16,
        DataType::Unsigned32 => Type::U32,
        DataType::Unsigned64 => Type::U64,
        DataType::Real32 => Type::F32,
        DataType::Real64 => Type::F64,
        DataType::VisibleString => Type::String,
        DataType::OctetString | DataType::Domain => Type::Hex,
        _ => return None,
    })
}

/// The objects of a data sheet with their names.
fn named(eds: &Eds) -> impl Iterator<Item = (Object, &Variable, String)> {
    eds.variables().map(|(object, variable)| (object, variable, name_of(&eds.objects[&object.index], variable)))
}

/// The object of a name. The name of a sub-index may be preceded by the name of its object, which distinguishes
/// sub-indices of the same name. Upper and lower case are equal.
fn object_of(eds: &Eds, name: &str, path: &str) -> anyhow::Result<Object> {
    let wanted = name.trim().to_lowercase();
    let objects = |is_wanted: &dyn Fn(&Variable, &str) -> bool| -> Vec<_> {
        let found = named(eds).filter(|(_, variable, name)| is_wanted(variable, name));
        found.map(|(object, _, name)| (object, name)).collect()
    };
    let whole = objects(&|_, name| name.to_lowercase() == wanted);
    let found = match whole.is_empty() {
        true => objects(&|variable, _| printable(&variable.name).to_lowercase() == wanted),
        false => whole,
    };
    let shown = printable(name);
    match found.as_slice() {
        [(object, _)] => Ok(*object),
        [] => {
            let near = objects(&|_, name| !wanted.is_empty() && name.to_lowercase().contains(&wanted));
            let near = if near.is_empty() { NOTATION.to_owned() } else { format!("similar are {}", listed(&near)) };
            bail!("{path} has no object called \"{shown}\"; {near}")
        }
        several => bail!("{path} has {} objects called \"{shown}\": {}", several.len(), listed(several)),
    }
}

/// Addresses with names, at most [`MOST_LISTED`] of them.
fn listed(objects: &[(Object, String)]) -> String {
    let shown: Vec<_> = objects.iter().take(MOST_LISTED).map(|(object, name)| format!("{object} {name}")).collect();
    let more = objects.len() - shown.len();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    shown.join(", ") + &more
}

impl DataSheet {
    /// Reads the file. An object that the file does not declare is refused.
    pub(super) fn read(path: &Path, selected: &Selector) -> anyhow::Result<Self> {
        let eds = read(path)?;
        Self::of(&eds, selected, printable(&path.display().to_string()))
    }

    fn of(eds: &Eds, selected: &Selector, path: String) -> anyhow::Result<Self> {
        let object = match selected {
            Selector::Address(object) => *object,
            Selector::Name(name) => object_of(eds, name, &path)?,
        };
        let (Some(entry), Some(variable)) = (eds.objects.get(&object.index), eds.variable(object)) else {
            match eds.flaw_of(object) {
                Some(flaw) => bail!("{path}:{}, so the file does not describe {object}", flaw.error),
                None => bail!("{path} has no object {object}"),
            }
        };
        let limits = eds.flaw_of_limits(object).map(|flaw| flaw.error);
        Ok(Self { path, object, name: name_of(entry, variable), variable: variable.clone(), limits })
    }

    /// Data type of the object's values; `None` for a type that has no name on the command line.
    pub(super) fn value_type(&self) -> Option<Type> {
        value_type(self.variable.data_type)
    }

    /// Refuses to read a write-only object.
    pub(super) fn check_read(&self) -> anyhow::Result<()> {
        if !self.variable.access.readable() {
            let (object, name, path) = (self.object, &self.name, &self.path);
            bail!("{object} {name} is write-only by {path}");
        }
        Ok(())
    }

    /// Refuses to write a read-only object. Also refuses a value of a wrong length, and a value outside the limits that
    /// the data sheet states for `node`.
    pub(super) fn check_write(&self, node: NodeId, data: &[u8]) -> anyhow::Result<()> {
        let Self { object, name, path, .. } = self;
        if !self.variable.access.writable() {
            bail!("{object} {name} is read-only by {path}");
        }
        if let Some(error) = self.limits {
            bail!("{path}:{error}, so the limits of {object} {name} are not known: mend the line, or leave out --eds");
        }
        let length = self.value_type().and_then(Type::bytes);
        if let Some(length) = length.filter(|length| *length != data.len()) {
            let given = data.len();
            bail!("{object} {name} takes {length} bytes by {path}, not {given}: leave out --type");
        }
        let number = match self.variable.data_type.range() {
            Some((least, _)) if least < 0 => value::signed(data).map(i128::from),
            Some(_) => value::unsigned(data).map(i128::from),
            None => None,
        };
        let Some(number) = number else {
            return Ok(());
        };
        let bound = |bound: &Option<Value>| bound.as_ref().and_then(|bound| bound.integer(node));
        if let Some(low) = bound(&self.variable.low).filter(|&low| number < low) {
            bail!("{object} {name} takes no less than {low} by {path}");
        }
        if let Some(high) = bound(&self.variable.high).filter(|&high| number > high) {
            bail!("{object} {name} takes no more than {high} by {path}");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n\
        [1000]\nParameterName=Device type\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\n\
        [OptionalObjects]\nSupportedObjects=2\n1=0x1017\n2=0x2000\n\
        [1017]\nParameterName=Heartbeat\nObjectType=0x7\nDataType=0x0006\nAccessType=rw\nLowLimit=10\nHighLimit=500\n\
        [2000]\nParameterName=Gains\nObjectType=0x9\nSubNumber=2\n\
        [2000sub0]\nParameterName=Count\nObjectType=0x7\nDataType=0x0005\nAccessType=ro\n\
        [2000sub1]\nParameterName=P\nObjectType=0x7\nDataType=0x0003\nAccessType=wo\nLowLimit=-5\n";

    fn sheet(index: u16, subindex: u8) -> anyhow::Result<DataSheet> {
        let eds = Eds::read(FILE.as_bytes()).unwrap();
        DataSheet::of(&eds, &Selector::Address(Object::new(index, subindex)), "drive.eds".to_owned())
    }

    fn text<T>(result: anyhow::Result<T>) -> String {
        result.err().map_or(String::new(), |error| error.to_string())
    }

    #[test]
    fn a_name_of_a_data_sheet_does_nothing_to_a_terminal() {
        let red = FILE.replace("Heartbeat", "Heart\u{1b}[31mbeat");
        let eds = Eds::read(red.as_bytes()).unwrap();
        let heartbeat = Selector::Address(Object::new(0x1017, 0));
        let sheet = DataSheet::of(&eds, &heartbeat, "drive.eds".to_owned());
        assert_eq!(sheet.unwrap().name, "Heart\\u{1b}[31mbeat");
    }

    #[test]
    fn the_data_sheet_names_and_types_an_object() {
        let cases = [
            (0x1000, 0, "Device type", Type::U32),
            (0x1017, 0, "Heartbeat", Type::U16),
            (0x2000, 1, "Gains: P", Type::I16),
        ];
        for (index, subindex, name, ty) in cases {
            let sheet = sheet(index, subindex).unwrap();
            assert_eq!((sheet.name.as_str(), sheet.value_type()), (name, Some(ty)));
        }
        assert_eq!(text(sheet(0x2000, 2)), "drive.eds has no object 0x2000:02");
    }

    #[test]
    fn what_the_data_sheet_does_not_allow_is_refused_before_it_is_sent() {
        let node = NodeId::new(1).unwrap();
        let write = |index, subindex, data: &[u8]| text(sheet(index, subindex).unwrap().check_write(node, data));
        assert_eq!(write(0x1000, 0, &[0; 4]), "0x1000:00 Device type is read-only by drive.eds");
        let least = "0x1017:00 Heartbeat takes no less than 10 by drive.eds";
        assert_eq!(write(0x1017, 0, &[9, 0]), least);
        let most = "0x1017:00 Heartbeat takes no more than 500 by drive.eds";
        assert_eq!(write(0x1017, 0, &[0xF5, 0x01]), most);
        for fits in [[10, 0], [0xF4, 0x01]] {
            assert_eq!(write(0x1017, 0, &fits), "");
        }
        assert_eq!(write(0x2000, 1, &[0xFB, 0xFF]), "");
        for data in [&[][..], &[0], &[0; 4], &[0; 9]] {
            let given = data.len();
            let length = format!("0x2000:01 Gains: P takes 2 bytes by drive.eds, not {given}: leave out --type");
            assert_eq!(write(0x2000, 1, data), length);
        }
        let signed = "0x2000:01 Gains: P takes no less than -5 by drive.eds";
        assert_eq!(write(0x2000, 1, &[0xFA, 0xFF]), signed);
        assert_eq!(text(sheet(0x1017, 0).unwrap().check_read()), "");
        let read = text(sheet(0x2000, 1).unwrap().check_read());
        assert_eq!(read, "0x2000:01 Gains: P is write-only by drive.eds");
    }

    #[test]
    fn a_file_that_is_no_data_sheet_is_refused_by_file_and_line() {
        // The first line of this file is already invalid.
        let refused = text(read(Path::new("src/lib.rs")));
        let rest = refused.strip_prefix("src/lib.rs:").unwrap_or_default();
        assert!(rest.starts_with(|c: char| c.is_ascii_digit()), "{refused}");
    }

    /// Address and name of the object of this name, or the refusal.
    fn of_name(file: &str, name: &str) -> String {
        let eds = Eds::read(file.as_bytes()).unwrap();
        match DataSheet::of(&eds, &Selector::Name(name.to_owned()), "drive.eds".to_owned()) {
            Ok(sheet) => format!("{} {}", sheet.object, sheet.name),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn an_object_is_found_by_its_name() {
        for (name, object) in [
            ("Heartbeat", "0x1017:00 Heartbeat"),
            ("device type", "0x1000:00 Device type"),
            ("Gains: P", "0x2000:01 Gains: P"),
            ("p", "0x2000:01 Gains: P"),
        ] {
            assert_eq!(of_name(FILE, name), object);
        }
        let unknown = "drive.eds has no object called \"gain\"; similar are 0x2000:00 Gains: Count, 0x2000:01 Gains: P";
        assert_eq!(of_name(FILE, "gain"), unknown);
        assert!(of_name(FILE, "24641:0").contains("no object called \"24641:0\"; an object is INDEX:SUB"));
    }

    #[test]
    fn a_name_of_several_objects_is_refused_with_all_of_them() {
        let two = FILE.replace("[2000sub0]\nParameterName=Count", "[2000sub0]\nParameterName=P");
        let refused = "drive.eds has 2 objects called \"P\": 0x2000:00 Gains: P, 0x2000:01 Gains: P";
        assert_eq!(of_name(&two, "P"), refused);
        let many: String = (0..20)
            .map(|at| format!("[{:04X}]\nParameterName=Gain\nDataType=7\nAccessType=rw\n", 0x2100 + at))
            .collect();
        let refused = of_name(&many, "gain");
        assert!(refused.ends_with("0x210b:00 Gain and 8 more"), "{refused}");
    }

    #[test]
    fn a_flaw_refuses_what_depends_on_it_and_nothing_else() {
        let spoilt = FILE.replace("HighLimit=500", "HighLimit=70000").replace("DataType=0x0003\n", "");
        let eds = Eds::read(spoilt.as_bytes()).unwrap();
        let sheet = |index, subindex| {
            DataSheet::of(&eds, &Selector::Address(Object::new(index, subindex)), "drive.eds".to_owned())
        };
        let heartbeat = sheet(0x1017, 0).unwrap();
        assert_eq!(text(heartbeat.check_read()), "");
        let node = NodeId::new(1).unwrap();
        let refused = "drive.eds:19: out of range; 0 to 65535 fit, so the limits of 0x1017:00 Heartbeat are not known: \
            mend the line, or leave out --eds";
        assert_eq!(text(heartbeat.check_write(node, &[20, 0])), refused);
        let refused = "drive.eds:29: the section lacks DataType; add it, so the file does not describe 0x2000:01";
        assert_eq!(text(sheet(0x2000, 1)), refused);
        assert_eq!(text(sheet(0x1000, 0).unwrap().check_read()), "");
    }

    /// A data sheet without a flaw, of the corpus of data sheets with one flaw each.
    const SOUND: &str = include_str!("../../../drivers/canopen/tests/sheets/sound.eds");

    /// The lines of a section up to the next heading, wherever the section stands.
    fn section<'a>(lines: &[&'a str], heading: &str) -> Vec<&'a str> {
        let mut inside = false;
        let lines = lines.iter().filter(|line| {
            if line.starts_with('[') {
                inside = **line == heading;
            }
            inside && !line.is_empty()
        });
        lines.copied().collect()
    }

    /// Asserts that `sdo` can use an object that a mutation did not touch.
    fn untouched_object_works(lines: &[&str]) {
        let text_of_file = lines.join("\n");
        let eds = Eds::read(text_of_file.as_bytes()).unwrap_or_else(|error| panic!("{error}\n{text_of_file}"));
        let of = |selector| DataSheet::of(&eds, &selector, "drive.eds".to_owned());
        let sheet = of(Selector::Address(Object::new(0x3100, 0)));
        let sheet = sheet.unwrap_or_else(|error| panic!("{error}\n{text_of_file}"));
        assert_eq!((sheet.name.as_str(), sheet.value_type()), ("Gain", Some(Type::U8)), "{text_of_file}");
        assert_eq!(of(Selector::Name("gain".to_owned())).map(|found| found.object).ok(), Some(sheet.object));
        let node = NodeId::new(1).unwrap();
        assert_eq!(text(sheet.check_read()), "", "{text_of_file}");
        assert_eq!(text(sheet.check_write(node, &[200])), "", "{text_of_file}");
        let most = "0x3100:00 Gain takes no more than 200 by drive.eds";
        assert_eq!(text(sheet.check_write(node, &[201])), most, "{text_of_file}");
    }

    #[test]
    fn whatever_one_line_of_a_data_sheet_becomes_an_object_elsewhere_is_read_and_written() {
        const OTHERS: &[&str] = &[
            "",
            "x",
            "# x",
            "[",
            "]",
            "[1000",
            "[1017]",
            "[3101sub1]",
            "[31011]",
            "[DeviceInfo]",
            "=",
            "DataType=x",
            "DataType=0x0007",
            "ObjectType=99",
            "AccessType=",
            "SubNumber=200",
            "SubNumber=0",
            "CompactSubObj=255",
            "LowLimit=0x100000000",
            "HighLimit=1LL",
            "DefaultValue=$MY_NODE_ID+1",
            "DefaultValue=0.0f",
            "ParameterValue=1",
            "NrOfEntries=1",
            "1=0x9999",
            "NodeID=0",
            "NodeID=0xFF",
        ];
        let lines: Vec<_> = SOUND.lines().collect();
        let gain = section(&lines, "[3100]");
        assert!(gain.len() > 5);
        untouched_object_works(&lines);
        let mut tried = 0;
        let mut try_this = |changed: &[&str]| {
            if section(changed, "[3100]") == gain {
                untouched_object_works(changed);
                tried += 1;
            }
        };
        for at in 0..lines.len() {
            let (before, [line, after @ ..]) = lines.split_at(at) else { unreachable!("there are lines") };
            try_this(&[before, after].concat());
            try_this(&[before, &[line, line], after].concat());
            for other in OTHERS {
                try_this(&[before, &[*other], after].concat());
                try_this(&[before, &[*other, line], after].concat());
            }
            for cut in 1..line.len() {
                let (head, tail) = line.split_at(cut);
                try_this(&[before, &[head, tail], after].concat());
                try_this(&[before, &[head], after].concat());
            }
        }
        assert!(tried > 4000, "{tried} mutations");
    }
}
