//! The object dictionary as a table: every object, its type, access, default, limits and mapping.
//!
//! Addresses, types and defaults are those of the EPOS4 module 50/5 (firmware 0x0170), as far as its electronic data
//! sheet is known. Limits set by [`Entry::range`] are from EPOS4 or CiA.

use canopen::Object;
use canopen::eds::DataType::{
    self, Domain, Integer8 as I8, Integer16 as I16, Integer32 as I32, Unsigned8 as U8, Unsigned16 as U16,
    Unsigned32 as U32, VisibleString,
};

/// Mapping entries per PDO, as in an EPOS4.
pub(super) const MAPPED: u8 = 12;

#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) object: Object,
    pub(super) data_type: DataType,
    /// Whether the host can write the value. The device may change any value.
    pub(super) writable: bool,
    /// Default, in stored form; of a VISIBLE_STRING the text.
    pub(super) default: u32,
    pub(super) text: &'static str,
    /// Whether the node-ID is added to the default.
    pub(super) plus_node: bool,
    /// Whether the object can be mapped to RPDOs, and to TPDOs.
    pub(super) receive: bool,
    pub(super) transmit: bool,
    /// Commands, set-points and the error history, which "save" and downloads of the data sheet leave out.
    pub(super) volatile: bool,
    pub(super) min: i64,
    pub(super) max: i64,
}

impl Entry {
    /// Bytes of the object; 0 for the one object of type DOMAIN.
    pub(super) fn size(&self) -> usize {
        self.data_type.size().unwrap_or(self.text.len())
    }

    fn is_signed(&self) -> bool {
        matches!(self.data_type, I8 | I16 | I32)
    }

    /// Converts the bytes of a number on the wire to the stored value (sign extended).
    pub(super) fn decode(&self, bytes: [u8; 4]) -> u32 {
        let unused = 32 - 8 * self.data_type.size().unwrap_or(4);
        let value = u32::from_le_bytes(bytes) << unused;
        if self.is_signed() { (value as i32 >> unused) as u32 } else { value >> unused }
    }

    /// The number that a stored value represents.
    pub(super) fn number(&self, stored: u32) -> i64 {
        if self.is_signed() { i64::from(stored as i32) } else { i64::from(stored) }
    }

    pub(super) fn allows(&self, stored: u32) -> bool {
        (self.min..=self.max).contains(&self.number(stored))
    }

    const fn range(mut self, min: i64, max: i64) -> Self {
        self.min = min;
        self.max = max;
        self
    }

    const fn volatile(mut self) -> Self {
        self.volatile = true;
        self
    }

    const fn plus_node(mut self) -> Self {
        self.plus_node = true;
        self
    }

    const fn tx(mut self) -> Self {
        self.transmit = true;
        self
    }

    const fn rx(mut self) -> Self {
        self.receive = true;
        self
    }
}

const fn ro(index: u16, subindex: u8, data_type: DataType, default: i64) -> Entry {
    Entry {
        object: Object::new(index, subindex),
        data_type,
        writable: false,
        default: default as u32,
        text: "",
        plus_node: false,
        receive: false,
        transmit: false,
        volatile: false,
        min: i64::MIN,
        max: i64::MAX,
    }
}

const fn text(index: u16, subindex: u8, text: &'static str) -> Entry {
    Entry { text, ..ro(index, subindex, VisibleString, 0) }
}

const fn rw(index: u16, subindex: u8, data_type: DataType, default: i64) -> Entry {
    Entry { writable: true, ..ro(index, subindex, data_type, default) }
}

/// Communication objects below the PDO parameters.
const COMMUNICATION: &[Entry] = &[
    ro(0x1000, 0, U32, 0x0002_0192),
    ro(0x1001, 0, U8, 0).tx(),
    rw(0x1003, 0, U8, 0).volatile(),
    ro(0x1003, 1, U32, 0),
    ro(0x1003, 2, U32, 0),
    ro(0x1003, 3, U32, 0),
    ro(0x1003, 4, U32, 0),
    ro(0x1003, 5, U32, 0),
    ro(0x1005, 0, U32, 0x80),
    text(0x1008, 0, "EPOS4"),
    ro(0x1010, 0, U8, 1),
    rw(0x1010, 1, U32, 1).volatile(),
    ro(0x1011, 0, U8, 1),
    rw(0x1011, 1, U32, 1).volatile(),
    ro(0x1014, 0, U32, 0x80).plus_node(),
    ro(0x1016, 0, U8, 2),
    rw(0x1016, 1, U32, 0).range(0, 0xFF_FFFF),
    rw(0x1016, 2, U32, 0).range(0, 0xFF_FFFF),
    rw(0x1017, 0, U16, 0),
    ro(0x1018, 0, U8, 4),
    ro(0x1018, 1, U32, 0),
    ro(0x1018, 2, U32, 0),
    ro(0x1018, 3, U32, 0),
    ro(0x1018, 4, U32, 0),
    ro(0x1029, 0, U8, 1),
    rw(0x1029, 1, U8, 0).range(0, 2),
    ro(0x1200, 0, U8, 2),
    ro(0x1200, 1, U32, 0x600).plus_node(),
    ro(0x1200, 2, U32, 0x580).plus_node(),
];

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
    rw(0x30B1, 0, I32, 0),
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
    rw(0x6040, 0, U16, 0).rx().tx().volatile(),
    ro(0x6041, 0, U16, 0).tx(),
    rw(0x605A, 0, I16, 6).range(0, 8),
    rw(0x605B, 0, I16, 0).range(0, 1),
    rw(0x605C, 0, I16, 1).range(0, 1),
    rw(0x605D, 0, I16, 1).range(1, 2),
    rw(0x605E, 0, I16, 2).range(0, 2),
    rw(0x6060, 0, I8, 1).rx().tx(),
    ro(0x6061, 0, I8, 0).tx(),
    ro(0x6062, 0, I32, 0).tx(),
    ro(0x6064, 0, I32, 0).tx(),
    rw(0x6065, 0, U32, 2_000),
    ro(0x6066, 0, U16, 0),
    rw(0x6067, 0, U32, 0xFFFF_FFFF),
    rw(0x6068, 0, U16, 0),
    ro(0x606B, 0, I32, 0).tx(),
    ro(0x606C, 0, I32, 0).tx(),
    rw(0x6071, 0, I16, 0).rx().tx().volatile(),
    ro(0x6076, 0, U32, 0),
    ro(0x6077, 0, I16, 0).tx(),
    rw(0x607A, 0, I32, 0).rx().tx().volatile(),
    rw(0x607C, 0, I32, 0),
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
    rw(0x6098, 0, I8, 7),
    ro(0x6099, 0, U8, 2),
    rw(0x6099, 1, U32, 100),
    rw(0x6099, 2, U32, 10),
    rw(0x609A, 0, U32, 1_000),
    ro(0x60A8, 0, U32, 0x00B5_0000),
    rw(0x60A9, 0, U32, 0x00B4_4700),
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
    rw(0x60FF, 0, I32, 0).rx().tx().volatile(),
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

/// Rows of four PDOs each way: communication parameters, then a count and the entries of a mapping.
const PDO_ROWS: usize = 4 * (4 + 1 + MAPPED as usize) + 4 * (5 + 1 + MAPPED as usize);
pub(super) const ROWS: usize = COMMUNICATION.len() + PDO_ROWS + APPLICATION.len();

/// The dictionary, in ascending order.
pub(super) static TABLE: [Entry; ROWS] = {
    let mut table = [ro(0, 0, U8, 0); ROWS];
    let mut at = 0;
    while at < COMMUNICATION.len() {
        table[at] = COMMUNICATION[at];
        at += 1;
    }
    (table, at) = with_pdos(table, at, 0x1400, RECEIVED_COB, RECEIVED);
    (table, at) = with_pdos(table, at, 0x1800, TRANSMITTED_COB, TRANSMITTED);
    let mut row = 0;
    while row < APPLICATION.len() {
        table[at] = APPLICATION[row];
        at += 1;
        row += 1;
    }
    table
};

const fn with_pdos(
    mut table: [Entry; ROWS],
    mut at: usize,
    base: u16,
    cob: [u32; 4],
    mapping: [&[u32]; 4],
) -> ([Entry; ROWS], usize) {
    let transmit = base == 0x1800;
    let mut n = 0;
    while n < 4 {
        let index = base + n as u16;
        table[at] = ro(index, 0, U8, 5);
        table[at + 1] = rw(index, 1, U32, cob[n] as i64).plus_node();
        table[at + 2] = rw(index, 2, U8, 255);
        at += 3;
        if transmit {
            // 10 · 100 µs.
            table[at] = rw(index, 3, U16, 10);
            at += 1;
        }
        table[at] = rw(index, 5, U16, 0);
        at += 1;
        n += 1;
    }
    n = 0;
    while n < 4 {
        let index = base + 0x200 + n as u16;
        table[at] = rw(index, 0, U8, mapping[n].len() as i64).range(0, MAPPED as i64);
        at += 1;
        let mut sub = 0;
        while sub < MAPPED as usize {
            let default = if sub < mapping[n].len() { mapping[n][sub] } else { 0 };
            table[at] = rw(index, sub as u8 + 1, U32, default as i64);
            at += 1;
            sub += 1;
        }
        n += 1;
    }
    (table, at)
}

/// The slot of an object of [`canopen::objects`], found at compile time.
macro_rules! slot {
    ($name:ident) => {
        const { $crate::epos4::table::Slot::of(canopen::objects::$name) }
    };
}
pub(super) use slot;

/// The row of an object in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Slot(u16);

impl Slot {
    /// The slot of an object known at compile time. An object missing from the table does not compile.
    pub(super) const fn of(object: Object) -> Self {
        let mut at = 0;
        while at < ROWS {
            let entry = TABLE[at].object;
            if entry.index == object.index && entry.subindex == object.subindex {
                return Self(at as u16);
            }
            at += 1;
        }
        panic!("the table has no such object")
    }

    /// The slot of an object received in a frame.
    pub(super) fn find(object: Object) -> Option<Self> {
        let at = TABLE.binary_search_by_key(&object, |entry| entry.object).ok()?;
        Some(Self(at as u16))
    }

    /// The slot `by` rows further down.
    pub(super) const fn plus(self, by: u16) -> Self {
        assert!((self.0 + by) < ROWS as u16);
        Self(self.0 + by)
    }

    pub(super) const fn row(self) -> usize {
        self.0 as usize
    }

    pub(super) fn entry(self) -> &'static Entry {
        &TABLE[self.row()]
    }
}
