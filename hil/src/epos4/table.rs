//! The object dictionary as a table: every object, its type, access, default, limits and mapping.
//!
//! Addresses, types and defaults are from the known part of the electronic data sheet of the EPOS4 module 50/5
//! (firmware 0x0170). Limits set by [`Entry::range`] are from EPOS4 or CiA.

use canopen::Object;
use canopen::cia402::{HomingMethod, ModeOfOperation, SupportedModes};
use canopen::eds::DataType::{
    Domain, Integer8 as I8, Integer16 as I16, Integer32 as I32, Unsigned8 as U8, Unsigned16 as U16, Unsigned32 as U32,
};
use canopen::pdo::PdoKind;

use crate::node::table::{
    COMMUNICATION, Entry, RPDO_ROWS, STATUS_ROWS, Slot, TPDO_ROWS, joined, pdo_rows, ro, rw, status_rows, text,
};

/// Marks of writes that the drive applies: controlword, mode of operation, set-point of a cyclic mode.
pub(super) const CONTROL: u8 = 1;
pub(super) const MODE: u8 = 1 << 1;
pub(super) const SETPOINT: u8 = 1 << 2;

fn supported(mode: u32) -> bool {
    SupportedModes::EPOS4.contains(ModeOfOperation::from_raw(mode as i32 as i8))
}

fn homing_method(value: u32) -> bool {
    HomingMethod::EPOS4.contains(&HomingMethod(value as i32 as i8))
}

/// Revolutions per minute, from 1 down to 1e-6.
fn velocity_unit(value: u32) -> bool {
    value & 0x00FF_FFFF == 0x00B4_4700 && (-6..=0).contains(&((value >> 24) as u8 as i8))
}

/// Vendor objects, and objects of CiA 402.
const APPLICATION: &[Entry] = &[
    ro(0x2200, 0, U8, 1),
    ro(0x2200, 1, U16, 480).tx(),
    // Not an object of EPOS4: a long object for tests of transfers.
    ro(0x2FF0, 0, U8, 2),
    text(0x2FF0, 1, "a record of the emulator, which no EPOS4 has: sub-index 2 takes any bytes"),
    rw(0x2FF0, 2, Domain, 0),
    ro(0x3000, 0, U8, 5),
    ro(0x3000, 5, U32, 0),
    ro(0x3001, 0, U8, 5),
    rw(0x3001, 1, U32, 5_000),
    rw(0x3001, 2, U32, 10_000),
    rw(0x3001, 5, U32, 50_000),
    rw(0x30B0, 0, I32, 0),
    rw(0x30B1, 0, I32, 0).alias(0x607C, 0),
    rw(0x30B2, 0, U16, 1_000),
    ro(0x30D1, 0, U8, 2),
    ro(0x30D1, 1, I32, 0).tx(),
    ro(0x30D1, 2, I32, 0).tx(),
    ro(0x30E0, 0, U8, 3),
    rw(0x30E0, 1, U32, 30),
    rw(0x30E0, 2, U16, 2),
    rw(0x30E0, 3, U16, 1_000),
    ro(0x3141, 0, U8, 1),
    ro(0x3141, 1, U16, 0).tx(),
    rw(0x6007, 0, I16, 3).range(0, 3),
    ro(0x603F, 0, U16, 0).tx(),
    rw(0x6040, 0, U16, 0).rx().tx().volatile().marks(CONTROL),
    ro(0x6041, 0, U16, 0).tx(),
    rw(0x605A, 0, I16, 6).range(0, 8),
    rw(0x605B, 0, I16, 0).range(0, 1),
    rw(0x605C, 0, I16, 1).range(0, 1),
    rw(0x605D, 0, I16, 1).range(1, 2),
    rw(0x605E, 0, I16, 2).range(0, 2),
    rw(0x6060, 0, I8, 1).rx().tx().only(supported).marks(MODE),
    ro(0x6061, 0, I8, 0).tx(),
    ro(0x6062, 0, I32, 0).tx(),
    ro(0x6064, 0, I32, 0).tx(),
    rw(0x6065, 0, U32, 2_000),
    ro(0x6066, 0, U16, 0),
    rw(0x6067, 0, U32, 0xFFFF_FFFF),
    rw(0x6068, 0, U16, 0),
    ro(0x606B, 0, I32, 0).tx(),
    ro(0x606C, 0, I32, 0).tx(),
    rw(0x6071, 0, I16, 0).rx().tx().volatile().marks(SETPOINT),
    ro(0x6076, 0, U32, 0),
    ro(0x6077, 0, I16, 0).tx(),
    rw(0x607A, 0, I32, 0).rx().tx().volatile().marks(SETPOINT),
    rw(0x607C, 0, I32, 0).alias(0x30B1, 0),
    ro(0x607D, 0, U8, 2),
    rw(0x607D, 1, I32, 0),
    rw(0x607D, 2, I32, 0),
    rw(0x607F, 0, U32, 50_000),
    rw(0x6080, 0, U32, 50_000),
    rw(0x6081, 0, U32, 1_000).rx(),
    rw(0x6083, 0, U32, 10_000).rx(),
    rw(0x6084, 0, U32, 10_000).rx(),
    rw(0x6085, 0, U32, 10_000),
    rw(0x6086, 0, I16, 0).range(0, 0),
    rw(0x6098, 0, I8, 7).only(homing_method),
    ro(0x6099, 0, U8, 2),
    rw(0x6099, 1, U32, 100),
    rw(0x6099, 2, U32, 10),
    rw(0x609A, 0, U32, 1_000),
    ro(0x60A8, 0, U32, 0x00B5_0000),
    rw(0x60A9, 0, U32, 0x00B4_4700).only(velocity_unit),
    ro(0x60AA, 0, U32, 0x00C0_0300),
    rw(0x60B0, 0, I32, 0).rx().tx().volatile(),
    rw(0x60B1, 0, I32, 0).rx().tx().volatile(),
    rw(0x60B2, 0, I16, 0).rx().tx().volatile(),
    ro(0x60C2, 0, U8, 2),
    rw(0x60C2, 1, U8, 0).range(0, 100),
    rw(0x60C2, 2, I8, -3).range(-4, 0),
    rw(0x60C5, 0, U32, 0xFFFF_FFFF),
    ro(0x60F4, 0, I32, 0).tx(),
    ro(0x60FD, 0, U32, 0).tx(),
    ro(0x60FE, 0, U8, 2),
    rw(0x60FE, 1, U32, 0).rx().volatile(),
    rw(0x60FE, 2, U32, 0),
    rw(0x60FF, 0, I32, 0).rx().tx().volatile().marks(SETPOINT),
    ro(0x6502, 0, U32, 0x0000_03A5),
];

/// Default mappings, as index << 16 | sub-index << 8 | bits, by PDO.
const RECEIVED: [&[u32]; 4] =
    [&[0x6040_0010], &[0x6040_0010, 0x6060_0008], &[0x6040_0010, 0x607A_0020], &[0x6040_0010, 0x60FF_0020]];
const TRANSMITTED: [&[u32]; 4] =
    [&[0x6041_0010], &[0x6041_0010, 0x6061_0008], &[0x6041_0010, 0x6064_0020], &[0x6041_0010, 0x606C_0020]];
/// COB-IDs before the node-ID is added: only the first of each kind exists (bit 31 clear).
const RECEIVED_COB: [u32; 4] = [0x0000_0200, 0x8000_0300, 0x8000_0400, 0x8000_0500];
const TRANSMITTED_COB: [u32; 4] = [0x4000_0180, 0xC000_0280, 0xC000_0380, 0xC000_0480];

const ROWS: usize = STATUS_ROWS + 1 + COMMUNICATION.len() + RPDO_ROWS + TPDO_ROWS + APPLICATION.len();

/// The dictionary, in ascending order.
pub(super) static TABLE: [Entry; ROWS] = {
    let status = status_rows(0x0002_0192);
    let name = [text(0x1008, 0, "EPOS4")];
    let received = pdo_rows::<RPDO_ROWS>(PdoKind::Rpdo, RECEIVED_COB, 0, RECEIVED);
    // The inhibit time is 1 ms.
    let transmitted = pdo_rows::<TPDO_ROWS>(PdoKind::Tpdo, TRANSMITTED_COB, 10, TRANSMITTED);
    joined(&[&status, &name, COMMUNICATION, &received, &transmitted, APPLICATION])
};

/// The slot of an object of [`canopen::objects`], found at compile time.
macro_rules! slot {
    ($name:ident) => {
        const { $crate::epos4::table::slot_of(canopen::objects::$name) }
    };
}
pub(super) use slot;

/// The slot of an object known at compile time. An object missing from the table does not compile.
pub(super) const fn slot_of(object: Object) -> Slot {
    Slot::of(&TABLE, object)
}
