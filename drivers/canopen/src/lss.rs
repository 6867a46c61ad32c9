//! LSS, the layer setting services (CiA 305): node-IDs and bit rates for nodes that have none.
//!
//! A [`Request`] goes from the master to all slaves, a [`Response`] from the addressed slave to the master. Neither has a
//! node-ID. A node without a node-ID takes part in LSS alone. Slaves obey the configuring requests only in
//! [`Mode::Configuration`].

use std::fmt;

use can::Frame;

use crate::{cob, frame, payload};

/// The node-ID of a node that has none.
pub const UNCONFIGURED: u8 = 0xFF;

/// The bit timing table of CiA (CiA 305 §6.4.3). [`BitRate::from_index`] has its indices.
pub const CIA_TABLE: u8 = 0;

/// The LSS address of a node, unique among all nodes of CANopen: object 0x1018 (CiA 301 §7.5.2.21).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Identity {
    /// Vendor-ID, given by CiA.
    pub vendor: u32,
    /// Product code, given by the vendor.
    pub product: u32,
    /// Revision number.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
}

impl Identity {
    /// One of the four numbers.
    pub const fn get(&self, part: Part) -> u32 {
        [self.vendor, self.product, self.revision, self.serial][part as usize]
    }

    /// One of the four numbers, to write it.
    pub const fn get_mut(&mut self, part: Part) -> &mut u32 {
        match part {
            Part::Vendor => &mut self.vendor,
            Part::Product => &mut self.product,
            Part::Revision => &mut self.revision,
            Part::Serial => &mut self.serial,
        }
    }
}

/// A bit rate of the [`CIA_TABLE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BitRate {
    /// kbit/s.
    Kbps(u16),
    /// The node detects the bit rate of the bus.
    Automatic,
}

impl BitRate {
    /// `None` for an index that the table does not have; 5 is reserved.
    pub const fn from_index(index: u8) -> Option<Self> {
        Some(Self::Kbps(match index {
            0 => 1000,
            1 => 800,
            2 => 500,
            3 => 250,
            4 => 125,
            6 => 50,
            7 => 20,
            8 => 10,
            9 => return Some(Self::Automatic),
            _ => return None,
        }))
    }
}

/// A request of the master, on 0x7E5.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Request {
    /// All slaves enter this mode (CiA 305 §6.3.2). Not answered.
    SwitchGlobal(Mode),
    /// One of four frames (CiA 305 §6.3.3). The slave with this [identity](Identity) enters configuration mode and
    /// answers [`Response::Selected`] after the fourth frame.
    SwitchSelective { part: Part, value: u32 },
    /// Take this node-ID at the next reset of the communication (CiA 305 §6.4.2): 1 ..= 127 or [`UNCONFIGURED`]. A
    /// slave refuses others.
    ConfigureNodeId { node_id: u8 },
    /// Take this bit rate at its activation or at the next power-on (CiA 305 §6.4.3): an index of the [`CIA_TABLE`]
    /// ([`BitRate::from_index`]), or of a table of the vendor.
    ConfigureBitTiming { table: u8, index: u8 },
    /// Be silent for the delay, change to the configured bit rate, and be silent for the delay again. Not answered.
    ActivateBitTiming { delay_ms: u16 },
    /// Keep node-ID and bit rate over power-off (CiA 305 §6.4.5).
    Store,
    /// Ask for one number of the identity (CiA 305 §6.5.2).
    Inquire(Part),
    /// Ask for the node-ID (CiA 305 §6.5.3).
    InquireNodeId,
    /// One of six inclusive bounds (CiA 305 §6.6.2). Every slave within all bounds answers [`Response::Identified`]
    /// after the last.
    Identify { bound: Bound, value: u32 },
    /// Every slave without a node-ID answers [`Response::Unconfigured`] (CiA 305 §6.6.4).
    IdentifyUnconfigured,
    /// Every slave without a node-ID whose identity agrees so far answers [`Response::Identified`] (CiA 305 §6.7).
    Fastscan(Fastscan),
}

/// An answer of a slave, on 0x7E4. Equal answers of several slaves at the same time are one frame on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Response {
    /// Its identity was named; it is in configuration mode.
    Selected,
    /// To [`Request::ConfigureNodeId`].
    NodeIdConfigured(Outcome),
    /// To [`Request::ConfigureBitTiming`].
    BitTimingConfigured(Outcome),
    /// To [`Request::Store`].
    Stored(Outcome),
    /// To [`Request::Inquire`].
    Inquired { part: Part, value: u32 },
    /// To [`Request::InquireNodeId`]: 1 ..= 127 or [`UNCONFIGURED`].
    NodeId { node_id: u8 },
    /// To [`Request::Identify`] and [`Request::Fastscan`].
    Identified,
    /// To [`Request::IdentifyUnconfigured`].
    Unconfigured,
}

/// The LSS state of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The slave takes switching and identifying requests.
    Waiting,
    /// The slave takes configuring and inquiring requests as well.
    Configuration,
}

/// One of the four numbers of an identity, in the order in which they are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// Vendor-ID.
    Vendor,
    /// Product code.
    Product,
    /// Revision number.
    Revision,
    /// Serial number.
    Serial,
}

impl Part {
    /// All of them, in order.
    pub const ALL: [Self; 4] = [Self::Vendor, Self::Product, Self::Revision, Self::Serial];

    /// 0 ..= 3, as fastscan counts them.
    pub const fn index(self) -> u8 {
        self as u8
    }

    /// The one sent after it.
    pub fn next(self) -> Option<Self> {
        Self::ALL.get(self as usize + 1).copied()
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Vendor => "vendor-ID",
            Self::Product => "product code",
            Self::Revision => "revision number",
            Self::Serial => "serial number",
        })
    }
}

/// One of the six numbers of a range of identities, in the order in which they are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Bound {
    /// This vendor-ID.
    Vendor,
    /// This product code.
    Product,
    /// At least this revision number.
    RevisionLow,
    /// At most this revision number.
    RevisionHigh,
    /// At least this serial number.
    SerialLow,
    /// At most this serial number.
    SerialHigh,
}

impl Bound {
    /// All of them, in order.
    pub const ALL: [Self; 6] =
        [Self::Vendor, Self::Product, Self::RevisionLow, Self::RevisionHigh, Self::SerialLow, Self::SerialHigh];
}

/// The [`Fastscan::bit`] that every slave without a node-ID answers, and which begins the scan.
pub const FASTSCAN_RESET: u8 = 0x80;

/// One question of a fastscan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fastscan {
    /// The number asked about; its bits below `bit` do not count.
    pub number: u32,
    /// The lowest bit that counts, 31 down to 0, or [`FASTSCAN_RESET`].
    pub bit: u8,
    /// Which number of the identity, [`Part::index`].
    pub sub: u8,
    /// The number of the identity that slaves which agree in all bits turn to; after the last number 0,
    /// and the slave enters configuration mode.
    pub next: u8,
}

/// Result of a configuring request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// [`Outcome::SUCCESS`], or the reason of the failure.
    pub error: u8,
    /// The vendor's code, if `error` is [`Outcome::VENDOR`].
    pub specific: u8,
}

impl Outcome {
    /// Success.
    pub const SUCCESS: u8 = 0;
    /// The node-ID or bit rate is out of range; of a store: not supported.
    pub const OUT_OF_RANGE: u8 = 1;
    /// Of a store: the storage cannot be accessed.
    pub const STORAGE: u8 = 2;
    /// The vendor's code follows.
    pub const VENDOR: u8 = 0xFF;
}

impl Request {
    /// The frame.
    pub fn encode(self) -> Frame {
        let bytes = match self {
            Self::SwitchGlobal(Mode::Waiting) => short(0x04, [0, 0]),
            Self::SwitchGlobal(Mode::Configuration) => short(0x04, [1, 0]),
            Self::SwitchSelective { part, value } => long(0x40 + part.index(), value),
            Self::ConfigureNodeId { node_id } => short(0x11, [node_id, 0]),
            Self::ConfigureBitTiming { table, index } => short(0x13, [table, index]),
            Self::ActivateBitTiming { delay_ms } => short(0x15, delay_ms.to_le_bytes()),
            Self::Store => short(0x17, [0, 0]),
            Self::Inquire(part) => long(0x5A + part.index(), 0),
            Self::InquireNodeId => long(0x5E, 0),
            Self::Identify { bound, value } => long(0x46 + bound as u8, value),
            Self::IdentifyUnconfigured => long(0x4C, 0),
            Self::Fastscan(Fastscan { number, bit, sub, next }) => {
                let [a, b, c, d] = number.to_le_bytes();
                [0x51, a, b, c, d, bit, sub, next]
            }
        };
        frame(cob::LSS_REQUEST, bytes)
    }

    /// `None` for other frames, lengths other than 8 bytes, unknown services and unknown modes: slaves ignore
    /// them.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let bytes: [u8; 8] = payload(frame, cob::LSS_REQUEST)?.try_into().ok()?;
        let [specifier, first, second, ..] = bytes;
        let value = value(bytes);
        Some(match specifier {
            0x04 => Self::SwitchGlobal(match first {
                0 => Mode::Waiting,
                1 => Mode::Configuration,
                _ => return None,
            }),
            0x11 => Self::ConfigureNodeId { node_id: first },
            0x13 => Self::ConfigureBitTiming { table: first, index: second },
            0x15 => Self::ActivateBitTiming { delay_ms: u16::from_le_bytes([first, second]) },
            0x17 => Self::Store,
            0x40..=0x43 => Self::SwitchSelective { part: Part::ALL[usize::from(specifier - 0x40)], value },
            0x46..=0x4B => Self::Identify { bound: Bound::ALL[usize::from(specifier - 0x46)], value },
            0x4C => Self::IdentifyUnconfigured,
            0x51 => Self::Fastscan(Fastscan { number: value, bit: bytes[5], sub: bytes[6], next: bytes[7] }),
            0x5A..=0x5D => Self::Inquire(Part::ALL[usize::from(specifier - 0x5A)]),
            0x5E => Self::InquireNodeId,
            _ => return None,
        })
    }
}

impl Response {
    /// The frame.
    pub fn encode(self) -> Frame {
        let bytes = match self {
            Self::Selected => long(0x44, 0),
            Self::NodeIdConfigured(outcome) => outcome.encode(0x11),
            Self::BitTimingConfigured(outcome) => outcome.encode(0x13),
            Self::Stored(outcome) => outcome.encode(0x17),
            Self::Inquired { part, value } => long(0x5A + part.index(), value),
            Self::NodeId { node_id } => short(0x5E, [node_id, 0]),
            Self::Identified => long(0x4F, 0),
            Self::Unconfigured => long(0x50, 0),
        };
        frame(cob::LSS_RESPONSE, bytes)
    }

    /// `None` for other frames, lengths other than 8 bytes and unknown services.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let bytes: [u8; 8] = payload(frame, cob::LSS_RESPONSE)?.try_into().ok()?;
        let [specifier, error, specific, ..] = bytes;
        let outcome = Outcome { error, specific };
        Some(match specifier {
            0x11 => Self::NodeIdConfigured(outcome),
            0x13 => Self::BitTimingConfigured(outcome),
            0x17 => Self::Stored(outcome),
            0x44 => Self::Selected,
            0x4F => Self::Identified,
            0x50 => Self::Unconfigured,
            0x5A..=0x5D => Self::Inquired { part: Part::ALL[usize::from(specifier - 0x5A)], value: value(bytes) },
            0x5E => Self::NodeId { node_id: bytes[1] },
            _ => return None,
        })
    }
}

impl Outcome {
    fn encode(self, specifier: u8) -> [u8; 8] {
        short(specifier, [self.error, self.specific])
    }
}

fn short(specifier: u8, [first, second]: [u8; 2]) -> [u8; 8] {
    [specifier, first, second, 0, 0, 0, 0, 0]
}

fn long(specifier: u8, value: u32) -> [u8; 8] {
    let [a, b, c, d] = value.to_le_bytes();
    [specifier, a, b, c, d, 0, 0, 0]
}

fn value(bytes: [u8; 8]) -> u32 {
    u32::from_le_bytes([bytes[1], bytes[2], bytes[3], bytes[4]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    const VALUE: u32 = 0x0403_0201;

    #[test]
    fn requests_are_these_bytes() {
        let select = |part, value| Request::SwitchSelective { part, value };
        let identify = |bound, value| Request::Identify { bound, value };
        let table = [
            (Request::SwitchGlobal(Mode::Waiting), "0400000000000000"),
            (Request::SwitchGlobal(Mode::Configuration), "0401000000000000"),
            (select(Part::Vendor, 0xFB), "40FB000000000000"),
            (select(Part::Product, VALUE), "4101020304000000"),
            (select(Part::Revision, VALUE), "4201020304000000"),
            (select(Part::Serial, u32::MAX), "43FFFFFFFF000000"),
            (Request::ConfigureNodeId { node_id: 5 }, "1105000000000000"),
            (Request::ConfigureNodeId { node_id: 0xFF }, "11FF000000000000"),
            (Request::ConfigureBitTiming { table: 0, index: 2 }, "1300020000000000"),
            (Request::ActivateBitTiming { delay_ms: 0x03E8 }, "15E8030000000000"),
            (Request::Store, "1700000000000000"),
            (Request::Inquire(Part::Vendor), "5A00000000000000"),
            (Request::Inquire(Part::Product), "5B00000000000000"),
            (Request::Inquire(Part::Revision), "5C00000000000000"),
            (Request::Inquire(Part::Serial), "5D00000000000000"),
            (Request::InquireNodeId, "5E00000000000000"),
            (identify(Bound::Vendor, 0xFB), "46FB000000000000"),
            (identify(Bound::Product, VALUE), "4701020304000000"),
            (identify(Bound::RevisionLow, 1), "4801000000000000"),
            (identify(Bound::RevisionHigh, 2), "4902000000000000"),
            (identify(Bound::SerialLow, 3), "4A03000000000000"),
            (identify(Bound::SerialHigh, VALUE), "4B01020304000000"),
            (Request::IdentifyUnconfigured, "4C00000000000000"),
            (Request::Fastscan(Fastscan { number: VALUE, bit: 31, sub: 2, next: 3 }), "51010203041F0203"),
            (Request::Fastscan(Fastscan { number: 0, bit: FASTSCAN_RESET, sub: 0, next: 0 }), "5100000000800000"),
        ];
        for (request, bytes) in table {
            let text = format!("7E5#{bytes}");
            assert_eq!(request.encode().to_string(), text);
            assert_eq!(Request::decode(&parse(&text)), Some(request));
        }
    }

    #[test]
    fn responses_are_these_bytes() {
        let outcome = |error, specific| Outcome { error, specific };
        let inquired = |part, value| Response::Inquired { part, value };
        let table = [
            (Response::Selected, "4400000000000000"),
            (Response::NodeIdConfigured(outcome(Outcome::SUCCESS, 0)), "1100000000000000"),
            (Response::NodeIdConfigured(outcome(Outcome::OUT_OF_RANGE, 0)), "1101000000000000"),
            (Response::BitTimingConfigured(outcome(Outcome::VENDOR, 7)), "13FF070000000000"),
            (Response::Stored(outcome(Outcome::STORAGE, 0)), "1702000000000000"),
            (inquired(Part::Vendor, 0xFB), "5AFB000000000000"),
            (inquired(Part::Product, VALUE), "5B01020304000000"),
            (inquired(Part::Revision, VALUE), "5C01020304000000"),
            (inquired(Part::Serial, u32::MAX), "5DFFFFFFFF000000"),
            (Response::NodeId { node_id: 0xFF }, "5EFF000000000000"),
            (Response::NodeId { node_id: 5 }, "5E05000000000000"),
            (Response::Identified, "4F00000000000000"),
            (Response::Unconfigured, "5000000000000000"),
        ];
        for (response, bytes) in table {
            let text = format!("7E4#{bytes}");
            assert_eq!(response.encode().to_string(), text);
            assert_eq!(Response::decode(&parse(&text)), Some(response));
        }
    }

    #[test]
    fn other_services_modes_lengths_and_identifiers_are_refused() {
        let table = [
            "7E5#0402000000000000",
            "7E5#0000000000000000",
            "7E5#4400000000000000",
            "7E5#4F00000000000000",
            "7E5#5F00000000000000",
            "7E5#04010000000000",
            "7E5#",
            "7E4#0401000000000000",
            "605#0401000000000000",
        ];
        for text in table {
            assert_eq!(Request::decode(&parse(text)), None, "{text}");
        }
        let table = ["7E4#4000000000000000", "7E4#5100000000000000", "7E4#4F000000000000", "7E5#4F00000000000000"];
        for text in table {
            assert_eq!(Response::decode(&parse(text)), None, "{text}");
        }
    }

    #[test]
    fn bit_rates_have_the_indices_of_the_table() {
        let rates = [1000, 800, 500, 250, 125, 0, 50, 20, 10].map(BitRate::Kbps);
        for (rate, index) in rates.into_iter().chain([BitRate::Automatic]).zip(0..) {
            let expected = Some(rate).filter(|_| index != 5);
            assert_eq!(BitRate::from_index(index), expected);
        }
        for index in [10, 255] {
            assert_eq!(BitRate::from_index(index), None);
        }
    }
}
