//! Electronic data sheets of emulated nodes, made from the rows of their dictionaries.

use std::collections::BTreeMap;

use canopen::eds::{Access, DataType, DeviceInfo, Eds, Entry, FileInfo, ObjectType, Value, Variable};
use canopen::{Object, objects as named, pdo::PdoKind};

use super::objects::{DUMMIES, Place, pdo_parameter};
use super::table::{self, Slot};

/// Names of communication objects, at sub-index 0, and of their sub-indices, in addition to [`named::TABLE`].
const NAMES: &[(u16, u8, &str)] = &[
    (0x1003, 0, "Error history"),
    (0x1003, 1, "Error history 1"),
    (0x1010, 0, "Store parameters"),
    (0x1010, 1, "Save all parameters"),
    (0x1011, 0, "Restore default parameters"),
    (0x1016, 0, "Consumer heartbeat time"),
    (0x1016, 1, "Consumer 1 heartbeat time"),
    (0x1016, 2, "Consumer 2 heartbeat time"),
    (0x1018, 0, "Identity object"),
    (0x1018, 1, "Vendor ID"),
    (0x1029, 0, "Error behavior"),
    (0x1029, 1, "Communication error"),
    (0x1200, 0, "SDO server parameter"),
    (0x1200, 1, "COB-ID SDO client to server"),
    (0x1200, 2, "COB-ID SDO server to client"),
];

/// The names of a PDO's communication parameters, from sub-index 1.
const COMMUNICATION: [&str; 5] = ["COB-ID used by", "Transmission type", "Inhibit time", "Reserved", "Event timer"];

/// The dictionary of a unit, with what a data sheet says beyond its rows.
pub(crate) struct Sheet<'a> {
    pub(crate) table: &'a [table::Entry],
    /// Names of objects of the device, at sub-index 0, and of their sub-indices, in addition to [`named::TABLE`].
    pub(crate) names: &'a [(u16, u8, &'static str)],
    /// Objects of the device of type RECORD. Any other object of the device with sub-indices is an ARRAY.
    pub(crate) records: &'a [u16],
    /// Values of the unit in place of the table's defaults.
    pub(crate) stated: &'a [(Slot, u32)],
    /// Objects that differ from unit to unit of one kind and therefore have no default.
    pub(crate) individual: &'a [Object],
}

/// The head of a data sheet, as far as devices differ in it.
pub(crate) struct Head {
    pub(crate) file_name: &'static str,
    pub(crate) description: &'static str,
    pub(crate) creation_date: &'static str,
    pub(crate) vendor_name: &'static str,
    pub(crate) product_name: &'static str,
    /// Vendor-ID, product code and revision number.
    pub(crate) identity: [u32; 3],
}

impl Head {
    /// A data sheet without objects.
    fn eds(&self) -> Eds {
        let [vendor, product, revision] = self.identity.map(Some);
        Eds {
            file: FileInfo {
                file_name: self.file_name.into(),
                file_version: "1".into(),
                file_revision: "0".into(),
                eds_version: "4.0".into(),
                description: self.description.into(),
                creation_time: "12:00PM".into(),
                creation_date: self.creation_date.into(),
                created_by: "mrroc".into(),
            },
            device: DeviceInfo {
                vendor_name: self.vendor_name.into(),
                vendor_number: vendor,
                product_name: self.product_name.into(),
                product_number: product,
                revision_number: revision,
                order_code: "0".into(),
                baud_rates: vec![20, 50, 125, 250, 500, 800, 1000],
                simple_boot_up_slave: true,
                granularity: 8,
                rpdos: 4,
                tpdos: 4,
                lss: true,
                ..DeviceInfo::default()
            },
            dummies: DUMMIES.map(|bits| bits > 0),
            ..Eds::default()
        }
    }
}

impl Sheet<'_> {
    /// The data sheet with the objects of the dictionary and the dummies that RPDOs take.
    pub(crate) fn eds(&self, head: &Head, comments: Vec<String>) -> Eds {
        let mut eds = Eds { comments, ..head.eds() };
        for (row, entry) in self.table.iter().enumerate() {
            let index = entry.object.index;
            let object = eds.objects.entry(index).or_insert_with(|| Entry {
                name: self.object_name(entry),
                object_type: self.object_type(index),
                variables: BTreeMap::new(),
            });
            let stated = self.stated.iter().find(|(slot, _)| slot.row() == row);
            let variable = self.variable(entry, stated.map(|(_, value)| *value));
            object.variables.insert(entry.object.subindex, variable);
        }
        eds
    }

    fn known(&self, index: u16, subindex: u8) -> Option<&'static str> {
        let mut names = self.names.iter().chain(NAMES);
        names.find_map(|known| ((known.0, known.1) == (index, subindex)).then_some(known.2))
    }

    fn object_type(&self, index: u16) -> ObjectType {
        let mut objects = self.table.iter().map(|entry| entry.object);
        if !objects.any(|object| object.index == index && object.subindex > 0) {
            ObjectType::Variable
        } else if self.records.contains(&index) || matches!(index, 0x1018 | 0x1200) || (0x1400..0x1C00).contains(&index)
        {
            ObjectType::Record
        } else {
            ObjectType::Array
        }
    }

    fn object_name(&self, entry: &table::Entry) -> String {
        let index = entry.object.index;
        match (self.known(index, 0), pdo_parameter(entry.object)) {
            (Some(name), _) => name.to_owned(),
            (None, Some((kind, number, place))) => {
                let way = if kind == PdoKind::Rpdo { "Receive" } else { "Transmit" };
                let what = if matches!(place, Place::Mapping(_)) { "mapping" } else { "parameter" };
                format!("{way} PDO {} {what}", number.offset() + 1)
            }
            (None, None) => named_object(entry),
        }
    }

    fn variable_name(&self, entry: &table::Entry) -> String {
        let (index, subindex) = (entry.object.index, entry.object.subindex);
        if self.object_type(index) == ObjectType::Variable {
            return self.object_name(entry);
        }
        if let Some((kind, number, place)) = pdo_parameter(entry.object) {
            let kind = if kind == PdoKind::Rpdo { "Rx" } else { "Tx" };
            let number = number.offset() + 1;
            return match place {
                Place::Communication(0) => "Highest sub-index supported".to_owned(),
                Place::Communication(at) => format!("{} {kind}PDO {number}", COMMUNICATION[usize::from(at) - 1]),
                Place::Mapping(0) => format!("Number of mapped objects in {kind}PDO {number}"),
                Place::Mapping(at) => format!("Mapped object {at} in {kind}PDO {number}"),
            };
        }
        match (entry.object, self.known(index, subindex)) {
            (named::ERROR_HISTORY_COUNT, _) => "Number of errors".to_owned(),
            _ if subindex == 0 => "Highest sub-index supported".to_owned(),
            (_, Some(name)) => name.to_owned(),
            (object, None) if object.name().is_some() => named_object(entry),
            (_, None) => format!("{} {subindex}", self.object_name(entry)),
        }
    }

    /// A variable of the data sheet. `stated` replaces the table's default for this unit.
    fn variable(&self, entry: &table::Entry, stated: Option<u32>) -> Variable {
        let stored = stated.unwrap_or(entry.default);
        let number = |value: i64| Value::number(value.into());
        // A measured value has no default. The data that differ from unit to unit have none either.
        let measured = !entry.writable && entry.transmit || self.individual.contains(&entry.object);
        let default = match entry.data_type {
            DataType::VisibleString => Value::Text(entry.text.to_owned()),
            _ => Value::Integer { value: entry.number(stored).into(), plus_node: entry.plus_node },
        };
        Variable {
            name: self.variable_name(entry),
            data_type: entry.data_type,
            access: match (entry.writable, entry.receive, entry.transmit) {
                (false, ..) => Access::ReadOnly,
                (true, true, false) => Access::ReadWriteOutput,
                (true, false, true) => Access::ReadWriteInput,
                (true, ..) => Access::ReadWrite,
            },
            default: (!measured && entry.data_type != DataType::Domain).then_some(default),
            low: (entry.min != i64::MIN).then(|| number(entry.min)),
            high: (entry.max != i64::MAX).then(|| number(entry.max)),
            pdo_mapping: entry.receive || entry.transmit,
            refuses_download: entry.volatile,
            refuses_scan: false,
            parameter: None,
        }
    }
}

/// The name from the objects module, as a headline.
fn named_object(entry: &table::Entry) -> String {
    let Some(name) = entry.object.name() else {
        return format!("Object {}", entry.object);
    };
    let name = name.strip_prefix("EPOS4 ").unwrap_or(name);
    let (first, rest) = name.split_at_checked(1).unwrap_or((name, ""));
    first.to_uppercase() + rest
}

#[cfg(test)]
mod tests {
    use canopen::NodeId;

    use crate::{
        AxisConfig, CanForceSensor, CanForceSensorConfig, DigitalIo, DigitalIoConfig, Epos4, Epos4Config, Irp6Axis,
        TransducerConfig,
    };

    #[test]
    fn every_comment_is_a_line_of_a_data_sheet() {
        let node = NodeId::new(1).unwrap();
        let drive = Epos4::eds(&Epos4Config::new(node, AxisConfig::wut(Irp6Axis::ALL[0])));
        let module = DigitalIo::eds(&DigitalIoConfig::new(node));
        let sensor = CanForceSensor::eds(&CanForceSensorConfig::new(node, TransducerConfig::default()));
        for line in drive.comments.iter().chain(&module.comments).chain(&sensor.comments) {
            assert!(line.is_ascii() && !line.contains(';'), "{line}");
            assert!(line.ends_with('.') && line.len() <= 140, "{line}");
        }
    }
}
