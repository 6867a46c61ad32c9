//! The electronic data sheet of the emulator: its one dictionary table, with the names of CiA and maxon.

use std::collections::BTreeMap;

use canopen::eds::{Access, DataType, DeviceInfo, Eds, Entry, FileInfo, ObjectType, Value, Variable};
use canopen::{objects as named, pdo::PdoKind};

use super::objects::{DUMMIES, Place, pdo_parameter};
use super::table::{self, TABLE};
use super::{Epos4, Epos4Config, identity};

/// Comments of the data sheet: conformity of the emulated drive to maxon's documents, CiA 301 and CiA 402. The text is
/// ASCII without semicolons, which begin comments in data sheets.
///
/// Sources: the pages about NMT and abort codes of the EPOS4 Communication Guide of 2019-11 (rel8759), and maxon's
/// electronic data sheet of firmware 0x0170. The Firmware Specification was not at hand.
const STATEMENTS: &[&str] = &[
    "Data sheet of an emulated drive. Not checked: no document of maxon was at hand for the statement.",
    "Abort codes: those that the EPOS4 Communication Guide (2019-11, table 6-20) lists as in use by the EPOS4.",
    "Abort codes: a value out of range is 06090030, never 06090031 or 06090032. Data too long are 06070010, never 06070012.",
    "Abort codes beyond the list, of CiA 301: 05040002, 05040003 and 05040005 of transfers, 08000024 of an empty error history.",
    "SDO: block transfer is supported. Data of more than 1022 bytes are refused by 05040005. Not checked.",
    "Store parameters (1010): not stored are controlword, targets, offsets, outputs and the error history.",
    "Store parameters (1010): maxon's data sheet excludes the same objects from downloads. What an EPOS4 stores is not checked.",
    "Producer heartbeat (1017): begins at once when written. After a boot the boot-up message is the first heartbeat (CiA 301).",
    "Consumer heartbeat (1016): two times for one node are refused by 06040043 (CiA 301).",
    "Consumer heartbeat (1016): a new time counts from the last heartbeat. A lost node stays lost until it is heard. Not checked.",
    "EMCY: sent in pre-operational and operational only (CiA 301, EPOS4 Communication Guide, table 3-11).",
    "EMCY: an error raised in stopped is announced when the node leaves stopped, if the error is still present. Not checked.",
    "EMCY: a fault keeps its error through a reset of the communication. The error is announced again after boot-up. Not checked.",
    "EMCY 8100: NMT stop or reset communication where 6007 is 1. Both act as 6007 says. Not checked.",
    "EMCY 8240: a SYNC with data is ignored, since there is no object 1019 (CiA 301). The drive goes on. Not checked.",
    "Additions to firmware 0x0170: event timers of RPDOs (1400:5 to 1403:5), dummy entries, objects 605D, 607C, 60FE:2 and 2FF0.",
    "Inhibit time of a TPDO: delays changes and the event timer alike (CiA 301).",
    "Statusword in profile velocity mode: bit 12 shows standstill by 30E0. An EPOS4 has no objects 606D to 6070.",
    "Standstill (30E0): ends when the velocity is beyond the window for the window time, as by 606F and 6070 of CiA 402.",
    "Statusword in profile velocity mode: bit 10 compares target and demand. Not checked.",
    "Position window (6067): target reached needs the position within the window around the target (CiA 402).",
    "Quick stop option code (605A): 3, 4, 7 and 8 brake at the limits of the amplifier (CiA 402). Not checked.",
    "Home offset (607C, 30B1): position 0 lies this far from home, and the axis goes there (CiA 402). Not checked.",
    "Homing: halt is shown as interrupted, and the search goes on without halt (CiA 402). Not checked.",
];

/// Names of objects, at sub-index 0, and of their sub-indices, as far as [`named::TABLE`] does not give them.
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
    (0x2200, 0, "Power supply"),
    (0x2200, 1, "Power supply voltage"),
    (0x2FF0, 0, "Record of the emulator"),
    (0x2FF0, 1, "Text of the emulator"),
    (0x2FF0, 2, "Bytes for the emulator"),
    (0x3000, 0, "Axis configuration"),
    (0x3001, 0, "Motor data"),
    (0x3001, 2, "Output current limit"),
    (0x30B2, 0, "Current threshold for homing mode"),
    (0x30D1, 0, "Current actual values"),
    (0x30D1, 1, "Current actual value averaged"),
    (0x30E0, 0, "Standstill window configuration"),
    (0x30E0, 1, "Standstill window"),
    (0x30E0, 2, "Standstill window time"),
    (0x30E0, 3, "Standstill window timeout"),
    (0x3141, 0, "Digital input properties"),
    (0x3141, 1, "Digital inputs logic state"),
    (0x6062, 0, "Position demand value"),
    (0x6067, 0, "Position window"),
    (0x6068, 0, "Position window time"),
    (0x606B, 0, "Velocity demand value"),
    (0x607D, 0, "Software position limit"),
    (0x607D, 1, "Min position limit"),
    (0x607D, 2, "Max position limit"),
    (0x6099, 0, "Homing speeds"),
    (0x6099, 1, "Speed for switch search"),
    (0x6099, 2, "Speed for zero search"),
    (0x60A8, 0, "SI unit position"),
    (0x60AA, 0, "SI unit acceleration"),
    (0x60C2, 0, "Interpolation time period"),
    (0x60FE, 0, "Digital outputs"),
    (0x60FE, 2, "Bit mask"),
];

/// Objects of type RECORD apart from the parameters of PDOs. Any other object with sub-indices is an ARRAY.
const RECORDS: [u16; 10] = [0x1018, 0x1200, 0x2200, 0x2FF0, 0x3000, 0x3001, 0x30D1, 0x30E0, 0x3141, 0x60C2];

/// The names of a PDO's communication parameters, from sub-index 1.
const COMMUNICATION: [&str; 5] = ["COB-ID used by", "Transmission type", "Inhibit time", "Reserved", "Event timer"];

impl Epos4 {
    /// The electronic data sheet of a unit. Units of one kind differ only in the ratings of the motor.
    pub fn eds(config: &Epos4Config) -> Eds {
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
}

fn known(index: u16, subindex: u8) -> Option<&'static str> {
    let mut names = NAMES.iter();
    names.find_map(|known| ((known.0, known.1) == (index, subindex)).then_some(known.2))
}

fn object_type(index: u16) -> ObjectType {
    let mut objects = TABLE.iter().map(|entry| entry.object);
    if !objects.any(|object| object.index == index && object.subindex > 0) {
        ObjectType::Variable
    } else if RECORDS.contains(&index) || (0x1400..0x1C00).contains(&index) {
        ObjectType::Record
    } else {
        ObjectType::Array
    }
}

fn object_name(entry: &table::Entry) -> String {
    let index = entry.object.index;
    match (known(index, 0), pdo_parameter(entry.object)) {
        (Some(name), _) => name.to_owned(),
        (None, Some((kind, number, place))) => {
            let way = if kind == PdoKind::Rpdo { "Receive" } else { "Transmit" };
            let what = if matches!(place, Place::Mapping(_)) { "mapping" } else { "parameter" };
            format!("{way} PDO {} {what}", number.offset() + 1)
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
    match (entry.object, known(index, subindex)) {
        (named::ERROR_HISTORY_COUNT, _) => "Number of errors".to_owned(),
        _ if subindex == 0 => "Highest sub-index supported".to_owned(),
        (_, Some(name)) => name.to_owned(),
        (object, None) if object.name().is_some() => named_object(entry),
        (_, None) => format!("{} {subindex}", object_name(entry)),
    }
}

/// A variable of the data sheet. `stated` replaces the table's default for this unit.
fn variable(entry: &table::Entry, stated: Option<u32>) -> Variable {
    let stored = stated.unwrap_or(entry.default);
    let number = |value: i64| Value::number(value.into());
    // A measured value has no default. The data that differ from unit to unit have none either.
    let measured =
        !entry.writable && entry.transmit || matches!(entry.object, named::SERIAL_NUMBER | named::MOTOR_RATED_TORQUE);
    let default = match entry.data_type {
        DataType::VisibleString => Value::Text(entry.text.to_owned()),
        _ => Value::Integer { value: entry.number(stored).into(), plus_node: entry.plus_node },
    };
    Variable {
        name: variable_name(entry),
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

#[cfg(test)]
mod tests {
    use super::STATEMENTS;

    #[test]
    fn every_statement_is_a_line_of_a_data_sheet() {
        for line in STATEMENTS {
            assert!(line.is_ascii() && !line.contains(';'), "{line}");
            assert!(line.ends_with('.') && line.len() <= 140, "{line}");
        }
    }
}
