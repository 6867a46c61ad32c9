//! Text of CAN frames.
//!
//! [`Decoder::describe`] depends on the frame, on earlier frames and on prior knowledge of the bus. Prior knowledge is
//! the mapping of the PDOs, and the vendor and the device type of each node. Vendor and device type determine the texts
//! of the node's error codes. The decoder also takes vendor and device type from SDO answers on the bus. A segment of a
//! block transfer looks like any command. The decoder therefore keeps the SDO transfer under way with each node. If the
//! start of a transfer was not seen, the text says "unknown".

mod block;
mod error_frame;
mod lss;
mod transfer;

use std::collections::BTreeMap;

use can::{Frame, Instant};
use canopen::cia402::FaultTable;
use canopen::emcy::Emergency;
use canopen::heartbeat::Heartbeat;
use canopen::nmt::{Command, NmtState, Request as NmtRequest, Target};
use canopen::objects::{DEVICE_TYPE, VENDOR_ID};
use canopen::pdo::{Entry, PdoKind, PdoNumber};
use canopen::sdo::{Initiate, Request, Response, Segment};
use canopen::sync::Sync;
use canopen::time::TimeOfDay;
use canopen::{NodeId, Object, cob};
use clap::ValueEnum;
use serde::{Serialize, Serializer};

use super::pdo_map::{Pdo, PdoMap};
use super::value::Shown;
use super::words::{self, Identification};
use mrroc::report::counted;
use transfer::{Channel, Reading, Side};

/// Service that a frame belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// NMT commands.
    Nmt,
    /// SYNC.
    Sync,
    /// Emergencies.
    Emcy,
    /// Time stamps.
    Time,
    /// PDOs, both directions.
    Pdo,
    /// SDO, both directions.
    Sdo,
    /// Heartbeats, answers to node guarding, and boot-up messages.
    Heartbeat,
    /// Layer setting services.
    Lss,
    /// Error frames of the kernel.
    Error,
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
            Self::Error => "error frame",
            Self::Other => "frame",
        }
    }
}

/// Text of a frame and its service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Described {
    /// Service of the frame.
    pub kind: Kind,
    /// The node that sends or receives the frame, if there is exactly one.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "raw")]
    pub node: Option<NodeId>,
    /// Text of the frame.
    pub text: String,
}

#[expect(clippy::ref_option, reason = "the signature that serde calls")]
fn raw<S: Serializer>(node: &Option<NodeId>, serializer: S) -> Result<S::Ok, S::Error> {
    node.map(NodeId::raw).serialize(serializer)
}

/// Knowledge of a bus. Initially no SDO transfer is under way.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    pdos: PdoMap,
    identifications: BTreeMap<NodeId, Identification>,
    /// SDO channels on which frames were seen.
    channels: BTreeMap<NodeId, Channel>,
    /// Time since which every frame was seen; `None` means since the start of the bus.
    complete_since: Option<Instant>,
}

impl Decoder {
    /// Adds PDOs to the known ones.
    pub(super) fn add_pdos(&mut self, pdos: PdoMap) {
        self.pdos.extend(pdos);
    }

    /// Adds known parts of the identification of `node`, which determines the texts of the node's error codes.
    pub(super) fn identify(&mut self, node: NodeId, found: Identification) {
        let known = self.identifications.entry(node).or_default();
        known.vendor = found.vendor.or(known.vendor);
        known.device_type = found.device_type.or(known.device_type);
    }

    /// Frames before `at` were not seen, because listening started then or frames were lost.
    pub(super) fn begin(&mut self, at: Instant) {
        self.channels.clear();
        self.complete_since = Some(at);
    }

    fn channel(&mut self, node: NodeId) -> &mut Channel {
        let channel = || match self.complete_since {
            None => Channel::idle(node),
            Some(began) => Channel::listened_to_since(node, began),
        };
        self.channels.entry(node).or_insert_with(channel)
    }

    fn faults(&self, node: NodeId) -> FaultTable {
        self.identifications.get(&node).copied().unwrap_or_default().fault_table()
    }

    /// Text of a frame that arrived at `at`.
    pub fn describe(&mut self, frame: &Frame, at: Instant) -> Described {
        let (kind, node, text) = self.read(frame, at);
        let text = text.unwrap_or_else(|| format!("malformed {}: {}", kind.name(), bytes(frame.data())));
        Described { kind, node, text }
    }

    /// Kind and node of a frame, and its text unless the frame is malformed.
    fn read(&mut self, frame: &Frame, at: Instant) -> (Kind, Option<NodeId>, Option<String>) {
        let other = |what: &str| (Kind::Other, None, Some(format!("{what}{}", bytes(frame.data()))));
        if frame.is_error() {
            return (Kind::Error, None, Some(error_frame::text(frame)));
        }
        let Some(id) = frame.standard_data_id() else {
            return other(if frame.is_remote() { "remote frame" } else { "29-bit identifier: " });
        };
        if let Some(pdo) = self.pdos.get(&id.raw()) {
            return (Kind::Pdo, Some(pdo.node), Some(self.mapped(pdo, frame.data())));
        }
        if matches!(id, cob::LSS_REQUEST | cob::LSS_RESPONSE) {
            return (Kind::Lss, None, lss::request(frame).or_else(|| lss::response(frame)));
        }
        let Some(function) = cob::Function::of(id) else {
            return other("unknown identifier: ");
        };
        let pdo = |name, number: PdoNumber| Some(format!("{name} {}: {}", number.offset() + 1, bytes(frame.data())));
        match function {
            cob::Function::Nmt => (Kind::Nmt, None, nmt(frame)),
            cob::Function::Sync => (Kind::Sync, None, sync(frame)),
            cob::Function::Time => (Kind::Time, None, time(frame)),
            cob::Function::Emcy(node) => (Kind::Emcy, Some(node), self.emcy(frame)),
            cob::Function::Heartbeat(node) => (Kind::Heartbeat, Some(node), heartbeat(frame)),
            cob::Function::SdoRequest(node) => (Kind::Sdo, Some(node), self.request(frame, node, at)),
            cob::Function::SdoResponse(node) => (Kind::Sdo, Some(node), self.response(frame, node, at)),
            cob::Function::Tpdo(number, node) => (Kind::Pdo, Some(node), pdo("TPDO", number)),
            cob::Function::Rpdo(number, node) => (Kind::Pdo, Some(node), pdo("RPDO", number)),
        }
    }

    fn mapped(&self, pdo: &Pdo, data: &[u8]) -> String {
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
        text
    }

    /// Text of a mapped object and its value.
    fn entry(&self, entry: Entry, raw: u64, node: NodeId) -> String {
        let Entry { object, bits } = entry;
        // A mapped index below 0x0020 is a data type: a dummy entry, whose bits carry no value (CiA 301, dummy
        // mapping).
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
        let code = emergency.code;
        let text = self.faults(emergency.node).text(code);
        Some(if emergency.is_reset() {
            format!("error gone; still present: {register}{vendor}")
        } else {
            format!("error {code:#06x} ({text}); present: {register}{vendor}")
        })
    }

    fn request(&mut self, frame: &Frame, node: NodeId, at: Instant) -> Option<String> {
        let request = Request::decode(frame, node)?;
        let transferred = match self.channel(node).read(Side::Client, frame, at) {
            Reading::Command(object) => object,
            Reading::BlockSegment(object) => return Some(block::segment(frame, object)),
            Reading::Unknown => return Some(block::unknown(frame, "a command")),
        };
        Some(match request {
            Request::InitiateUpload { object } => format!("read {}", named(object)),
            Request::InitiateDownload { object, initiate } => {
                format!("write {}", self.initiated(object, &initiate, ",", node))
            }
            Request::DownloadSegment(segment) => segment_text(&segment, transferred),
            Request::UploadSegment { .. } => "next segment, please".to_owned(),
            Request::Abort { object, code } => format!("client aborts {}: {code}", named(object)),
            Request::Block(request) => block::request(request),
            Request::Unsupported(bytes) => odd(&bytes),
        })
    }

    fn response(&mut self, frame: &Frame, node: NodeId, at: Instant) -> Option<String> {
        let response = Response::decode(frame, node)?;
        let transferred = match self.channel(node).read(Side::Server, frame, at) {
            Reading::Command(object) => object,
            Reading::BlockSegment(object) => return Some(block::segment(frame, object)),
            Reading::Unknown => return Some(block::unknown(frame, "an answer")),
        };
        if let Response::InitiateUpload { object, initiate: Initiate::Expedited(data) } = &response {
            let raw = super::value::unsigned(data.data()).map(|raw| raw as u32);
            match *object {
                VENDOR_ID => self.identify(node, Identification { vendor: raw, ..Identification::default() }),
                DEVICE_TYPE => self.identify(node, Identification { device_type: raw, ..Identification::default() }),
                _ => {}
            }
        }
        Some(match response {
            Response::InitiateUpload { object, initiate } => self.initiated(object, &initiate, ":", node),
            Response::InitiateDownload { object } => format!("{} taken", named(object)),
            Response::UploadSegment(segment) => segment_text(&segment, transferred),
            Response::DownloadSegment { .. } => "segment taken".to_owned(),
            Response::Abort { object, code } => format!("aborts {}: {code}", named(object)),
            Response::Block(response) => block::response(response),
            Response::Unsupported(bytes) => odd(&bytes),
        })
    }

    /// Text of the start of a transfer, with `colon` before the size.
    fn initiated(&self, object: Object, initiate: &Initiate, colon: &str, node: NodeId) -> String {
        let name = named(object);
        match initiate {
            Initiate::Expedited(data) => format!("{name} = {}", self.value(object, data.data(), node)),
            Initiate::Segmented { size: Some(size) } => format!("{name}{colon} {} in segments", counted(*size, "byte")),
            Initiate::Segmented { size: None } => format!("{name} in segments"),
        }
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

/// Value of `bits` bits of a PDO from bit `from` on; `None` if the PDO is shorter.
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

/// Text of an SDO frame that CiA 301 does not define.
fn odd(data: &[u8]) -> String {
    format!("unknown command specifier: {}", bytes(data))
}

fn segment_text(segment: &Segment, object: Option<Object>) -> String {
    let last = if segment.last { "last segment" } else { "segment" };
    let of = object.map_or(String::new(), |object| format!(" of {}:", named(object)));
    let printable = segment.data().iter().all(|byte| matches!(byte, b' '..=b'~'));
    let text = if printable { format!(" {:?}", String::from_utf8_lossy(segment.data())) } else { String::new() };
    format!("{last}{of} {}{text}", bytes(segment.data()))
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
    // An answer to node guarding is a heartbeat with a toggle bit. The bit is 0 in a heartbeat proper.
    Some(match Heartbeat::decode(frame)?.guarded() {
        (NmtState::Initialising, false) => "booted".to_owned(),
        (state, false) => state.to_string(),
        (state, true) => format!("{state}, toggle bit set"),
    })
}

fn time(frame: &Frame) -> Option<String> {
    let time = TimeOfDay::decode(frame)?;
    let (year, month, day) = date(time.days);
    let seconds = time.millis / 1000;
    Some(format!(
        "TIME {year}-{month:02}-{day:02} {:02}:{:02}:{:02}.{:03}",
        seconds / 3600,
        seconds / 60 % 60,
        seconds % 60,
        time.millis % 1000
    ))
}

/// Date of the day that lies `days` days after 1984-01-01.
fn date(days: u16) -> (u32, u32, u32) {
    let mut rest = u32::from(days);
    let mut year = 1984;
    let leap = |year: u32| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
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

#[cfg(test)]
mod tests;
