//! CAN identifiers of 11 and 29 bits.

/// An 11-bit identifier. A smaller one wins arbitration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StandardId(u16);

impl StandardId {
    /// The largest 11-bit identifier.
    pub const MAX: Self = Self(0x7FF);

    /// `None` above 0x7FF.
    pub const fn new(raw: u16) -> Option<Self> {
        if raw <= 0x7FF { Some(Self(raw)) } else { None }
    }

    /// The identifier's bits.
    pub const fn raw(self) -> u16 {
        self.0
    }
}

/// A 29-bit identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ExtendedId(u32);

impl ExtendedId {
    /// `None` above 0x1FFF_FFFF.
    pub const fn new(raw: u32) -> Option<Self> {
        if raw <= 0x1FFF_FFFF { Some(Self(raw)) } else { None }
    }

    /// The identifier's bits.
    pub const fn raw(self) -> u32 {
        self.0
    }
}

/// The identifier of a data or remote frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Id {
    /// 11 bits.
    Standard(StandardId),
    /// 29 bits.
    Extended(ExtendedId),
}

impl From<StandardId> for Id {
    fn from(id: StandardId) -> Self {
        Self::Standard(id)
    }
}

impl From<ExtendedId> for Id {
    fn from(id: ExtendedId) -> Self {
        Self::Extended(id)
    }
}
