//! Rows of an object dictionary: every object, its type, access, default, limits and mapping.

use canopen::Object;
use canopen::eds::DataType::{
    self, Integer8 as I8, Integer16 as I16, Integer32 as I32, Unsigned8 as U8, Unsigned16 as U16, Unsigned32 as U32,
    VisibleString,
};
use canopen::pdo::PdoKind;

/// Mapping entries per PDO, as in an EPOS4.
pub(crate) const MAPPED: u8 = 12;

/// Rows of four RPDOs, and of four TPDOs: communication parameters, then a count and the entries of a mapping.
pub(crate) const RPDO_ROWS: usize = 4 * (4 + 1 + MAPPED as usize);
pub(crate) const TPDO_ROWS: usize = 4 * (5 + 1 + MAPPED as usize);

#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    pub(crate) object: Object,
    pub(crate) data_type: DataType,
    /// Whether the host can write the value. The device may change any value.
    pub(crate) writable: bool,
    /// Default, in stored form; of a VISIBLE_STRING the text.
    pub(crate) default: u32,
    pub(crate) text: &'static str,
    /// Whether the node-ID is added to the default.
    pub(crate) plus_node: bool,
    /// Whether the object can be mapped to RPDOs, and to TPDOs.
    pub(crate) receive: bool,
    pub(crate) transmit: bool,
    /// Commands, set-points and the error history, which "save" and downloads of the data sheet leave out.
    pub(crate) volatile: bool,
    pub(crate) min: i64,
    pub(crate) max: i64,
    /// Check of a value within the limits; `None` accepts every value.
    accepts: Option<fn(u32) -> bool>,
    /// Second address of the same object.
    pub(crate) alias: Option<Object>,
    /// Marks that a write sets in [`Changes`](super::objects::Changes). The application defines the bits.
    pub(crate) marks: u8,
    /// Whether the application counts the events of the object. A TPDO is otherwise triggered by a changed value.
    pub(crate) counts_events: bool,
}

impl Entry {
    /// Bytes of the object; 0 for the one object of type DOMAIN.
    pub(crate) fn size(&self) -> usize {
        self.data_type.size().unwrap_or(self.text.len())
    }

    fn is_signed(&self) -> bool {
        matches!(self.data_type, I8 | I16 | I32)
    }

    /// Converts the bytes of a number on the wire to the stored value (sign extended).
    pub(crate) fn decode(&self, bytes: [u8; 4]) -> u32 {
        let unused = 32 - 8 * self.data_type.size().unwrap_or(4);
        let value = u32::from_le_bytes(bytes) << unused;
        if self.is_signed() { (value as i32 >> unused) as u32 } else { value >> unused }
    }

    /// The number that a stored value represents.
    pub(crate) fn number(&self, stored: u32) -> i64 {
        if self.is_signed() { i64::from(stored as i32) } else { i64::from(stored) }
    }

    pub(crate) fn allows(&self, stored: u32) -> bool {
        (self.min..=self.max).contains(&self.number(stored)) && self.accepts.is_none_or(|accepts| accepts(stored))
    }

    pub(crate) const fn range(mut self, min: i64, max: i64) -> Self {
        self.min = min;
        self.max = max;
        self
    }

    pub(crate) const fn only(mut self, accepts: fn(u32) -> bool) -> Self {
        self.accepts = Some(accepts);
        self
    }

    pub(crate) const fn alias(mut self, index: u16, subindex: u8) -> Self {
        self.alias = Some(Object::new(index, subindex));
        self
    }

    pub(crate) const fn marks(mut self, marks: u8) -> Self {
        self.marks = marks;
        self
    }

    pub(crate) const fn counts_events(mut self) -> Self {
        self.counts_events = true;
        self
    }

    pub(crate) const fn volatile(mut self) -> Self {
        self.volatile = true;
        self
    }

    pub(crate) const fn plus_node(mut self) -> Self {
        self.plus_node = true;
        self
    }

    pub(crate) const fn tx(mut self) -> Self {
        self.transmit = true;
        self
    }

    pub(crate) const fn rx(mut self) -> Self {
        self.receive = true;
        self
    }
}

pub(crate) const fn ro(index: u16, subindex: u8, data_type: DataType, default: i64) -> Entry {
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
        accepts: None,
        alias: None,
        marks: 0,
        counts_events: false,
    }
}

pub(crate) const fn text(index: u16, subindex: u8, text: &'static str) -> Entry {
    Entry { text, ..ro(index, subindex, VisibleString, 0) }
}

pub(crate) const fn rw(index: u16, subindex: u8, data_type: DataType, default: i64) -> Entry {
    Entry { writable: true, ..ro(index, subindex, data_type, default) }
}

/// The error history (0x1003) is cleared by 0 and takes no other value.
fn is_zero(value: u32) -> bool {
    value == 0
}

pub(crate) const STATUS_ROWS: usize = 9;

/// Objects 0x1000 to 0x1005 of every node.
pub(crate) const fn status_rows(device_type: u32) -> [Entry; STATUS_ROWS] {
    [
        ro(0x1000, 0, U32, device_type as i64),
        ro(0x1001, 0, U8, 0).tx(),
        rw(0x1003, 0, U8, 0).volatile().only(is_zero),
        ro(0x1003, 1, U32, 0),
        ro(0x1003, 2, U32, 0),
        ro(0x1003, 3, U32, 0),
        ro(0x1003, 4, U32, 0),
        ro(0x1003, 5, U32, 0),
        ro(0x1005, 0, U32, 0x80),
    ]
}

/// Objects 0x1010 to 0x1200 of every node.
pub(crate) const COMMUNICATION: &[Entry] = &[
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

/// [`RPDO_ROWS`] or [`TPDO_ROWS`] rows of four PDOs. COB-IDs are without the node-ID; the inhibit time of TPDOs counts
/// 100 µs; a mapping entry is index << 16 | sub-index << 8 | bits.
pub(crate) const fn pdo_rows<const ROWS: usize>(
    kind: PdoKind,
    cob: [u32; 4],
    inhibit: u16,
    mapping: [&[u32]; 4],
) -> [Entry; ROWS] {
    let transmit = matches!(kind, PdoKind::Tpdo);
    let base = if transmit { 0x1800 } else { 0x1400 };
    let mut rows = [ro(0, 0, U8, 0); ROWS];
    let mut at = 0;
    let mut n = 0;
    while n < 4 {
        let index = base + n as u16;
        rows[at] = ro(index, 0, U8, 5);
        rows[at + 1] = rw(index, 1, U32, cob[n] as i64).plus_node();
        rows[at + 2] = rw(index, 2, U8, 255);
        at += 3;
        if transmit {
            rows[at] = rw(index, 3, U16, inhibit as i64);
            at += 1;
        }
        rows[at] = rw(index, 5, U16, 0);
        at += 1;
        n += 1;
    }
    n = 0;
    while n < 4 {
        let index = base + 0x200 + n as u16;
        rows[at] = rw(index, 0, U8, mapping[n].len() as i64).range(0, MAPPED as i64);
        at += 1;
        let mut sub = 0;
        while sub < MAPPED as usize {
            let default = if sub < mapping[n].len() { mapping[n][sub] } else { 0 };
            rows[at] = rw(index, sub as u8 + 1, U32, default as i64);
            at += 1;
            sub += 1;
        }
        n += 1;
    }
    rows
}

/// The rows of all parts in their order. `ROWS` is the sum of their lengths.
pub(crate) const fn joined<const ROWS: usize>(parts: &[&[Entry]]) -> [Entry; ROWS] {
    let mut table = [ro(0, 0, U8, 0); ROWS];
    let (mut at, mut part) = (0, 0);
    while part < parts.len() {
        let mut row = 0;
        while row < parts[part].len() {
            table[at] = parts[part][row];
            at += 1;
            row += 1;
        }
        part += 1;
    }
    table
}

/// The row of an object in its table, which ascends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Slot(u16);

impl Slot {
    /// The slot of an object known at compile time. An object missing from the table does not compile.
    pub(crate) const fn of(table: &[Entry], object: Object) -> Self {
        let mut at = 0;
        while at < table.len() {
            let entry = table[at].object;
            if entry.index == object.index && entry.subindex == object.subindex {
                return Self(at as u16);
            }
            at += 1;
        }
        panic!("the table has no such object")
    }

    /// The slot of an object received in a frame.
    pub(crate) fn find(table: &[Entry], object: Object) -> Option<Self> {
        let at = table.binary_search_by_key(&object, |entry| entry.object).ok()?;
        Some(Self(at as u16))
    }

    /// The slot `by` rows further down.
    pub(crate) const fn plus(self, by: u16) -> Self {
        Self(self.0 + by)
    }

    pub(crate) const fn row(self) -> usize {
        self.0 as usize
    }
}
