//! Error codes of EMCY and object 0x603F in words.

/// Source of the meaning of an error code (EMCY and object 0x603F). Vendors give meanings of their own to the range 0xFFxx
/// and to some other codes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FaultTable {
    /// CiA 402-2 §7.1 and the communication codes of CiA 301 §7.2.7.1.
    #[default]
    Cia402,
    /// I/O modules of CiA 401, as manuals of Festo (CPX-E) and Turck (BL20) give the codes, and the communication codes
    /// of CiA 301 §7.2.7.1.
    Cia401,
    /// maxon EPOS4.
    Epos4,
}

impl FaultTable {
    /// The text of an error code: the text of the vendor, of CiA, of the group of the code (0x8600 for 0x8613), or of its
    /// class, in this order.
    pub fn text(self, code: u16) -> &'static str {
        let listed = match self {
            Self::Cia402 => of_cia(code),
            Self::Cia401 => find(CIA_401, code).or_else(|| find(CIA, code).filter(|_| matches!(code, 0x8100..=0x82FF))),
            Self::Epos4 => find(EPOS4, code).or_else(|| epos4_range(code)).or_else(|| of_cia(code)),
        };
        listed.unwrap_or_else(|| class(code))
    }
}

/// Whether the counter of the encoder may be wrong after an error code of a drive (EMCY and object 0x603F). These are errors
/// of a sensor, and errors of a motor that did not follow its velocity or position. A drive cannot tell a motor that does
/// not follow from an encoder that fails.
pub fn questions_position(code: u16) -> bool {
    matches!(code, 0x7300..=0x73FF | 0x8400..=0x86FF)
}

/// Codes of EPOS4 with one text for a range.
const fn epos4_range(code: u16) -> Option<&'static str> {
    match code {
        0x1080..=0x1088 => Some("generic initialisation error"),
        0x5480..=0x5483 => Some("hardware error"),
        0x6180..=0x61F0 => Some("internal software error"),
        _ => None,
    }
}

/// The text of CiA for a code, or for its group.
fn of_cia(code: u16) -> Option<&'static str> {
    find(CIA, code).or_else(|| find(CIA, code & 0xFF00).filter(|_| code > 0x00FF))
}

fn find(table: &[(u16, &'static str)], code: u16) -> Option<&'static str> {
    let at = table.binary_search_by_key(&code, |(listed, _)| *listed).ok()?;
    Some(table[at].1)
}

/// The error classes of EMCY (CiA 301 §7.2.7.1).
const fn class(code: u16) -> &'static str {
    match code {
        0x0000 => "no error",
        0x1000..=0x1FFF => "generic error",
        0x2000..=0x2FFF => "error of class current",
        0x3000..=0x3FFF => "error of class voltage",
        0x4000..=0x4FFF => "error of class temperature",
        0x5000..=0x5FFF => "error of class hardware",
        0x6000..=0x6FFF => "error of class software",
        0x7000..=0x7FFF => "error of class additional modules",
        0x8000..=0x80FF => "error of class monitoring",
        0x8100..=0x81FF => "error of class communication",
        0x8200..=0x82FF => "error of class protocol",
        0x8300..=0x8FFF => "error of class monitoring",
        0x9000..=0x9FFF => "external error",
        0xF000..=0xF0FF => "error of class additional functions",
        0xFF00..=0xFFFF => "device specific",
        _ => "unknown error code",
    }
}

const CIA: &[(u16, &str)] = &[
    (0x0000, "no error"),
    (0x1000, "generic error"),
    (0x2110, "short circuit or earth leakage at the input"),
    (0x2120, "earth leakage at the input"),
    (0x2130, "short circuit at the input"),
    (0x2211, "internal current no. 1"),
    (0x2212, "internal current no. 2"),
    (0x2213, "over-current in ramp function"),
    (0x2214, "over-current in the sequence"),
    (0x2220, "continuous over-current inside the device"),
    (0x2230, "short circuit or earth leakage inside the device"),
    (0x2240, "earth leakage inside the device"),
    (0x2250, "short circuit inside the device"),
    (0x2310, "continuous over-current"),
    (0x2311, "continuous over-current no. 1"),
    (0x2312, "continuous over-current no. 2"),
    (0x2320, "short circuit or earth leakage at the motor"),
    (0x2330, "earth leakage at the motor"),
    (0x2340, "short circuit at the motor"),
    (0x2350, "load level fault (I²t)"),
    (0x2351, "load level warning (I²t)"),
    (0x3110, "mains over-voltage"),
    (0x3120, "mains under-voltage"),
    (0x3130, "phase failure"),
    (0x3134, "phase sequence"),
    (0x3140, "mains frequency"),
    (0x3210, "DC link over-voltage"),
    (0x3220, "DC link under-voltage"),
    (0x3230, "load error"),
    (0x3310, "output over-voltage"),
    (0x3320, "armature circuit"),
    (0x3330, "field circuit"),
    (0x4110, "excess ambient temperature"),
    (0x4120, "too low ambient temperature"),
    (0x4210, "excess temperature of the device"),
    (0x4220, "too low temperature of the device"),
    (0x4310, "excess temperature of the drive or motor"),
    (0x4320, "too low temperature of the drive or motor"),
    (0x4410, "excess temperature of the supply"),
    (0x4420, "too low temperature of the supply"),
    (0x5110, "low voltage supply"),
    (0x5111, "15 V supply"),
    (0x5112, "24 V supply"),
    (0x5113, "5 V supply"),
    (0x5210, "measurement circuit"),
    (0x5220, "computing circuit"),
    (0x5300, "operating unit"),
    (0x5410, "output stages"),
    (0x5420, "chopper"),
    (0x5430, "input stages"),
    (0x5440, "contacts"),
    (0x5450, "fuses"),
    (0x5510, "working memory"),
    (0x5520, "program memory"),
    (0x5530, "non-volatile memory"),
    (0x6010, "software reset by watchdog"),
    (0x6100, "internal software"),
    (0x6310, "loss of parameters"),
    (0x6320, "parameter error"),
    (0x7110, "brake chopper"),
    (0x7111, "failure of the brake chopper"),
    (0x7112, "over-current of the brake chopper"),
    (0x7113, "protective circuit of the brake chopper"),
    (0x7120, "motor"),
    (0x7121, "motor blocked"),
    (0x7122, "motor error or commutation malfunction"),
    (0x7123, "motor tilted"),
    (0x7200, "measurement circuit"),
    (0x7300, "sensor"),
    (0x7301, "tacho fault"),
    (0x7302, "tacho has wrong polarity"),
    (0x7303, "resolver 1 fault"),
    (0x7304, "resolver 2 fault"),
    (0x7305, "incremental sensor 1 fault"),
    (0x7306, "incremental sensor 2 fault"),
    (0x7307, "incremental sensor 3 fault"),
    (0x7310, "speed"),
    (0x7320, "position"),
    (0x7400, "computation circuit"),
    (0x7500, "communication"),
    (0x7510, "serial interface no. 1"),
    (0x7520, "serial interface no. 2"),
    (0x7600, "data storage"),
    (0x8110, "CAN overrun, frames lost"),
    (0x8120, "CAN in error passive mode"),
    (0x8130, "heartbeat or life guard error"),
    (0x8140, "recovered from bus-off"),
    (0x8150, "collision of COB-IDs"),
    (0x8210, "PDO too short, not processed"),
    (0x8220, "PDO too long"),
    (0x8230, "destination object of a DAM MPDO not available"),
    (0x8240, "unexpected length of SYNC"),
    (0x8250, "RPDO time-out"),
    (0x8300, "torque control"),
    (0x8311, "excess torque"),
    (0x8312, "difficult start-up"),
    (0x8313, "standstill torque"),
    (0x8321, "insufficient torque"),
    (0x8331, "torque fault"),
    (0x8400, "velocity controller"),
    (0x8500, "position controller"),
    (0x8600, "positioning controller"),
    (0x8611, "following error"),
    (0x8612, "reference limit"),
    (0x8700, "sync controller"),
    (0x8800, "winding controller"),
    (0x8900, "process data monitoring"),
    (0x8A00, "control monitoring"),
    (0xF001, "deceleration"),
    (0xF002, "sub-synchronous run"),
    (0xF003, "stroke operation"),
    (0xF004, "control"),
];

/// Codes of I/O modules. CiA 402 gives some of them another meaning.
const CIA_401: &[(u16, &str)] = &[
    (0x2110, "input current too high"),
    (0x2130, "input current too low"),
    (0x2310, "output current too high"),
    (0x2320, "short circuit at the outputs"),
    (0x2330, "load dump at the outputs"),
    (0x3110, "supply voltage too high"),
    (0x3120, "supply voltage too low"),
    (0x3320, "output voltage too low"),
];

/// Codes whose meaning is not that of CiA.
const EPOS4: &[(u16, &str)] = &[
    (0x1090, "firmware of an extension is incompatible"),
    (0x2310, "over-current"),
    (0x2320, "power stage protection"),
    (0x3210, "over-voltage"),
    (0x3220, "under-voltage"),
    (0x4210, "thermal overload of the device"),
    (0x4380, "thermal overload of the motor"),
    (0x5113, "logic supply too low"),
    (0x5280, "hardware defect"),
    (0x5281, "hardware incompatible; maxon knows of units built from 03/2025 to 04/2026"),
    (0x5282, "STO card not detected"),
    (0x6080, "sign of life error"),
    (0x6081, "watchdog of extension 1"),
    (0x6320, "software parameter error"),
    (0x6380, "persistent parameter corrupt"),
    (0x7320, "position sensor error"),
    (0x7380, "position sensor breach"),
    (0x7381, "position sensor resolution error"),
    (0x7382, "position sensor index error"),
    (0x7388, "hall sensor error"),
    (0x7389, "hall sensor not found"),
    (0x738A, "hall angle detection error"),
    (0x738C, "SSI sensor error"),
    (0x738D, "SSI sensor frame error"),
    (0x7390, "main sensor missing"),
    (0x7391, "commutation sensor missing"),
    (0x7392, "main sensor direction error"),
    (0x8111, "CAN overrun"),
    (0x8130, "CAN heartbeat error"),
    (0x8150, "collision of PDO COB-IDs"),
    (0x8180, "EtherCAT communication"),
    (0x8181, "EtherCAT initialisation"),
    (0x8182, "EtherCAT receive queue overflow"),
    (0x8183, "EtherCAT communication inside the device"),
    (0x81FD, "CAN bus-off"),
    (0x81FE, "CAN receive queue overflow"),
    (0x81FF, "CAN transmit queue overflow"),
    (0x8210, "CAN PDO length error"),
    (0x8280, "EtherCAT PDO communication"),
    (0x8281, "EtherCAT SDO communication"),
    (0x8A80, "negative limit switch"),
    (0x8A81, "positive limit switch"),
    (0x8A82, "software position limit"),
    (0x8A88, "safe torque off (STO)"),
    (0x8A8A, "STO card ready"),
    (0x8A8B, "STO card inactive"),
    (0xFF01, "system overloaded"),
    (0xFF02, "watchdog"),
    (0xFF0B, "system peak overloaded"),
    (0xFF10, "controller gain error"),
    (0xFF11, "auto-tuning: identification"),
    (0xFF12, "auto-tuning: current limit"),
    (0xFF13, "auto-tuning: identification current"),
    (0xFF14, "auto-tuning: data sampling"),
    (0xFF15, "auto-tuning: sample mismatch"),
    (0xFF16, "auto-tuning: parameter"),
    (0xFF17, "auto-tuning: amplitude mismatch"),
    (0xFF18, "auto-tuning: period length"),
    (0xFF19, "auto-tuning: time-out"),
    (0xFF20, "auto-tuning: standstill"),
    (0xFF21, "auto-tuning: torque invalid"),
    (0xFF22, "auto-tuning: system speed too high"),
    (0xFF23, "auto-tuning: motor connection"),
    (0xFF24, "auto-tuning: sensor signal"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_ascend_without_doubles() {
        for table in [CIA, CIA_401, EPOS4] {
            for pair in table.windows(2) {
                assert!(pair[0].0 < pair[1].0, "{:#06x}", pair[1].0);
            }
        }
    }

    #[test]
    fn vendors_name_the_same_code_differently() {
        let table = [
            (FaultTable::Cia402, 0x8611, "following error"),
            (FaultTable::Epos4, 0xFF0B, "system peak overloaded"),
            (FaultTable::Cia402, 0xFF0B, "device specific"),
            (FaultTable::Epos4, 0xFF01, "system overloaded"),
            (FaultTable::Epos4, 0x7121, "motor blocked"),
            (FaultTable::Epos4, 0x6185, "internal software error"),
            (FaultTable::Epos4, 0x1083, "generic initialisation error"),
            (FaultTable::Cia402, 0x6185, "internal software"),
            (FaultTable::Cia402, 0x8613, "positioning controller"),
            (FaultTable::Epos4, 0x8613, "positioning controller"),
            (FaultTable::Cia402, 0x6213, "error of class software"),
            (FaultTable::Cia401, 0x2330, "load dump at the outputs"),
            (FaultTable::Cia401, 0x2340, "error of class current"),
            (FaultTable::Cia401, 0x8130, "heartbeat or life guard error"),
            (FaultTable::Cia401, 0x8311, "error of class monitoring"),
            (FaultTable::Cia401, 0x6100, "error of class software"),
            (FaultTable::Cia402, 0xA123, "unknown error code"),
            (FaultTable::Epos4, 0x0042, "unknown error code"),
            (FaultTable::Epos4, 0x0000, "no error"),
        ];
        for (faults, code, text) in table {
            assert_eq!(faults.text(code), text, "{faults:?} {code:#06x}");
        }
    }
}
