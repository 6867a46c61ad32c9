//! Text for numbers of CANopen.

use canopen::cia402::{Controlword, FaultTable, ModeOfOperation, PowerCommand, Statusword};
use canopen::emcy::ErrorRegister;
use canopen::lss::Outcome;
use canopen::objects::{
    CONTROLWORD, DEVICE_TYPE, ERROR_CODE, ERROR_HISTORY_NEWEST, ERROR_REGISTER, MODE_OF_OPERATION,
    MODE_OF_OPERATION_DISPLAY, STATUSWORD, VELOCITY_UNIT, VENDOR_ID,
};
use canopen::sdo::AbortCode;
use canopen::{Object, cia401};

/// Vendor-ID of maxon.
const MAXON: u32 = 0x0000_00FB;

/// Manufacturers of devices in robot cells, by the vendor-ID that CiA assigned.
const VENDORS: &[(u32, &str)] = &[
    (0x0000_0002, "Beckhoff"),
    (0x0000_001B, "HMS"),
    (0x0000_0044, "Hilscher"),
    (0x0000_009A, "Elmo Motion Control"),
    (0x0000_00AB, "Copley Controls"),
    (MAXON, "maxon"),
    (0x0000_0147, "Faulhaber"),
    (0x0000_01A3, "Technosoft"),
    (0x0000_026C, "Nanotec"),
    (0x0200_0089, "Parker Hannifin"),
];

/// Name of the manufacturer, if known.
pub(super) fn vendor(id: u32) -> Option<&'static str> {
    VENDORS.iter().find(|(known, _)| *known == id).map(|(_, name)| *name)
}

/// Text of object 0x1000 (CiA 301). The drive types are from CiA 402.
pub(super) fn device_type(raw: u32) -> String {
    let profile = raw & 0xFFFF;
    let name = match profile {
        0 => return "no device profile".to_owned(),
        401 => "generic I/O",
        402 => match raw >> 16 & 0xFF {
            0x01 => "frequency converter",
            0x02 => "servo drive",
            0x04 => "stepper motor",
            _ => "drive",
        },
        404 => "measuring device or closed-loop controller",
        405 => "programmable controller",
        406 => "encoder",
        408 => "proportional valve or hydrostatic transmission",
        410 => "inclinometer",
        418 => "battery",
        419 => "battery charger",
        _ => return format!("CiA {profile}"),
    };
    format!("CiA {profile}, {name}")
}

/// Identification of a node, as far as it is known. The identification decides the meaning of the node's error codes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Identification {
    /// Vendor-ID, object 0x1018:01.
    pub(super) vendor: Option<u32>,
    /// Device type, object 0x1000.
    pub(super) device_type: Option<u32>,
}

impl Identification {
    /// Meaning of the error codes of the node. EPOS2 uses some codes of EPOS4 for other faults; the table of maxon's
    /// drives is the one of EPOS4.
    pub(super) fn fault_table(self) -> FaultTable {
        match (self.device_type.map(|device_type| device_type as u16), self.vendor) {
            (Some(cia401::PROFILE), _) => FaultTable::Cia401,
            (_, Some(MAXON)) => FaultTable::Epos4,
            _ => FaultTable::Cia402,
        }
    }
}

/// Name of an object: from the object tables of this project, or the name of a PDO parameter.
pub(super) fn object(object: Object) -> Option<String> {
    if let Some(name) = object.name() {
        return Some(name.to_owned());
    }
    let number = (object.index & 0x1FF) + 1;
    let (kind, mapping) = match object.index {
        0x1400..=0x15FF => ("RPDO", false),
        0x1600..=0x17FF => ("RPDO", true),
        0x1800..=0x19FF => ("TPDO", false),
        0x1A00..=0x1BFF => ("TPDO", true),
        _ => return None,
    };
    let part = match (mapping, object.subindex) {
        (true, 0) => "mapped objects".to_owned(),
        (true, entry) => format!("mapping entry {entry}"),
        (false, 0) => "parameters".to_owned(),
        (false, 1) => "COB-ID".to_owned(),
        (false, 2) => "transmission type".to_owned(),
        (false, 3) => "inhibit time".to_owned(),
        (false, 5) => "event timer".to_owned(),
        (false, 6) => "SYNC start value".to_owned(),
        (false, other) => format!("parameter {other}"),
    };
    Some(format!("{kind} {number} {part}"))
}

/// Whether an object holds a signed number (CiA 402).
pub(super) fn is_signed(object: Object) -> bool {
    matches!(
        object.index,
        0x6007
            | 0x605A..=0x605E
            | 0x6060..=0x6064
            | 0x606B
            | 0x606C
            | 0x6071
            | 0x6074
            | 0x6077
            | 0x6078
            | 0x607A..=0x607D
            | 0x6098
            | 0x60B0..=0x60B2
            | 0x60F4
            | 0x60FA
            | 0x60FC
            | 0x60FF
    )
}

/// Meaning of a number in an object, if the object has coded values.
pub(super) fn meaning(object: Object, raw: u64, faults: FaultTable) -> Option<String> {
    let low = raw as u16;
    Some(match object {
        STATUSWORD => statusword(Statusword(low)),
        CONTROLWORD => controlword(Controlword(low)).to_owned(),
        MODE_OF_OPERATION | MODE_OF_OPERATION_DISPLAY => ModeOfOperation::from_raw(raw as i8).to_string(),
        ERROR_CODE | ERROR_HISTORY_NEWEST => faults.text(low).to_owned(),
        ERROR_REGISTER => error_register(ErrorRegister(raw as u8)),
        DEVICE_TYPE => device_type(raw as u32),
        VENDOR_ID => vendor(raw as u32)?.to_owned(),
        VELOCITY_UNIT => velocity_unit(raw as u32)?,
        _ => return None,
    })
}

/// Text of object 0x60A9: a power of ten in bits 24 to 31, position unit and time unit in bits 8 to 23. `None` unless
/// the units are revolutions (0xB4) and minutes (0x47).
fn velocity_unit(raw: u32) -> Option<String> {
    let [_, time, position, exponent] = raw.to_le_bytes();
    match exponent.cast_signed() {
        _ if (position, time) != (0xB4, 0x47) => None,
        0 => Some("rpm".to_owned()),
        exponent => Some(format!("10^{exponent} rpm")),
    }
}

fn statusword(word: Statusword) -> String {
    let mut text = word.power_state().to_string();
    let bits = [
        (word.has(Statusword::WARNING), "warning"),
        (word.target_reached(), "target reached"),
        (word.has(Statusword::INTERNAL_LIMIT), "internal limit"),
    ];
    for (_, name) in bits.iter().filter(|(set, _)| *set) {
        text += ", ";
        text += name;
    }
    text
}

fn controlword(word: Controlword) -> &'static str {
    if word.has(Controlword::RESET) {
        return "fault reset";
    }
    match word.power_command() {
        PowerCommand::DisableVoltage => "disable voltage",
        PowerCommand::QuickStop => "quick stop",
        PowerCommand::Shutdown => "shutdown",
        PowerCommand::SwitchOn => "switch on",
        PowerCommand::EnableOperation if word.has(Controlword::HALT) => "enable operation, halt",
        PowerCommand::EnableOperation => "enable operation",
    }
}

/// Text of object 0x1001.
pub(super) fn error_register(register: ErrorRegister) -> String {
    let bits = [
        (ErrorRegister::CURRENT, "current"),
        (ErrorRegister::VOLTAGE, "voltage"),
        (ErrorRegister::TEMPERATURE, "temperature"),
        (ErrorRegister::COMMUNICATION, "communication"),
        (ErrorRegister::DEVICE_PROFILE, "device profile"),
        (ErrorRegister::VENDOR, "vendor"),
    ];
    let set: Vec<_> = bits.iter().filter(|(bit, _)| register.contains(*bit)).map(|(_, name)| *name).collect();
    match (set.is_empty(), register.0 & 1 != 0) {
        (false, _) => set.join(", "),
        (true, true) => "generic".to_owned(),
        (true, false) => "none".to_owned(),
    }
}

/// Usual cause of an abort whose text does not state the cause.
pub(super) fn hint(code: AbortCode) -> Option<&'static str> {
    Some(match code {
        AbortCode::NO_OBJECT | AbortCode::NO_SUBINDEX => {
            "wrong index or sub-index, or another device or firmware than thought"
        }
        AbortCode::LENGTH_MISMATCH | AbortCode::TOO_LONG | AbortCode::TOO_SHORT => {
            "--type has another size than the object"
        }
        AbortCode::DEVICE_STATE | AbortCode::MAXON_NMT_STATE => {
            "many parameters take a value in NMT state pre-operational or with the power off only"
        }
        AbortCode::LOCAL_CONTROL => "another master, or the vendor's own tool, has the device",
        AbortCode::VALUE_RANGE | AbortCode::VALUE_TOO_HIGH | AbortCode::VALUE_TOO_LOW => {
            "the limits are in the device's own units"
        }
        AbortCode::ACCESS | AbortCode::SUBINDEX_LOCKED => {
            "a PDO must be switched off, and its mapping's sub-index 0 be 0, before it is changed"
        }
        AbortCode::CANNOT_STORE => "storing may need its signature, 0x65766173 (\"save\")",
        AbortCode::RESOURCE | AbortCode::NO_DATA => "the object has no value at this time",
        AbortCode::COMMAND_SPECIFIER => "the device may not know this kind of transfer",
        _ => return None,
    })
}

/// Text for the result of an LSS configuration request.
pub(super) fn lss_outcome(outcome: Outcome) -> String {
    match outcome.error {
        Outcome::SUCCESS => "done".to_owned(),
        Outcome::OUT_OF_RANGE => "refused, out of range or not supported".to_owned(),
        Outcome::STORAGE => "refused, the storage cannot be accessed".to_owned(),
        Outcome::VENDOR => format!("refused by the vendor's code {:#04x}", outcome.specific),
        other => format!("refused by code {other:#04x}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_types_are_told_by_their_profile_and_kind() {
        let table = [
            (0x0002_0192, "CiA 402, servo drive"),
            (0x0001_0192, "CiA 402, frequency converter"),
            (0x0000_0192, "CiA 402, drive"),
            (0x000F_0191, "CiA 401, generic I/O"),
            (0x0000_01C4, "CiA 452"),
            (0, "no device profile"),
        ];
        for (raw, text) in table {
            assert_eq!(device_type(raw), text);
        }
    }

    #[test]
    fn pdo_parameters_have_names() {
        let table = [
            (0x1400, 1, "RPDO 1 COB-ID"),
            (0x1603, 2, "RPDO 4 mapping entry 2"),
            (0x1802, 5, "TPDO 3 event timer"),
            (0x1A00, 0, "TPDO 1 mapped objects"),
            (0x6041, 0, "statusword"),
        ];
        for (index, subindex, name) in table {
            let named = object(Object::new(index, subindex));
            assert_eq!(named.as_deref(), Some(name));
        }
        assert_eq!(object(Object::new(0x5FFF, 0)), None);
    }

    #[test]
    fn words_of_a_drive_have_meanings() {
        let table = [
            (STATUSWORD, 0x0637, "operation enabled, target reached"),
            (STATUSWORD, 0x0208, "fault"),
            (CONTROLWORD, 0x000F, "enable operation"),
            (CONTROLWORD, 0x0080, "fault reset"),
            (MODE_OF_OPERATION, 0xFF, "mode -1"),
            (MODE_OF_OPERATION_DISPLAY, 8, "cyclic synchronous position"),
            (VENDOR_ID, 0xFB, "maxon"),
            (ERROR_REGISTER, 0x11, "communication"),
            (ERROR_REGISTER, 0x01, "generic"),
            (VELOCITY_UNIT, 0x00B4_4700, "rpm"),
            (VELOCITY_UNIT, 0xFDB4_4700, "10^-3 rpm"),
        ];
        for (object, raw, text) in table {
            let meant = meaning(object, raw, FaultTable::Cia402);
            assert_eq!(meant.as_deref(), Some(text), "{object}");
        }
        // Metres per second is not a unit of a rotary motor.
        for (object, raw) in [(VENDOR_ID, 0x7777), (VELOCITY_UNIT, 0x0001_0300)] {
            assert_eq!(meaning(object, raw, FaultTable::Cia402), None);
        }
    }
}
