//! Frames in words.
//!
//! [`Decoder::describe`] is a function of the frame and of what is known of the bus beforehand: what its PDOs carry
//! and whose error codes its nodes send. It keeps nothing between frames, so the segments of an SDO transfer are shown
//! without their object.

use can::Frame;
use canopen::cia402::FaultTable;
use canopen::emcy::Emergency;
use canopen::heartbeat::Heartbeat;
use canopen::nmt::{Command, Request as NmtRequest, State, Target};
use canopen::pdo::{Entry, PdoKind};
use canopen::sdo::{Initiate, Request, Response, Segment};
use canopen::sync::Sync;
use canopen::{NodeId, Object, cob};
use clap::ValueEnum;
use serde::Serialize;

use super::pdo_map::{Pdo, PdoMap};
use super::value::Shown;
use super::words;

/// What a frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// NMT commands.
    Nmt,
    /// SYNC.
    Sync,
    /// Emergencies.
    Emcy,
    /// Time stamps.
    Time,
    /// PDOs, both ways.
    Pdo,
    /// SDO, both ways.
    Sdo,
    /// Heartbeats and boot-up messages.
    Heartbeat,
    /// Layer setting services.
    Lss,
    /// Anything else.
    Other,
}

impl Kind {
    const fn name(self) -> &'static str {
        match self {
            Self::Nmt => "NMT",
            Self::Sync => "SYNC",
            Self::Emcy => "EMCY",
            Self::Time => "TIME",
            Self::Pdo => "PDO",
            Self::Sdo => "SDO",
            Self::Heartbeat => "heartbeat",
            Self::Lss => "LSS",
            Self::Other => "frame",
        }
    }
}

/// A frame in words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Described {
    pub(crate) kind: Kind,
    /// Who sends it or whom it is for, where it is one node.
    pub(crate) node: Option<NodeId>,
    pub(crate) text: String,
}

/// What is known of a bus before its frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Decoder {
    pdos: PdoMap,
    vendors: std::collections::BTreeMap<NodeId, u32>,
}

impl Decoder {
    /// Adds PDOs to those that are known.
    pub(super) fn add_pdos(&mut self, pdos: PdoMap) {
        self.pdos.extend(pdos);
    }

    /// Whose error codes `node` sends.
    pub(super) fn set_vendor(&mut self, node: NodeId, vendor: u32) {
        self.vendors.insert(node, vendor);
    }

    fn faults(&self, node: NodeId) -> FaultTable {
        words::fault_table(self.vendors.get(&node).copied())
    }

    /// The frame in words.
    pub(crate) fn describe(&self, frame: &Frame) -> Described {
        let other = |what: &str| Described {
            kind: Kind::Other,
            node: None,
            text: format!("{what}{}", bytes(frame.data())),
        };
        let Some(id) = frame.standard_data_id() else {
            return if frame.is_remote() {
                other("remote frame")
            } else {
                other("29-bit identifier: ")
            };
        };
        if let Some(pdo) = self.pdos.get(&id.raw()) {
            return self.mapped(pdo, frame.data());
        }
        if let Some(text) = lss(id.raw(), frame.data()) {
            return Described {
                kind: Kind::Lss,
                node: None,
                text,
            };
        }
        let Some(function) = cob::Function::of(id) else {
            return other("unknown identifier: ");
        };
        let (kind, node, text) = match function {
            cob::Function::Nmt => (Kind::Nmt, None, nmt(frame)),
            cob::Function::Sync => (Kind::Sync, None, sync(frame)),
            cob::Function::Time => (Kind::Time, None, time(frame.data())),
            cob::Function::Emcy(node) => (Kind::Emcy, Some(node), self.emcy(frame)),
            cob::Function::Heartbeat(node) => (Kind::Heartbeat, Some(node), heartbeat(frame)),
            cob::Function::SdoRequest(node) => (Kind::Sdo, Some(node), self.request(frame, node)),
            cob::Function::SdoResponse(node) => (Kind::Sdo, Some(node), self.response(frame, node)),
            cob::Function::Tpdo(number, node) => {
                let text = unmapped("TPDO", number.offset(), frame.data());
                (Kind::Pdo, Some(node), Some(text))
            }
            cob::Function::Rpdo(number, node) => {
                let text = unmapped("RPDO", number.offset(), frame.data());
                (Kind::Pdo, Some(node), Some(text))
            }
        };
        let malformed = || format!("malformed {}: {}", kind.name(), bytes(frame.data()));
        Described {
            kind,
            node,
            text: text.unwrap_or_else(malformed),
        }
    }

    fn mapped(&self, pdo: &Pdo, data: &[u8]) -> Described {
        let name = match pdo.kind {
            PdoKind::Rpdo => "RPDO",
            PdoKind::Tpdo => "TPDO",
        };
        let mut text = format!("{name} {}", pdo.number.offset() + 1);
        let mut from = 0;
        for (position, entry) in pdo.entries.iter().enumerate() {
            text += if position == 0 { ": " } else { "; " };
            match bits(data, from, entry.bits) {
                Some(raw) => text += &self.entry(*entry, raw, pdo.node),
                None => {
                    text += "too short for its mapping";
                    break;
                }
            }
            from += usize::from(entry.bits);
        }
        if data.len() > from.div_ceil(8) {
            text += "; and ";
            text += &bytes(&data[from.div_ceil(8)..]);
        }
        Described {
            kind: Kind::Pdo,
            node: Some(pdo.node),
            text,
        }
    }

    /// A mapped object and its value.
    fn entry(&self, entry: Entry, raw: u64, node: NodeId) -> String {
        let Entry { object, bits } = entry;
        // Indices of data types stand for room that nothing uses (CiA 301, dummy mapping).
        if object.index < 0x0020 {
            return "unused".to_owned();
        }
        let name = words::object(object).unwrap_or_else(|| object.to_string());
        let unused = 64 - u32::from(bits);
        let number = if words::is_signed(object) {
            format!("{}", (raw << unused) as i64 >> unused)
        } else {
            format!("{raw:#0width$x}", width = 2 + usize::from(bits.div_ceil(4)))
        };
        match words::meaning(object, raw, self.faults(node)) {
            Some(meaning) => format!("{name} {number} ({meaning})"),
            None => format!("{name} {number}"),
        }
    }

    fn emcy(&self, frame: &Frame) -> Option<String> {
        let emergency = Emergency::decode(frame)?;
        let vendor = match emergency.vendor {
            [0, 0, 0, 0, 0] => String::new(),
            vendor => format!(", vendor's bytes {}", bytes(&vendor)),
        };
        let register = words::error_register(emergency.error_register);
        Some(if emergency.is_reset() {
            format!("error gone; still present: {register}{vendor}")
        } else {
            let (code, text) = (
                emergency.code,
                self.faults(emergency.node).text(emergency.code),
            );
            format!("error {code:#06x} ({text}); present: {register}{vendor}")
        })
    }

    fn request(&self, frame: &Frame, node: NodeId) -> Option<String> {
        Some(match Request::decode(frame, node)? {
            Request::InitiateUpload { object } => format!("read {}", named(object)),
            Request::InitiateDownload { object, initiate } => match initiate {
                Initiate::Expedited(data) => {
                    format!(
                        "write {} = {}",
                        named(object),
                        self.value(object, data.data(), node)
                    )
                }
                Initiate::Segmented { size: Some(size) } => {
                    format!("write {}, {size} bytes in segments", named(object))
                }
                Initiate::Segmented { size: None } => {
                    format!("write {} in segments", named(object))
                }
            },
            Request::DownloadSegment(segment) => segment_text(&segment),
            Request::UploadSegment { .. } => "next segment, please".to_owned(),
            Request::Abort { object, code } => format!("client aborts {}: {code}", named(object)),
            Request::Unsupported(_) => format!("block transfer: {}", bytes(frame.data())),
        })
    }

    fn response(&self, frame: &Frame, node: NodeId) -> Option<String> {
        Some(match Response::decode(frame, node)? {
            Response::InitiateUpload { object, initiate } => match initiate {
                Initiate::Expedited(data) => {
                    format!(
                        "{} = {}",
                        named(object),
                        self.value(object, data.data(), node)
                    )
                }
                Initiate::Segmented { size: Some(size) } => {
                    format!("{}: {size} bytes in segments", named(object))
                }
                Initiate::Segmented { size: None } => format!("{} in segments", named(object)),
            },
            Response::InitiateDownload { object } => format!("{} taken", named(object)),
            Response::UploadSegment(segment) => segment_text(&segment),
            Response::DownloadSegment { .. } => "segment taken".to_owned(),
            Response::Abort { object, code } => format!("aborts {}: {code}", named(object)),
            Response::Unsupported(_) => format!("block transfer: {}", bytes(frame.data())),
        })
    }

    fn value(&self, object: Object, data: &[u8], node: NodeId) -> String {
        let shown = Shown::of(data, None, words::is_signed(object));
        let raw = super::value::unsigned(data);
        match raw.and_then(|raw| words::meaning(object, raw, self.faults(node))) {
            Some(meaning) => format!("{shown} ({meaning})"),
            None => shown.to_string(),
        }
    }
}

/// `bits` bits of a PDO from bit `from` on; `None` if it is shorter.
fn bits(data: &[u8], from: usize, bits: u8) -> Option<u64> {
    if bits == 0 || bits > 64 || from + usize::from(bits) > 8 * data.len() {
        return None;
    }
    let mut padded = [0; 8];
    padded.get_mut(..data.len())?.copy_from_slice(data);
    let value = u64::from_le_bytes(padded) >> from;
    Some(value & u64::MAX >> (64 - u32::from(bits)))
}

fn named(object: Object) -> String {
    match words::object(object) {
        Some(name) => format!("{object} {name}"),
        None => object.to_string(),
    }
}

fn bytes(data: &[u8]) -> String {
    let bytes: Vec<_> = data.iter().map(|byte| format!("{byte:02x}")).collect();
    bytes.join(" ")
}

fn segment_text(segment: &Segment) -> String {
    let last = if segment.last {
        "last segment"
    } else {
        "segment"
    };
    let printable = segment
        .data()
        .iter()
        .all(|byte| matches!(byte, b' '..=b'~'));
    let text = if printable {
        format!(" {:?}", String::from_utf8_lossy(segment.data()))
    } else {
        String::new()
    };
    format!("{last} {}{text}", bytes(segment.data()))
}

fn nmt(frame: &Frame) -> Option<String> {
    let NmtRequest { command, target } = NmtRequest::decode(frame)?;
    let command = match command {
        Command::Start => "start",
        Command::Stop => "stop",
        Command::EnterPreOperational => "enter pre-operational",
        Command::ResetNode => "reset node",
        Command::ResetCommunication => "reset communication",
    };
    Some(match target {
        Target::All => format!("{command}, all nodes"),
        Target::Node(node) => format!("{command}, node {node}"),
    })
}

fn sync(frame: &Frame) -> Option<String> {
    Some(match Sync::decode(frame)?.counter {
        Some(counter) => format!("SYNC {counter}"),
        None => "SYNC".to_owned(),
    })
}

fn heartbeat(frame: &Frame) -> Option<String> {
    Some(match Heartbeat::decode(frame)?.state {
        State::Initialising => "booted".to_owned(),
        state => state.to_string(),
    })
}

fn unmapped(name: &str, offset: u16, data: &[u8]) -> String {
    format!("{name} {}: {}", offset + 1, bytes(data))
}

/// Milliseconds after midnight and days since 1984 (CiA 301, TIME_OF_DAY).
fn time(data: &[u8]) -> Option<String> {
    let &[a, b, c, d, days_low, days_high] = data else {
        return None;
    };
    let milliseconds = u32::from_le_bytes([a, b, c, d]) & 0x0FFF_FFFF;
    let days = u16::from_le_bytes([days_low, days_high]);
    let (year, month, day) = date(days);
    let seconds = milliseconds / 1000;
    Some(format!(
        "TIME {year}-{month:02}-{day:02} {:02}:{:02}:{:02}.{:03}",
        seconds / 3600,
        seconds / 60 % 60,
        seconds % 60,
        milliseconds % 1000
    ))
}

/// The date so many days after 1984-01-01.
fn date(days: u16) -> (u32, u32, u32) {
    let mut rest = u32::from(days);
    let mut year = 1984;
    let leap = |year: u32| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    while rest >= 365 + u32::from(leap(year)) {
        rest -= 365 + u32::from(leap(year));
        year += 1;
    }
    let february = 28 + u32::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if rest < length {
            break;
        }
        rest -= length;
        month += 1;
    }
    (year, month, rest + 1)
}

/// Layer setting services (CiA 305) by their command specifiers.
fn lss(id: u16, data: &[u8]) -> Option<String> {
    let from_master = match id {
        0x7E5 => true,
        0x7E4 => false,
        _ => return None,
    };
    let &[specifier, a, b, c, d, ..] = data else {
        return Some(format!("malformed LSS: {}", bytes(data)));
    };
    let number = u32::from_le_bytes([a, b, c, d]);
    let part = |first: u8| match specifier - first {
        0 => "vendor-ID",
        1 => "product code",
        2 => "revision number",
        _ => "serial number",
    };
    let error = match a {
        0 => "done",
        1 => "refused",
        _ => "refused by the vendor",
    };
    let text = match (specifier, from_master) {
        (0x04, true) if a == 0 => "all nodes to waiting".to_owned(),
        (0x04, true) => "all nodes to configuration".to_owned(),
        (0x40..=0x43, true) => format!("select {} {number:#010x}", part(0x40)),
        (0x44, false) => "selected".to_owned(),
        (0x11, true) if a == 0xFF => "take the node-ID away".to_owned(),
        (0x11, true) => format!("configure node-ID {a}"),
        (0x11, false) => format!("configure node-ID: {error}"),
        (0x13, true) => format!("configure bit timing, table {a}, index {b}"),
        (0x13, false) => format!("configure bit timing: {error}"),
        (0x15, true) => format!(
            "activate bit timing after {} ms",
            u16::from_le_bytes([a, b])
        ),
        (0x17, true) => "store".to_owned(),
        (0x17, false) => format!("store: {error}"),
        (0x5A..=0x5D, true) => format!("inquire {}", part(0x5A)),
        (0x5A..=0x5D, false) => format!("{} {number:#010x}", part(0x5A)),
        (0x5E, true) => "inquire node-ID".to_owned(),
        (0x5E, false) => format!("node-ID {a}"),
        (0x46..=0x4B, true) => format!("identify remote slave, {:#010x}", number),
        (0x4F, false) => "identified".to_owned(),
        (0x4C, true) => "identify unconfigured slaves".to_owned(),
        (0x50, false) => "unconfigured slave".to_owned(),
        (0x51, true) => match data.get(5) {
            Some(0x80) => "fastscan, who is unconfigured".to_owned(),
            Some(bit) => format!("fastscan {number:#010x} down to bit {bit}"),
            None => return Some(format!("malformed LSS: {}", bytes(data))),
        },
        _ => bytes(data),
    };
    Some(format!("LSS {text}"))
}

#[cfg(test)]
mod tests {
    use can::{ExtendedId, StandardId};
    use canopen::objects::{POSITION_ACTUAL, STATUSWORD, TORQUE_ACTUAL};
    use canopen::pdo::PdoNumber;

    use super::*;

    /// The frame that candump prints as `text`.
    fn parse(text: &str) -> Frame {
        let (id, data) = text.split_once('#').unwrap();
        let raw = u32::from_str_radix(id, 16).unwrap();
        let bytes: Vec<u8> = (0..data.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&data[at..at + 2], 16).unwrap())
            .collect();
        match id.len() {
            3 => Frame::new(StandardId::new(raw as u16).unwrap(), &bytes).unwrap(),
            _ => Frame::new(ExtendedId::new(raw).unwrap(), &bytes).unwrap(),
        }
    }

    fn check(decoder: &Decoder, table: &[(&str, Kind, Option<u8>, &str)]) {
        for (frame, kind, node, text) in table {
            let expected = Described {
                kind: *kind,
                node: node.and_then(NodeId::new),
                text: (*text).to_owned(),
            };
            assert_eq!(decoder.describe(&parse(frame)), expected, "{frame}");
        }
    }

    #[test]
    fn network_management_is_told_in_words() {
        use Kind::{Heartbeat, Nmt, Sync, Time};
        check(
            &Decoder::default(),
            &[
                ("000#0105", Nmt, None, "start, node 5"),
                ("000#8000", Nmt, None, "enter pre-operational, all nodes"),
                ("000#8102", Nmt, None, "reset node, node 2"),
                ("000#0300", Nmt, None, "malformed NMT: 03 00"),
                ("080#", Sync, None, "SYNC"),
                ("080#05", Sync, None, "SYNC 5"),
                ("702#00", Heartbeat, Some(2), "booted"),
                ("702#7F", Heartbeat, Some(2), "pre-operational"),
                ("702#05", Heartbeat, Some(2), "operational"),
                ("702#", Heartbeat, Some(2), "malformed heartbeat: "),
                (
                    "100#952CB302313D",
                    Time,
                    None,
                    "TIME 2026-11-21 12:34:56.789",
                ),
                (
                    "100#000000003C00",
                    Time,
                    None,
                    "TIME 1984-03-01 00:00:00.000",
                ),
                ("100#00", Time, None, "malformed TIME: 00"),
            ],
        );
    }

    #[test]
    fn emergencies_are_told_by_the_vendors_own_texts() {
        let mut decoder = Decoder::default();
        let over_current = "error 0x2310 (continuous over-current); present: current";
        check(
            &decoder,
            &[
                ("082#1023030000000000", Kind::Emcy, Some(2), over_current),
                (
                    "082#0000000000000000",
                    Kind::Emcy,
                    Some(2),
                    "error gone; still present: none",
                ),
                (
                    "082#0CFF800102030405",
                    Kind::Emcy,
                    Some(2),
                    "error 0xff0c (device specific); present: vendor, vendor's bytes 01 02 03 04 05",
                ),
                ("082#1023", Kind::Emcy, Some(2), "malformed EMCY: 10 23"),
            ],
        );
        let generic = decoder.describe(&parse("082#8152010000000000")).text;
        decoder.set_vendor(NodeId::new(2).unwrap(), 0xFB);
        let maxon = decoder.describe(&parse("082#8152010000000000")).text;
        assert_ne!(generic, maxon);
    }

    #[test]
    fn sdo_transfers_are_told_by_object_and_value() {
        use Kind::Sdo;
        check(
            &Decoder::default(),
            &[
                (
                    "602#4041600000000000",
                    Sdo,
                    Some(2),
                    "read 0x6041:00 statusword",
                ),
                (
                    "582#4B41600037070000",
                    Sdo,
                    Some(2),
                    "0x6041:00 statusword = 0x0737, 1847 (operation enabled, target reached)",
                ),
                (
                    "602#2B4060000F000000",
                    Sdo,
                    Some(2),
                    "write 0x6040:00 controlword = 0x000f, 15 (enable operation)",
                ),
                (
                    "582#6040600000000000",
                    Sdo,
                    Some(2),
                    "0x6040:00 controlword taken",
                ),
                (
                    "602#237A6000FEFFFFFF",
                    Sdo,
                    Some(2),
                    "write 0x607a:00 target position = 0xfffffffe, -2",
                ),
                (
                    "582#8041600002000106",
                    Sdo,
                    Some(2),
                    "aborts 0x6041:00 statusword: 0x06010002 (attempt to write a read-only object)",
                ),
                (
                    "602#80FF5F0000000405",
                    Sdo,
                    Some(2),
                    "client aborts 0x5fff:00: 0x05040000 (SDO protocol timed out)",
                ),
                (
                    "582#4108100005000000",
                    Sdo,
                    Some(2),
                    "0x1008:00 manufacturer device name: 5 bytes in segments",
                ),
                ("602#6000000000000000", Sdo, Some(2), "next segment, please"),
                (
                    "582#0545504F53340000",
                    Sdo,
                    Some(2),
                    "last segment 45 50 4f 53 34 \"EPOS4\"",
                ),
                (
                    "582#C600000000000000",
                    Sdo,
                    Some(2),
                    "block transfer: c6 00 00 00 00 00 00 00",
                ),
                ("602#40", Sdo, Some(2), "malformed SDO: 40"),
            ],
        );
    }

    #[test]
    fn pdos_are_told_by_their_mapping_where_it_is_known() {
        let node = NodeId::new(2).unwrap();
        let mut decoder = Decoder::default();
        let tpdo = |entries: &[Entry]| {
            let pdo = Pdo {
                node,
                kind: PdoKind::Tpdo,
                number: PdoNumber::One,
                entries: entries.to_vec(),
            };
            PdoMap::from([(0x182, pdo)])
        };
        check(
            &decoder,
            &[
                ("182#3702", Kind::Pdo, Some(2), "TPDO 1: 37 02"),
                ("302#", Kind::Pdo, Some(2), "RPDO 2: "),
            ],
        );
        decoder.add_pdos(tpdo(&[
            Entry::new(STATUSWORD, 16),
            Entry::new(POSITION_ACTUAL, 32),
            Entry::new(TORQUE_ACTUAL, 16),
        ]));
        let whole = "TPDO 1: statusword 0x0237 (operation enabled); position actual value -2; torque actual value 12";
        let short =
            "TPDO 1: statusword 0x0237 (operation enabled); too short for its mapping; and fe ff";
        check(
            &decoder,
            &[
                ("182#3702FEFFFFFF0C00", Kind::Pdo, Some(2), whole),
                ("182#3702FEFF", Kind::Pdo, Some(2), short),
            ],
        );
        // Bits, room that nothing uses, an object without a name, and more bytes than are mapped.
        decoder.add_pdos(tpdo(&[
            Entry::new(Object::new(0x2000, 1), 1),
            Entry::new(Object::new(0x2000, 2), 3),
            Entry::new(Object::new(0x0005, 0), 4),
            Entry::new(Object::new(0x6061, 0), 8),
        ]));
        let bits = "TPDO 1: 0x2000:01 0x1; 0x2000:02 0x6; unused; \
                    modes of operation display -3 (mode -3); and 07";
        check(&decoder, &[("182#ADFD07", Kind::Pdo, Some(2), bits)]);
    }

    #[test]
    fn layer_setting_services_are_told_in_words() {
        use Kind::Lss;
        check(
            &Decoder::default(),
            &[
                (
                    "7E5#0401000000000000",
                    Lss,
                    None,
                    "LSS all nodes to configuration",
                ),
                (
                    "7E5#0400000000000000",
                    Lss,
                    None,
                    "LSS all nodes to waiting",
                ),
                (
                    "7E5#40FB000000000000",
                    Lss,
                    None,
                    "LSS select vendor-ID 0x000000fb",
                ),
                ("7E4#4400000000000000", Lss, None, "LSS selected"),
                ("7E5#1105000000000000", Lss, None, "LSS configure node-ID 5"),
                (
                    "7E5#11FF000000000000",
                    Lss,
                    None,
                    "LSS take the node-ID away",
                ),
                (
                    "7E4#1101000000000000",
                    Lss,
                    None,
                    "LSS configure node-ID: refused",
                ),
                ("7E4#1700000000000000", Lss, None, "LSS store: done"),
                (
                    "7E4#5D78563412000000",
                    Lss,
                    None,
                    "LSS serial number 0x12345678",
                ),
                (
                    "7E5#5100000000800000",
                    Lss,
                    None,
                    "LSS fastscan, who is unconfigured",
                ),
                (
                    "7E5#51FB0000001F0000",
                    Lss,
                    None,
                    "LSS fastscan 0x000000fb down to bit 31",
                ),
                ("7E4#4F00000000000000", Lss, None, "LSS identified"),
                ("7E4#04", Lss, None, "malformed LSS: 04"),
            ],
        );
    }

    #[test]
    fn what_is_not_known_is_shown_in_hexadecimal() {
        let remote = Frame::remote(StandardId::new(0x701).unwrap(), 1).unwrap();
        assert_eq!(Decoder::default().describe(&remote).text, "remote frame");
        check(
            &Decoder::default(),
            &[
                ("7FF#0102", Kind::Other, None, "unknown identifier: 01 02"),
                ("00012345#AB", Kind::Other, None, "29-bit identifier: ab"),
            ],
        );
    }

    #[test]
    fn no_frame_is_too_odd_to_be_told() {
        let mut decoder = Decoder::default();
        let pdo = Pdo {
            node: NodeId::MAX,
            kind: PdoKind::Rpdo,
            number: PdoNumber::Four,
            entries: (0..=u8::MAX)
                .map(|bits| Entry::new(Object::new(0x6064, 0), bits))
                .collect(),
        };
        decoder.add_pdos(PdoMap::from([(0x57F, pdo)]));
        // A seeded walk over identifiers, lengths and bytes.
        let mut random = 0x2545_F491_4F6C_DD1D_u64;
        for id in 0..=0x7FF {
            for length in 0..=8 {
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                let data = random.to_le_bytes();
                let frame = Frame::new(StandardId::new(id).unwrap(), &data[..length]).unwrap();
                assert!(!decoder.describe(&frame).text.is_empty());
            }
        }
    }
}
