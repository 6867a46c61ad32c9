//! Entry of one object in an electronic data sheet (EDS or DCF).

use std::path::Path;

use anyhow::{Context, anyhow, bail};
use canopen::eds::{DataType, Eds, Value, Variable};
use canopen::{NodeId, Object};
use mrroc::cell::printable;

use super::value::{self, Type};
use mrroc::input;

/// One object as its data sheet describes it.
pub(super) struct DataSheet {
    /// Path of the file, for error messages.
    path: String,
    object: Object,
    /// Name of the object. The name of a sub-index is preceded by the name of its object.
    pub(super) name: String,
    variable: Variable,
}

impl DataSheet {
    /// Reads the file. An object that the file does not declare is refused.
    pub(super) fn read(path: &Path, object: Object) -> anyhow::Result<Self> {
        let shown = || printable(&path.display().to_string());
        let bytes = input::read(path, input::SHEET).with_context(shown)?;
        let eds = Eds::read(&bytes).map_err(|error| anyhow!("{}:{error}", shown()))?;
        Self::of(&eds, object, shown())
    }

    fn of(eds: &Eds, object: Object, path: String) -> anyhow::Result<Self> {
        let (Some(entry), Some(variable)) = (eds.objects.get(&object.index), eds.variable(object)) else {
            bail!("{path} has no object {object}");
        };
        let name = if entry.object_type.has_subindices() {
            format!("{}: {}", entry.name, variable.name)
        } else {
            variable.name.clone()
        };
        Ok(Self { path, object, name: printable(&name), variable: variable.clone() })
    }

    /// Data type of the object's values; `None` for a type that has no name on the command line.
    pub(super) fn value_type(&self) -> Option<Type> {
        Some(match self.variable.data_type {
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
        DataSheet::of(&eds, Object::new(index, subindex), "drive.eds".to_owned())
    }

    fn text<T>(result: anyhow::Result<T>) -> String {
        result.err().map_or(String::new(), |error| error.to_string())
    }

    #[test]
    fn a_name_of_a_data_sheet_does_nothing_to_a_terminal() {
        let red = FILE.replace("Heartbeat", "Heart\u{1b}[31mbeat");
        let eds = Eds::read(red.as_bytes()).unwrap();
        let sheet = DataSheet::of(&eds, Object::new(0x1017, 0), "drive.eds".to_owned());
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
        let refused = text(DataSheet::read(Path::new("src/lib.rs"), Object::new(0x1000, 0)));
        let rest = refused.strip_prefix("src/lib.rs:").unwrap_or_default();
        assert!(rest.starts_with(|c: char| c.is_ascii_digit()), "{refused}");
    }
}
