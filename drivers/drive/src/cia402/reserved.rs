//! Objects of a drive that belong to the driver. Neither a cell nor a device configuration file may write them.
//!
//! Bring-up writes some of these objects itself. Writing the other objects would undo a part of bring-up, or would
//! command the drive. The rest of the dictionary is free for tuning: controller gains, limits of torque, current, speed
//! and position, position windows, inputs and outputs, motor data. A wrong limit makes an axis weak or slow, but the
//! drive still brakes by the quick stop. A cell may write scale and rated torque, which bring-up then compares with the
//! cell (`agreement`).
//!
//! Vendor-specific objects are known for maxon only.

use std::fmt;
use std::ops::RangeInclusive;

use canopen::Object;

use super::program::MAXON;

pub(super) const SILENCE: &str = "it decides whether the drive stops when its host falls silent";
pub(super) const BRAKING: &str = "it decides how the drive brakes";
pub(super) const DELAY: &str = "it would delay the fault of a following error";
pub(super) const SENSE: &str = "the cell's reversed sets the sense of rotation";
const COMMAND: &str = "it commands the drive";
const HOMING: &str = "the cell's homing sets it";
const REFERENCE: &str = "the homed counter must read zero at the reference";
const RANGE: &str = "a position counter that wraps would leave the cell's limits";
const OFFSET: &str = "it would be added to every set-point";
const UNIT: &str = "set-points and ramps are sent in the units of the profile";
const COMMUNICATION: &str = "the driver sets how the node communicates";
const SYNC: &str = "the host sends SYNC, without a counter, under identifier 0x080";
const TIME: &str = "no drive may send TIME, nor under the identifier of another frame";
const EMCY: &str = "the host reads EMCY under identifier 0x080 + node-ID";
const OUTPUTS: &str = "it commands outputs, and the brake of the drive by bit 0";
const STORE: &str = "it would store or restore the drive's parameters at every start";
const IDENTITY: &str = "it would take the node off its bus or rename it";

/// Reasons by index, for all sub-indices. The first range that contains an index applies.
const RESERVED: &[(RangeInclusive<u16>, &str)] = &[
    (0x1005..=0x1007, SYNC),
    (0x1010..=0x1011, STORE),
    (0x1012..=0x1012, TIME),
    (0x1014..=0x1014, EMCY),
    (0x1016..=0x1016, SILENCE),
    (0x1017..=0x1017, "the cell's heartbeat_ms sets it"),
    (0x1019..=0x1019, SYNC),
    (0x1029..=0x1029, SILENCE),
    (0x1400..=0x1BFF, "the driver maps the process data"),
    (0x1000..=0x1FFF, COMMUNICATION),
    (0x6007..=0x6007, SILENCE),
    (0x6040..=0x6040, COMMAND),
    (0x6042..=0x6042, COMMAND),
    (0x605A..=0x605E, BRAKING),
    (0x6060..=0x6060, "the cell's control sets it"),
    (0x6065..=0x6065, "the cell's following_error sets it"),
    (0x6066..=0x6066, DELAY),
    (0x6071..=0x6071, COMMAND),
    (0x607A..=0x607A, COMMAND),
    (0x607B..=0x607B, RANGE),
    (0x607C..=0x607C, REFERENCE),
    (0x607E..=0x607E, SENSE),
    (0x6084..=0x6084, BRAKING),
    (0x6085..=0x6085, "the cell's max_acceleration sets it"),
    (0x6086..=0x6086, BRAKING),
    (0x6089..=0x608E, UNIT),
    (0x6090..=0x6090, UNIT),
    (0x6093..=0x6097, UNIT),
    (0x6098..=0x609A, HOMING),
    (0x60A3..=0x60A4, BRAKING),
    (0x60A8..=0x60AA, UNIT),
    (0x60B0..=0x60B2, OFFSET),
    (0x60C1..=0x60C1, COMMAND),
    (0x60C2..=0x60C2, "the cell's period_us sets it"),
    (0x60C5..=0x60C6, BRAKING),
    (0x60FE..=0x60FE, OUTPUTS),
    (0x60FF..=0x60FF, COMMAND),
];

/// Objects of the communication area that are for tuning: the error history, which a write clears, the high resolution
/// time stamp, the inhibit time of EMCY, and the note of a configuration's date.
const FREE: [u16; 4] = [0x1003, 0x1013, 0x1015, 0x1020];

/// Reserved objects of maxon drives: node-ID and bit rate, home position and home offset.
const OF_MAXON: &[(RangeInclusive<u16>, &str)] = &[(0x2000..=0x2001, IDENTITY), (0x30B0..=0x30B1, REFERENCE)];

/// Axis configuration of maxon drives, whose bit 0 is the polarity. The rest of its record is free.
const AXIS_CONFIGURATION_OF_MAXON: Object = Object::new(0x3000, 4);

/// An object that belongs to the driver, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reserved {
    /// The object.
    pub object: Object,
    /// Reason why a cell or a device configuration file must not write the object.
    pub why: &'static str,
}

/// Formatted as `0x6007:00 (abort connection option code) belongs to the driver: it decides …`.
impl fmt::Display for Reserved {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ", self.object)?;
        if let Some(name) = self.object.name() {
            write!(f, "({name}) ")?;
        }
        write!(f, "belongs to the driver: {}", self.why)
    }
}

/// The reservation of an object of a drive of `vendor`. `None` if a cell or a device configuration file may write the
/// object.
pub fn reserved(vendor: u32, index: u16, subindex: u8) -> Option<Reserved> {
    let canonical = match index {
        // Further axes behind one node-ID have the same objects at indices 0x800 higher for each axis (CiA 402-2).
        0x6000..=0x9FFF => 0x6000 + (index - 0x6000) % 0x800,
        _ => index,
    };
    if FREE.contains(&canonical) {
        return None;
    }
    let object = Object::new(index, subindex);
    let of_vendor = if vendor == MAXON { OF_MAXON } else { &[] };
    let mut rules = RESERVED.iter().chain(of_vendor);
    let rule = rules.find(|(range, _)| range.contains(&canonical));
    let polarity = vendor == MAXON && object == AXIS_CONFIGURATION_OF_MAXON;
    let why = rule.map(|(_, why)| *why).or(polarity.then_some(SENSE))?;
    Some(Reserved { object, why })
}

/// The reservation of an object of a drive of an unknown vendor: the reservation by any vendor.
pub fn reserved_by_any(index: u16, subindex: u8) -> Option<Reserved> {
    reserved(MAXON, index, subindex)
}
