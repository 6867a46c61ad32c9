//! Parameters of PDOs (CiA 301 §7.5.2.35 to §7.5.2.38): COB-ID, transmission type, and mapping.
//!
//! Every mapped object has whole bytes here, so that a mapping has at most eight entries.

use can::StandardId;
use thiserror::Error;

use crate::Object;

/// One of the four PDOs of the predefined connection set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum PdoNumber {
    /// PDO 1.
    One,
    /// PDO 2.
    Two,
    /// PDO 3.
    Three,
    /// PDO 4.
    Four,
}

impl PdoNumber {
    /// In ascending order.
    pub const ALL: [Self; 4] = [Self::One, Self::Two, Self::Three, Self::Four];

    /// 0 ..= 3: the offset of the PDO in object indices.
    pub const fn offset(self) -> u16 {
        self as u16
    }
}

/// The direction of a PDO, in the device's view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PdoKind {
    /// The device receives it.
    Rpdo,
    /// The device transmits it.
    Tpdo,
}

impl PdoKind {
    /// Sub-index `subindex` of the communication parameter: 1 COB-ID, 2 transmission type,
    /// 3 inhibit time (100 µs), 5 event timer (ms).
    pub const fn communication(self, number: PdoNumber, subindex: u8) -> Object {
        let base = match self {
            Self::Rpdo => 0x1400,
            Self::Tpdo => 0x1800,
        };
        Object::new(base + number.offset(), subindex)
    }

    /// Sub-index `subindex` of the mapping parameter: 0 count, then the entries.
    pub const fn mapping(self, number: PdoNumber, subindex: u8) -> Object {
        let communication = self.communication(number, 0);
        Object::new(communication.index + 0x200, subindex)
    }
}

/// Sub-index 1 of a communication parameter: the identifier and whether the PDO exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoCobId(pub u32);

impl PdoCobId {
    const INVALID: u32 = 1 << 31;
    const NO_RTR: u32 = 1 << 30;
    const EXTENDED: u32 = 1 << 29;

    /// A valid PDO under `id`, remote frames allowed.
    pub const fn new(id: StandardId) -> Self {
        Self(id.raw() as u32)
    }

    /// The same, switched off.
    pub const fn invalid(self) -> Self {
        Self(self.0 | Self::INVALID)
    }

    /// The same, not to be asked for by a remote frame.
    pub const fn without_rtr(self) -> Self {
        Self(self.0 | Self::NO_RTR)
    }

    /// Whether the PDO exists.
    pub const fn is_valid(self) -> bool {
        self.0 & Self::INVALID == 0
    }

    /// Whether the frame has an 11-bit identifier and bits 11 to 28 are zero (CiA 301 §7.5.2.35, §7.5.2.37).
    pub const fn is_standard(self) -> bool {
        self.0 & (Self::EXTENDED | 0x1FFF_F800) == 0
    }

    /// The identifier; `None` for a 29-bit one.
    pub const fn id(self) -> Option<StandardId> {
        if self.0 & Self::EXTENDED != 0 { None } else { StandardId::new((self.0 & 0x7FF) as u16) }
    }
}

/// Sub-index 2 of a communication parameter: when a PDO is sent or takes effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransmissionType(pub u8);

impl TransmissionType {
    /// At every SYNC.
    pub const EVERY_SYNC: Self = Self(1);
    /// On an event of the device profile's choice.
    pub const EVENT_PROFILE: Self = Self(255);

    /// Whether SYNC triggers the PDO: 0 ..= 240. An RPDO of each of these types takes effect at the next SYNC.
    pub const fn is_synchronous(self) -> bool {
        self.0 <= 240
    }

    /// n of a TPDO that is sent at every n-th SYNC.
    pub const fn cycle(self) -> Option<u8> {
        match self.0 {
            1..=240 => Some(self.0),
            _ => None,
        }
    }
}

/// One entry of a mapping parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The mapped object.
    pub object: Object,
    /// Its size in bits.
    pub bits: u8,
}

impl Entry {
    /// An object and its size in bits.
    pub const fn new(object: Object, bits: u8) -> Self {
        Self { object, bits }
    }

    /// The value in the mapping parameter: index, sub-index and size, from high to low bits.
    pub const fn raw(self) -> u32 {
        (self.object.index as u32) << 16 | (self.object.subindex as u32) << 8 | self.bits as u32
    }

    /// From the value in the mapping parameter.
    pub const fn from_raw(raw: u32) -> Self {
        Self { object: Object::new((raw >> 16) as u16, (raw >> 8) as u8), bits: raw as u8 }
    }
}

/// Reason that entries are no mapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum MappingError {
    #[error("{found} entries, at most 8 fit")]
    TooMany { found: usize },
    #[error("{object} takes {bits} bits, which are not whole bytes")]
    NotBytes { object: Object, bits: u8 },
    #[error("{bits} bits, at most 64 fit")]
    TooLong { bits: u32 },
}

/// What a PDO carries: up to 8 entries of whole bytes, 64 bits at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoMapping {
    entries: [Entry; 8],
    count: u8,
}

impl PdoMapping {
    /// Nothing mapped.
    pub const EMPTY: Self = Self { entries: [Entry::new(Object::new(0, 0), 0); 8], count: 0 };

    /// The entries in the order of the frame.
    pub fn new(entries: &[Entry]) -> Result<Self, MappingError> {
        let mut mapping = Self::EMPTY;
        mapping
            .entries
            .get_mut(..entries.len())
            .ok_or(MappingError::TooMany { found: entries.len() })?
            .copy_from_slice(entries);
        let odd = entries.iter().find(|entry| entry.bits == 0 || entry.bits % 8 != 0);
        if let Some(&Entry { object, bits }) = odd {
            return Err(MappingError::NotBytes { object, bits });
        }
        let bits = entries.iter().map(|entry| u32::from(entry.bits)).sum();
        if bits > 64 {
            return Err(MappingError::TooLong { bits });
        }
        mapping.count = entries.len() as u8;
        Ok(mapping)
    }

    /// The entries in the order of the frame.
    pub fn entries(&self) -> &[Entry] {
        &self.entries[..usize::from(self.count)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::*;

    #[test]
    fn parameters_lie_where_cia_301_puts_them() {
        let table = [
            (PdoKind::Rpdo.communication(PdoNumber::One, 1), 0x1400, 1),
            (PdoKind::Rpdo.mapping(PdoNumber::Four, 0), 0x1603, 0),
            (PdoKind::Tpdo.communication(PdoNumber::Two, 2), 0x1801, 2),
            (PdoKind::Tpdo.mapping(PdoNumber::Three, 3), 0x1A02, 3),
        ];
        for (object, index, subindex) in table {
            assert_eq!(object, Object::new(index, subindex));
        }
    }

    #[test]
    fn the_cob_id_word_carries_two_flags() {
        let id = StandardId::new(0x182).unwrap();
        let word = PdoCobId::new(id);
        assert_eq!(word.0, 0x0000_0182);
        assert_eq!(word.invalid().0, 0x8000_0182);
        assert_eq!(word.invalid().without_rtr().0, 0xC000_0182);
        assert!(word.is_valid() && !word.invalid().is_valid());
        assert_eq!(word.invalid().without_rtr().id(), Some(id));
        assert_eq!(PdoCobId(0x2000_0182).id(), None);
    }

    #[test]
    fn an_identifier_of_11_bits_leaves_bits_11_to_29_at_zero() {
        for bit in 0..32 {
            let word = PdoCobId(0x182 | 1 << bit);
            assert_eq!(word.is_standard(), !(11..=29).contains(&bit), "bit {bit}");
        }
    }

    #[test]
    fn transmission_types_up_to_240_are_synchronous() {
        for raw in 0..=u8::MAX {
            let kind = TransmissionType(raw);
            assert_eq!(kind.is_synchronous(), raw <= 240);
            assert_eq!(kind.cycle(), (1..=240).contains(&raw).then_some(raw));
        }
    }

    #[test]
    fn entries_are_index_subindex_bits() {
        let entry = Entry::new(POSITION_ACTUAL, 32);
        assert_eq!(entry.raw(), 0x6064_0020);
        assert_eq!(Entry::from_raw(0x6064_0020), entry);
        assert_eq!(Entry::from_raw(0x20C1_0040).object, EPOS2_INTERPOLATION_DATA);
    }

    #[test]
    fn mappings_that_do_not_fit_are_refused() {
        let byte = Entry::new(MODE_OF_OPERATION, 8);
        let long = Entry::new(TARGET_POSITION, 32);
        let bit = Entry::new(DIGITAL_INPUTS, 1);
        let empty = Entry::new(DIGITAL_INPUTS, 0);
        assert!(PdoMapping::new(&[]).is_ok());
        assert!(PdoMapping::new(&[byte; 8]).is_ok());
        assert_eq!(PdoMapping::new(&[byte; 9]), Err(MappingError::TooMany { found: 9 }));
        assert_eq!(PdoMapping::new(&[long; 3]), Err(MappingError::TooLong { bits: 96 }));
        for entry in [bit, empty] {
            let refused = MappingError::NotBytes { object: DIGITAL_INPUTS, bits: entry.bits };
            assert_eq!(PdoMapping::new(&[entry]), Err(refused));
        }
    }
}
