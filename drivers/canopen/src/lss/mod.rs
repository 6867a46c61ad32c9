//! LSS, the layer setting services (CiA 305): node-IDs and bit rates for nodes that have none.
//!
//! A [`Request`] goes from the master to all slaves, a [`Response`] from the addressed slave to the master. Neither has a
//! node-ID. A node without a node-ID takes part in LSS alone. Slaves obey the configuring requests only in
//! [`Mode::Configuration`].

mod layout;

pub use layout::{Bound, FASTSCAN_RESET, Fastscan, Mode, Outcome, Part, Request, Response};

/// The node-ID of a node that has none.
pub const UNCONFIGURED: u8 = 0xFF;

/// The bit timing table of CiA (CiA 305 §6.4.3). [`BitRate::index`] returns its indices.
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
        match part {
            Part::Vendor => self.vendor,
            Part::Product => self.product,
            Part::Revision => self.revision,
            Part::Serial => self.serial,
        }
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BitRate {
    /// 10 kbit/s.
    Kbps10,
    /// 20 kbit/s.
    Kbps20,
    /// 50 kbit/s.
    Kbps50,
    /// 125 kbit/s.
    Kbps125,
    /// 250 kbit/s.
    Kbps250,
    /// 500 kbit/s.
    Kbps500,
    /// 800 kbit/s.
    Kbps800,
    /// 1 Mbit/s.
    Kbps1000,
    /// The node detects the bit rate of the bus.
    Automatic,
}

impl BitRate {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Kbps10,
        Self::Kbps20,
        Self::Kbps50,
        Self::Kbps125,
        Self::Kbps250,
        Self::Kbps500,
        Self::Kbps800,
        Self::Kbps1000,
        Self::Automatic,
    ];

    /// Its index in the table; 5 is reserved.
    pub const fn index(self) -> u8 {
        match self {
            Self::Kbps1000 => 0,
            Self::Kbps800 => 1,
            Self::Kbps500 => 2,
            Self::Kbps250 => 3,
            Self::Kbps125 => 4,
            Self::Kbps50 => 6,
            Self::Kbps20 => 7,
            Self::Kbps10 => 8,
            Self::Automatic => 9,
        }
    }

    /// `None` for an index that the table does not have.
    pub fn from_index(index: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|rate| rate.index() == index)
    }

    /// kbit/s; `None` if the node detects it.
    pub const fn kbps(self) -> Option<u16> {
        Some(match self {
            Self::Kbps10 => 10,
            Self::Kbps20 => 20,
            Self::Kbps50 => 50,
            Self::Kbps125 => 125,
            Self::Kbps250 => 250,
            Self::Kbps500 => 500,
            Self::Kbps800 => 800,
            Self::Kbps1000 => 1000,
            Self::Automatic => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bit_rates_have_the_indices_of_the_table() {
        let table = [
            (0, Some(1000)),
            (1, Some(800)),
            (2, Some(500)),
            (3, Some(250)),
            (4, Some(125)),
            (6, Some(50)),
            (7, Some(20)),
            (8, Some(10)),
            (9, None),
        ];
        for (index, kbps) in table {
            let rate = BitRate::from_index(index).unwrap();
            assert_eq!((rate.index(), rate.kbps()), (index, kbps));
        }
        for index in [5, 10, 255] {
            assert_eq!(BitRate::from_index(index), None);
        }
    }
}
