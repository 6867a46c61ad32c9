//! Conformity of the emulated drive to maxon's documents, CiA 301 and CiA 402.
//!
//! Sources: the pages about NMT and abort codes of the EPOS4 Communication Guide of 2019-11 (rel8759), and maxon's
//! electronic data sheet of firmware 0x0170. The Firmware Specification was not at hand.

/// Comments of the emulated drive's data sheet. The text is ASCII without semicolons, which begin comments in data
/// sheets.
pub(super) const STATEMENTS: &[&str] = &[
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
