//! The electronic data sheet of the emulator: its one dictionary table, with the names of CiA and maxon.

use canopen::eds::Eds;
use canopen::objects as named;

use super::{Epos4, Epos4Config, identity, table::TABLE};
use crate::node::eds::{Head, Sheet};

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

/// Names of the drive's objects, see [`Sheet::names`].
const NAMES: &[(u16, u8, &str)] = &[
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

/// Objects of the drive of type RECORD.
const RECORDS: [u16; 8] = [0x2200, 0x2FF0, 0x3000, 0x3001, 0x30D1, 0x30E0, 0x3141, 0x60C2];

impl Epos4 {
    /// The electronic data sheet of a unit. Units of one kind differ only in the ratings of the motor.
    pub fn eds(config: &Epos4Config) -> Eds {
        let identity = identity(config);
        let sheet = Sheet {
            table: &TABLE,
            names: NAMES,
            records: &RECORDS,
            stated: &identity,
            individual: &[named::SERIAL_NUMBER, named::MOTOR_RATED_TORQUE],
        };
        let head = Head {
            file_name: "epos4-emulated.eds",
            description: "Emulated EPOS4",
            creation_date: "11-21-2026",
            vendor_name: "mrroc, in place of maxon",
            product_name: "EPOS4 (emulated)",
            identity: [config.vendor, config.product, config.revision],
        };
        sheet.eds(&head, STATEMENTS.iter().map(|&line| line.to_owned()).collect())
    }
}
