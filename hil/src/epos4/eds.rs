//! The electronic data sheet of the emulator: its one dictionary table, with the names of CiA and maxon.

use std::collections::BTreeMap;

use canopen::eds::{
    Access, DataType, DeviceInfo, Eds, Entry, FileInfo, ObjectType, Value, Variable,
};
use canopen::objects as named;

use super::conformity::STATEMENTS;
use super::objects::DUMMIES;
use super::table::{self, Kind, TABLE};
use super::{Epos4Config, identity};

/// Object types and names of the objects that are not single variables or that have no name in [`named::TABLE`]. The
/// name of the object comes first, then the names of its sub-indices from 1.
const NAMES: &[(u16, ObjectType, &str, &[&str])] = &[
    (0x1003, ObjectType::Array, "Error history", &[]),
    (
        0x1010,
        ObjectType::Array,
        "Store parameters",
        &["Save all parameters"],
    ),
    (
        0x1011,
        ObjectType::Array,
        "Restore default parameters",
        &["Restore all default parameters"],
    ),
    (
        0x1016,
        ObjectType::Array,
        "Consumer heartbeat time",
        &["Consumer 1 heartbeat time", "Consumer 2 heartbeat time"],
    ),
    (
        0x1018,
        ObjectType::Record,
        "Identity object",
        &[
            "Vendor ID",
            "Product code",
            "Revision number",
            "Serial number",
        ],
    ),
    (
        0x1029,
        ObjectType::Array,
        "Error behavior",
        &["Communication error"],
    ),
    (
        0x1200,
        ObjectType::Record,
        "SDO server parameter",
        &["COB-ID SDO client to server", "COB-ID SDO server to client"],
    ),
    (
        0x2200,
        ObjectType::Record,
        "Power supply",
        &["Power supply voltage"],
    ),
    (
        0x2FF0,
        ObjectType::Record,
        "Record of the emulator",
        &["Text of the emulator", "Bytes for the emulator"],
    ),
    (
        0x3000,
        ObjectType::Record,
        "Axis configuration",
        &[
            "Sensors configuration",
            "Control structure",
            "Commutation sensors",
            "Axis configuration miscellaneous",
            "Main sensor resolution",
        ],
    ),
    (
        0x3001,
        ObjectType::Record,
        "Motor data",
        &[
            "Nominal current",
            "Output current limit",
            "Number of pole pairs",
            "Thermal time constant winding",
            "Torque constant",
        ],
    ),
    (
        0x30B2,
        ObjectType::Variable,
        "Current threshold for homing mode",
        &[],
    ),
    (
        0x30D1,
        ObjectType::Record,
        "Current actual values",
        &["Current actual value averaged", "Current actual value"],
    ),
    (
        0x30E0,
        ObjectType::Record,
        "Standstill window configuration",
        &[
            "Standstill window",
            "Standstill window time",
            "Standstill window timeout",
        ],
    ),
    (
        0x3141,
        ObjectType::Record,
        "Digital input properties",
        &["Digital inputs logic state"],
    ),
    (0x6062, ObjectType::Variable, "Position demand value", &[]),
    (0x6067, ObjectType::Variable, "Position window", &[]),
    (0x6068, ObjectType::Variable, "Position window time", &[]),
    (0x606B, ObjectType::Variable, "Velocity demand value", &[]),
    (
        0x607D,
        ObjectType::Array,
        "Software position limit",
        &["Min position limit", "Max position limit"],
    ),
    (0x6086, ObjectType::Variable, "Motion profile type", &[]),
    (
        0x6099,
        ObjectType::Array,
        "Homing speeds",
        &["Speed for switch search", "Speed for zero search"],
    ),
    (0x60A8, ObjectType::Variable, "SI unit position", &[]),
    (0x60AA, ObjectType::Variable, "SI unit acceleration", &[]),
    (
        0x60C2,
        ObjectType::Record,
        "Interpolation time period",
        &[
            "Interpolation time period value",
            "Interpolation time index",
        ],
    ),
    (
        0x60FE,
        ObjectType::Array,
        "Digital outputs",
        &["Physical outputs", "Bit mask"],
    ),
];

/// The names of a PDO's communication parameters, from sub-index 1.
const COMMUNICATION: [&str; 5] = [
    "COB-ID used by",
    "Transmission type",
    "Inhibit time",
    "Reserved",
    "Event timer",
];

/// The data sheet of a unit. Units of one kind differ only in the ratings of the motor.
pub(super) fn eds(config: &Epos4Config) -> Eds {
    let identity = identity(config);
    let mut eds = Eds {
        file: FileInfo {
            file_name: "epos4-emulated.eds".into(),
            file_version: "1".into(),
            file_revision: "0".into(),
            eds_version: "4.0".into(),
            description: "Emulated EPOS4".into(),
            creation_time: "12:00PM".into(),
            creation_date: "11-21-2026".into(),
            created_by: "mrroc".into(),
        },
        device: DeviceInfo {
            vendor_name: "mrroc, in place of maxon".into(),
            vendor_number: Some(config.vendor),
            product_name: "EPOS4 (emulated)".into(),
            product_number: Some(config.product),
            revision_number: Some(config.revision),
            order_code: "0".into(),
            baud_rates: vec![20, 50, 125, 250, 500, 800, 1000],
            simple_boot_up_slave: true,
            granularity: 8,
            rpdos: 4,
            tpdos: 4,
            lss: true,
            ..DeviceInfo::default()
        },
        comments: STATEMENTS.iter().map(|&line| line.to_owned()).collect(),
        dummies: DUMMIES.map(|bits| bits > 0),
        ..Eds::default()
    };
    for (row, entry) in TABLE.iter().enumerate() {
        let index = entry.object.index;
        let object = eds.objects.entry(index).or_insert_with(|| Entry {
            name: object_name(entry),
            object_type: object_type(index),
            variables: BTreeMap::new(),
        });
        let stated = identity.iter().find(|(slot, _)| slot.row() == row);
        let variable = variable(entry, stated.map(|(_, value)| *value));
        object.variables.insert(entry.object.subindex, variable);
    }
    eds
}

fn known(index: u16) -> Option<&'static (u16, ObjectType, &'static str, &'static [&'static str])> {
    NAMES.iter().find(|(known, ..)| *known == index)
}

fn object_type(index: u16) -> ObjectType {
    match known(index) {
        Some((_, object_type, ..)) => *object_type,
        None if pdo(index).is_some() => ObjectType::Record,
        None if subindices(index) => ObjectType::Array,
        None => ObjectType::Variable,
    }
}

fn subindices(index: u16) -> bool {
    let mut entries = TABLE.iter().map(|entry| entry.object);
    entries.any(|object| object.index == index && object.subindex > 0)
}

/// Direction, number from 1, and whether the index is that of the mapping.
fn pdo(index: u16) -> Option<(&'static str, u16, bool)> {
    let number = (index & 0x1FF) + 1;
    match index {
        0x1400..=0x15FF => Some(("Rx", number, false)),
        0x1600..=0x17FF => Some(("Rx", number, true)),
        0x1800..=0x19FF => Some(("Tx", number, false)),
        0x1A00..=0x1BFF => Some(("Tx", number, true)),
        _ => None,
    }
}

fn object_name(entry: &table::Entry) -> String {
    let index = entry.object.index;
    match (known(index), pdo(index)) {
        (Some((_, _, name, _)), _) => (*name).to_owned(),
        (None, Some((kind, number, mapping))) => {
            let way = if kind == "Rx" { "Receive" } else { "Transmit" };
            let what = if mapping { "mapping" } else { "parameter" };
            format!("{way} PDO {number} {what}")
        }
        (None, None) => named_object(entry),
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

fn variable_name(entry: &table::Entry) -> String {
    let (index, subindex) = (entry.object.index, entry.object.subindex);
    if object_type(index) == ObjectType::Variable {
        return object_name(entry);
    }
    if let Some((kind, number, mapping)) = pdo(index) {
        return match (mapping, subindex) {
            (false, 0) => "Highest sub-index supported".to_owned(),
            (false, _) => {
                let what = COMMUNICATION.get(usize::from(subindex) - 1);
                format!("{} {kind}PDO {number}", what.unwrap_or(&"Parameter of"))
            }
            (true, 0) => format!("Number of mapped objects in {kind}PDO {number}"),
            (true, _) => format!("Mapped object {subindex} in {kind}PDO {number}"),
        };
    }
    let names = known(index).map_or::<&[&str], _>(&[], |(.., names)| names);
    let name = usize::from(subindex).checked_sub(1);
    match (entry.object, name.and_then(|at| names.get(at))) {
        (_, Some(name)) => (*name).to_owned(),
        (named::ERROR_HISTORY_COUNT, None) => "Number of errors".to_owned(),
        (_, None) if subindex == 0 => "Highest sub-index supported".to_owned(),
        (_, None) => format!("{} {subindex}", object_name(entry)),
    }
}

/// A variable of the data sheet. `stated` replaces the table's default for this unit.
fn variable(entry: &table::Entry, stated: Option<u32>) -> Variable {
    let writable = entry.access == table::Access::Write;
    let stored = stated.unwrap_or(entry.default);
    let number = |value: i64| Value::number(value.into());
    // A measured value has no default. The data that differ from unit to unit have none either.
    let measured = !writable && entry.mappable.transmit
        || matches!(
            entry.object,
            named::SERIAL_NUMBER | named::MOTOR_RATED_TORQUE
        );
    let default = match entry.kind {
        Kind::Text(text) => Value::Text(text.to_owned()),
        kind => Value::Integer {
            value: kind.number(stored).into(),
            plus_node: entry.plus_node,
        },
    };
    Variable {
        name: variable_name(entry),
        data_type: match entry.kind {
            Kind::U8 => DataType::Unsigned8,
            Kind::I8 => DataType::Integer8,
            Kind::U16 => DataType::Unsigned16,
            Kind::I16 => DataType::Integer16,
            Kind::U32 => DataType::Unsigned32,
            Kind::I32 => DataType::Integer32,
            Kind::Text(_) => DataType::VisibleString,
            Kind::Domain => DataType::Domain,
        },
        access: match (writable, entry.mappable.receive, entry.mappable.transmit) {
            (false, ..) => Access::ReadOnly,
            (true, true, false) => Access::ReadWriteOutput,
            (true, false, true) => Access::ReadWriteInput,
            (true, ..) => Access::ReadWrite,
        },
        default: (!measured && entry.kind != Kind::Domain).then_some(default),
        low: (entry.min != i64::MIN).then(|| number(entry.min)),
        high: (entry.max != i64::MAX).then(|| number(entry.max)),
        pdo_mapping: entry.mappable.receive || entry.mappable.transmit,
        refuses_download: entry.volatile,
        refuses_scan: false,
        parameter: None,
    }
}
