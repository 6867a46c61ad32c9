//! The electronic data sheet of the module: its dictionary, with the names of CiA 401.

use canopen::eds::Eds;
use canopen::objects as named;

use super::{DigitalIo, DigitalIoConfig, table::table};
use crate::node::eds::{Head, Sheet};

/// Comments of the data sheet: choices of the emulator where CiA 301 and CiA 401 leave room. The text is ASCII without
/// semicolons, which begin comments in data sheets.
///
/// Sources: excerpts of CiA 401 versions 2.0 (with errata of 2000-05-22) and 2.1, and manuals of WAGO 750-337, esd
/// CAN-CBX-REL4 and VIPA System 300V. The whole standard was not at hand.
const STATEMENTS: &[&str] = &[
    "Data sheet of an emulated module. Not checked: the whole text of CiA 401 was not at hand for the statement.",
    "Communication: that of the emulated drive (epos4-emulated.eds), with the inhibit time of EMCY (1015).",
    "Inputs (6000): terminal, then filter (6003), then polarity (6002). A filtered input needs the new level for the filter time.",
    "TPDO events: a change of 6000 that 6006, 6007 or 6008 selects while 6005 is 1. Writes of 6002 and 6003 count as well.",
    "TPDO events: a change that is undone within the inhibit time is still sent at the end of the inhibit time. Not checked.",
    "TPDO: each event-driven TPDO is sent once when the node becomes operational. Not checked.",
    "Outputs (6200): polarity (6202), then filter mask (6208). Writes of 6202 and 6208 act at once. Not checked.",
    "Error value (6207): set where error mode (6206) is 1, without polarity and filter mask. The other outputs keep their level.",
    "Error value (6207): set by a lost heartbeat, an overdue RPDO, NMT stop and reset communication.",
    "Error value (6207): NMT stop is in CiA 401 version 2.0. The errata of 2000-05-22 remove a mention of NMT stop. Not checked.",
    "Error value (6207): stays until the next write of 6200 by SDO or RPDO, also when the error has ended. Not checked.",
    "Reset node and loss of the supply: all outputs are low. After the boot 6200 is 0, and 6202 and 6208 apply. Not checked.",
    "Store parameters (1010): not stored are outputs (6200) and the error history.",
    "RPDO with too few bytes: EMCY 8210, and the outputs stay as they are.",
];

/// Names of the module's objects, see [`Sheet::names`].
const NAMES: &[(u16, u8, &str)] = &[
    (0x1009, 0, "Manufacturer hardware version"),
    (0x100A, 0, "Manufacturer software version"),
    (0x1015, 0, "Inhibit time EMCY"),
    (0x6000, 0, "Read input 8-bit"),
    (0x6002, 0, "Polarity input 8-bit"),
    (0x6003, 0, "Filter constant input 8-bit"),
    (0x6005, 0, "Global interrupt enable digital 8-bit"),
    (0x6006, 0, "Interrupt mask any change 8-bit"),
    (0x6007, 0, "Interrupt mask low-to-high 8-bit"),
    (0x6008, 0, "Interrupt mask high-to-low 8-bit"),
    (0x6200, 0, "Write output 8-bit"),
    (0x6202, 0, "Change polarity output 8-bit"),
    (0x6206, 0, "Error mode output 8-bit"),
    (0x6207, 0, "Error value output 8-bit"),
    (0x6208, 0, "Filter mask output 8-bit"),
];

impl DigitalIo {
    /// The electronic data sheet of a unit. Units of one kind differ only in the serial number. A comment states the
    /// filter time.
    pub fn eds(config: &DigitalIoConfig) -> Eds {
        let table = table(config);
        let filter_time = format!("Filter time of inputs (6003): {} us.", config.filter_time.as_micros());
        let sheet =
            Sheet { table: &table, names: NAMES, records: &[], stated: &[], individual: &[named::SERIAL_NUMBER] };
        let head = Head {
            file_name: "cia401-emulated.eds",
            description: "Emulated digital inputs and outputs",
            creation_date: "11-22-2026",
            vendor_name: "mrroc",
            product_name: "Digital I/O (emulated)",
            identity: [config.vendor, config.product, config.revision],
        };
        sheet.eds(&head, STATEMENTS.iter().map(|&line| line.to_owned()).chain([filter_time]).collect())
    }
}
